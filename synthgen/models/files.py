"""Finding and reading model files: the shipped hand, and a user's own MANO file."""

from __future__ import annotations

import hashlib
import os
import zipfile
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ModelError, nearest
from synthgen.models.joints import FINGERS, MANO16_NAMES, MANO778_TIPS
from synthgen.models.loft import loft_surface
from synthgen.models.mano import ManoModel
from synthgen.models.mirror import mirror_model
from synthgen.models.pickles import read_pickle
from synthgen.models.surface import Arm, HandSurface

Array = NDArray[np.float64]
Hand = Literal["left", "right"]

DATA = Path(__file__).parent / "data"
MAX_MEMBER_BYTES = 400 * 2**20
_NEEDED = ("v_template", "shapedirs", "posedirs", "weights", "J_regressor", "kintree_table", "f")
_SUFFIXES = (".npz", ".pkl")


def list_models() -> dict[str, Path]:
    """Return models by name: shipped ones, then those in the folders of ``SYNTHGEN_MODELS``."""
    folders = [
        DATA,
        *map(Path, filter(None, os.environ.get("SYNTHGEN_MODELS", "").split(os.pathsep))),
    ]
    found: dict[str, Path] = {}
    for folder in folders:
        if folder.is_dir():
            for path in sorted(folder.iterdir()):
                if path.suffix in _SUFFIXES:
                    found.setdefault(path.stem, path)
    return found


def load(name: str | Path, *, hand: Hand = "right", official_left_shape: bool = False) -> ManoModel:
    """Load a hand model.

    Parameters
    ----------
    name : str or Path
        A model's name (see :func:`list_models`) or the path of a ``.npz`` or MANO ``.pkl``.
    hand : {"right", "left"}
        A file holds one side; the other is made by mirroring (papers' A.1-A.5). The side of a
        file is taken from its name (``LEFT`` / ``RIGHT``) and otherwise is right.
    official_left_shape : bool
        Keep the published left hand's shape bases, whose x components have the wrong sign
        (they equal the right hand's). By default they are corrected.

    Returns
    -------
    ManoModel

    Raises
    ------
    ModelError
        If the model is not found, unreadable or inconsistent.
    """
    if hand not in ("left", "right"):
        raise ModelError(f"hand={hand!r}; allowed are 'left' and 'right'")
    path = _find(str(name))
    stamp = path.stat().st_mtime_ns
    return _load(str(path), stamp, hand, official_left_shape)


def _find(name: str) -> Path:
    path = Path(name)
    if path.suffix in _SUFFIXES and path.is_file():
        return path.resolve()
    models = list_models()
    if name in models:
        return models[name].resolve()
    raise ModelError(
        f"no model {name!r}{nearest(name, models)}; known are {sorted(models)}. Give the path of "
        "a .npz or .pkl, or put its folder into SYNTHGEN_MODELS"
    )


@lru_cache(maxsize=8)
def _load(path: str, stamp: int, hand: Hand, official_left_shape: bool) -> ManoModel:
    file = Path(path)
    own: Hand = "left" if "left" in file.stem.lower() else "right"
    arrays = _read_npz(file) if file.suffix == ".npz" else read_pickle(file)
    model = _build(arrays, file, own, official_left_shape)
    return model if own == hand else mirror_model(model)


def _read_npz(path: Path) -> dict[str, Any]:
    try:
        with zipfile.ZipFile(path) as archive:
            for member in archive.infolist():
                if member.file_size > MAX_MEMBER_BYTES:
                    raise ModelError(f"{path}: {member.filename} has {member.file_size} bytes")
        with np.load(path, allow_pickle=False) as content:
            return {key: content[key] for key in content.files}
    except ModelError:
        raise
    except (OSError, ValueError, zipfile.BadZipFile, EOFError, KeyError, MemoryError) as error:
        raise ModelError(f"{path}: not a readable model archive ({error})") from None


def _build(arrays: dict[str, Any], path: Path, own: Hand, official_left_shape: bool) -> ManoModel:
    if "posedirs_q" in arrays:
        scale = float(arrays["posedirs_scale"])
        arrays["posedirs"] = arrays["posedirs_q"].astype(np.float64) * scale
    missing = [key for key in _NEEDED if key not in arrays]
    if missing:
        raise ModelError(f"{path}: no {', '.join(missing)}; a MANO-form file has {_NEEDED}")
    a = {key: _numbers(arrays[key], key, path) for key in _NEEDED}
    _check_relations(a, path)
    if own == "left" and not official_left_shape and _has_left_bug(a, path):
        a["shapedirs"] = a["shapedirs"] * np.array([-1.0, 1.0, 1.0])[:, None]
    parents = a["kintree_table"][0].astype(np.int64)
    parents[0] = -1
    tips, tip_set = _fingertips(arrays, a, path)
    joints = a["J_regressor"] @ a["v_template"]
    faces = a["f"].astype(np.int64)
    surface = (
        _shipped_surface(arrays, a, path)
        if "arm_template" in arrays
        else loft_surface(a["v_template"], a["shapedirs"], faces, a["weights"], joints, tips)
    )
    return ManoModel(
        family="mano",
        name=path.stem if path.parent == DATA.resolve() else str(path),
        hand=own,
        digest=_digest(a),
        v_template=a["v_template"],
        shapedirs=a["shapedirs"],
        posedirs=a["posedirs"],
        weights=a["weights"],
        J_regressor=a["J_regressor"],
        parents=parents,
        faces=faces,
        joint_names=MANO16_NAMES,
        hands_mean=_optional(arrays, "hands_mean", path),
        hands_components=_optional(arrays, "hands_components", path),
        hands_coeffs=_optional(arrays, "hands_coeffs", path),
        fingertip_ids=tips,
        fingertip_set=tip_set,
        joint_axes=_optional(arrays, "joint_axes", path),
        joint_range=_optional(arrays, "joint_range", path),
        finger_radius=_finger_radius(a, joints),
        surface=surface,
        provenance=str(arrays.get("provenance", f"user file {path.name}")),
    )


def _numbers(value: Any, key: str, path: Path) -> Array:
    array = np.asarray(value)
    if array.dtype.kind not in "fiu":
        raise ModelError(f"{path}: {key} holds {array.dtype}; expected numbers")
    result = array.astype(np.float64)
    if not np.isfinite(result).all():
        raise ModelError(f"{path}: {key} holds NaN or infinity")
    return result


def _optional(arrays: dict[str, Any], key: str, path: Path) -> Array | None:
    return _numbers(arrays[key], key, path) if key in arrays else None


def _check_relations(a: dict[str, Array], path: Path) -> None:
    if a["v_template"].ndim != 2 or a["weights"].ndim != 2 or a["shapedirs"].ndim != 3:
        raise ModelError(f"{path}: v_template, weights or shapedirs has the wrong rank")
    v, k = len(a["v_template"]), a["weights"].shape[1]
    expected = {
        "v_template": (v, 3),
        "shapedirs": (v, 3, a["shapedirs"].shape[2]),
        "posedirs": (v, 3, 9 * (k - 1)),
        "weights": (v, k),
        "J_regressor": (k, v),
        "kintree_table": (2, k),
        "f": (len(a["f"]), 3),
    }
    for key, shape in expected.items():
        if a[key].shape != shape:
            raise ModelError(f"{path}: {key} is {a[key].shape}; expected {shape}")
    if k != len(MANO16_NAMES):
        raise ModelError(f"{path}: {k} joints; a MANO-form hand has {len(MANO16_NAMES)}")
    if a["f"].min() < 0 or a["f"].max() >= v:
        raise ModelError(f"{path}: faces refer to vertex {int(a['f'].max())} of {v}")
    if np.abs(a["weights"].sum(axis=1) - 1).max() > 1e-3:
        raise ModelError(f"{path}: skinning weights do not sum to 1")
    parents = a["kintree_table"][0, 1:]
    if np.any(parents < 0) or np.any(parents >= np.arange(1, k)):
        raise ModelError(f"{path}: kintree_table does not list parents before children")


def _has_left_bug(a: dict[str, Array], path: Path) -> bool:
    """Tell whether a left hand carries the right hand's shape bases, x not negated.

    Published left hands do. The right file beside it (``LEFT`` in its name replaced by
    ``RIGHT``) decides; without one the bases are taken as they are.
    """
    twin = path.with_name(path.name.replace("LEFT", "RIGHT").replace("left", "right"))
    if twin == path or not twin.is_file():
        return False
    other = (_read_npz(twin) if twin.suffix == ".npz" else read_pickle(twin)).get("shapedirs")
    right = None if other is None else np.asarray(other, dtype=np.float64)
    if right is None or right.shape != a["shapedirs"].shape:
        return False
    mirrored = right * np.array([-1.0, 1.0, 1.0])[:, None]
    same = np.abs(a["shapedirs"] - right).sum()
    return bool(same < np.abs(a["shapedirs"] - mirrored).sum())


def _fingertips(
    arrays: dict[str, Any], a: dict[str, Array], path: Path
) -> tuple[NDArray[np.int64], str]:
    v = len(a["v_template"])
    if "fingertip_ids" in arrays:
        ids = np.asarray(arrays["fingertip_ids"]).astype(np.int64)
        if ids.shape != (5,) or ids.min() < 0 or ids.max() >= v:
            raise ModelError(f"{path}: fingertip_ids {ids.tolist()} are not 5 of {v} vertices")
        return ids, f"{path.stem}"
    if v == 778:
        return np.array(MANO778_TIPS["smplx"], dtype=np.int64), "smplx"
    joints = a["J_regressor"] @ a["v_template"]
    tips = []
    for finger in ("thumb", "index", "middle", "ring", "pinky"):
        last = 3 * FINGERS.index(finger) + 3
        along = (a["v_template"] - joints[last]) @ (joints[last] - joints[last - 1])
        own = a["weights"].argmax(axis=1) == last
        tips.append(int(np.where(own, along, -np.inf).argmax()))
    return np.array(tips, dtype=np.int64), "farthest-along-last-bone"


def _finger_radius(a: dict[str, Array], joints: Array) -> Array:
    """Median distance from each joint of the skin that it moves most, near the joint."""
    owner = a["weights"].argmax(axis=1)
    radius = np.full(len(joints), 0.012)
    for k in range(len(joints)):
        away = np.linalg.norm(a["v_template"][owner == k] - joints[k], axis=1)
        if len(away) >= 8:
            radius[k] = float(np.quantile(away, 0.25))
    return radius


def _shipped_surface(arrays: dict[str, Any], a: dict[str, Array], path: Path) -> HandSurface:
    get = {k: _numbers(arrays[k], k, path) for k in arrays if k.startswith(("arm_", "uv", "mask_"))}
    try:
        arm = Arm(
            template=get["arm_template"],
            shapedirs=get["arm_shapedirs"],
            weights=get["arm_weights"],
            elbow=get["arm_elbow"],
            elbow_shapedirs=get["arm_elbow_shapedirs"],
            faces=get["arm_faces"].astype(np.int64),
            end_ids=get["arm_end_ids"].astype(np.int64),
        )
        part = np.full(len(a["v_template"]) + len(arm.template), 17, dtype=np.uint8)
        part[: len(a["v_template"])] = a["weights"].argmax(axis=1) + 1
        faces = np.concatenate([a["f"].astype(np.int64), arm.faces])
        uv_faces = get["uv_faces"].astype(np.int64)
        return HandSurface(
            arm, faces, get["uv"], uv_faces, get["mask_nail"], get["mask_palm"], part
        )
    except KeyError as error:
        raise ModelError(f"{path}: no {error.args[0]} beside arm_template") from None


def _digest(a: dict[str, Array]) -> str:
    total = hashlib.sha256()
    for key in sorted(a):
        total.update(key.encode() + str(a[key].shape).encode())
        total.update(np.ascontiguousarray(a[key]).tobytes())
    return total.hexdigest()
