"""Random files in the exact form of published SMPL+H, SUPR and STAR models.

Bodies are symmetric clouds of points with random bases; counts are free, relations are those of
the real files. Pickles are written byte by byte as Python 2 wrote them, chumpy and scipy objects
included, so that nothing but the reader under test knows how they are put together.
"""

from __future__ import annotations

import io
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from synthgen.models import joints
from synthgen.sampling.streams import stream

NAMES = {
    "smplh": (joints.SMPLH52_NAMES, joints.SMPLH52_PARENTS),
    "supr": (joints.SUPR75_NAMES, joints.SUPR75_PARENTS),
    "star": (joints.STAR24_NAMES, joints.STAR24_PARENTS),
}


def body(family: str, *, pairs: int = 60, betas: int = 12, seed: int = 0) -> dict[str, Any]:
    """Arrays of a body with ``2 * pairs + 8`` vertices, keys and dtypes as published."""
    rng = stream(seed, "sample", 0, 0, f"{family} file")
    names, parents = NAMES[family]
    k, middle = len(names), 8
    side = rng.normal(0, 0.3, (pairs, 3)) + [0.5, 0, 0]
    line = rng.normal(0, 0.3, (middle, 3)) * [0, 1, 1]
    v_template = np.concatenate([side, side * [-1, 1, 1], line])
    order = rng.permutation(len(v_template))
    v_template = v_template[order]
    v = len(v_template)
    table = np.stack([np.array(parents), np.arange(k)]).astype(np.int64)
    table[0, 0] = 4294967295
    content = {
        "v_template": v_template,
        "f": rng.integers(0, v, (2 * v, 3)).astype(np.uint32),
        "weights": _weights(rng, v, k, parents),
        "kintree_table": table.astype(np.uint32),
        "shapedirs": rng.normal(0, 0.01, (v, 3, betas)),
        "posedirs": rng.normal(0, 0.003, (v, 3, _features(family, k))),
    }
    regressor = _regressor(rng, k, v)
    content["J_regressor"] = _affine(rng, regressor) if family == "supr" else regressor
    if family == "smplh":
        content |= {"bs_style": "lbs", "bs_type": "lrotmin"}
    return content


def mirrored_ids(v_template: Any) -> Any:
    """The vertex at the mirror image of each vertex, by brute force."""
    away = v_template[:, None] - v_template * [-1, 1, 1]
    return np.linalg.norm(away, axis=-1).argmin(axis=0)


def hands(seed: int = 0) -> dict[str, Any]:
    """Pose spaces of both hands, with the keys of a merged SMPL+H file."""
    rng = stream(seed, "sample", 0, 0, "hand spaces")
    found: dict[str, Any] = {}
    for s in "lr":
        found[f"hands_components{s}"] = np.linalg.qr(rng.normal(size=(45, 45)))[0]
        found[f"hands_mean{s}"] = rng.normal(0, 0.2, 45)
        found[f"hands_coeffs{s}"] = rng.normal(0, 0.3, (80, 45))
    return found


def axis_meta(k: int, hinges: int, doubles: int, seed: int = 0) -> dict[str, Any]:
    """A constrained tree's table, keys and nesting as in SUPR's constrained files."""
    rng = stream(seed, "sample", 0, 0, "axis meta")
    kinds = np.array([1] * hinges + [2] * doubles + [0] * (k - hinges - doubles))
    kinds[1:] = rng.permutation(np.append(kinds[:-1], kinds[-1]))[: k - 1]
    kinds[0] = 0
    order = np.argsort(kinds, kind="stable")
    lists: dict[str, Any] = {key: [] for key in (
        "indx_spherical", "indx_hinge", "indx_double_hinge1", "indx_double_hinge2",
        "indx_hinge_axis", "indx_double_hinge1_axis", "indx_double_hinge2_axis")}  # fmt: skip
    at = axes = 0
    for kind in kinds[order]:
        if kind == 0:
            lists["indx_spherical"].append([at, at + 1, at + 2])
        elif kind == 1:
            lists["indx_hinge"].append([at])
            lists["indx_hinge_axis"].append(axes)
        else:
            lists["indx_double_hinge1"].append(at)
            lists["indx_double_hinge2"].append(at + 1)
            lists["indx_double_hinge1_axis"].append(axes)
            lists["indx_double_hinge2_axis"].append(axes + 1)
        at, axes = at + (3, 1, 2)[kind], axes + kind
    axis = rng.normal(size=(1, axes, 3))
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    return {"num_pose": at, **lists, "reverse_indx": np.argsort(order),
            "axis_indx": np.arange(axes), "axis": axis}  # fmt: skip


def _features(family: str, k: int) -> int:
    return {"smplh": 9 * (k - 1), "supr": 4 * k, "star": 4 * (k - 1) + 1}[family]


def _weights(rng: np.random.Generator, v: int, k: int, parents: Any) -> Any:
    weights = np.zeros((v, k))
    owner = rng.integers(0, k, v)
    for i, j in enumerate(owner):
        far = int(rng.integers(0, k)) if rng.random() < 0.02 else int(j)
        for joint in {int(j), max(parents[j], 0), max(parents[max(parents[j], 0)], 0), far}:
            weights[i, joint] = rng.random() + 0.05
    return weights / weights.sum(axis=1, keepdims=True)


def _regressor(rng: np.random.Generator, k: int, v: int) -> Any:
    rows = np.zeros((k, v))
    for j in range(k):
        rows[j, rng.choice(v, min(v, 12), replace=False)] = rng.random(min(v, 12)) + 0.1
    return rows / rows.sum(axis=1, keepdims=True)


def _affine(rng: np.random.Generator, rows: Any) -> Any:
    k, v = rows.shape
    affine = np.zeros((3 * k, 3 * v + 1))
    for c in range(3):
        affine[c::3, c:-1:3] = rows
    affine[:, -1] = rng.normal(0, 0.01, 3 * k)
    return affine


@dataclass
class Foreign:
    """An instance of a foreign class, as a pickle states it."""

    module: str
    name: str
    state: dict[str, Any]


def chumpy(array: Any) -> Foreign:
    return Foreign("chumpy.ch", "Ch", {"x": array, "_dirty_vars": Foreign("", "set", {})})


def selected(array: Any) -> Foreign:
    """Chumpy's ``big[:, :, :n]``, whose source holds more than is picked."""
    big = np.concatenate([array, np.full((*array.shape[:-1], 2), 7.0)], axis=-1)
    picks = np.arange(big.size).reshape(big.shape)[..., : array.shape[-1]].ravel()
    state = {"a": Foreign("chumpy.ch", "Ch", {"x": big}), "idxs": picks}
    return Foreign("chumpy.reordering", "Select", {**state, "preferred_shape": array.shape})


def csc(array: Any, module: str = "scipy.sparse.csc") -> Foreign:
    m = sparse.csc_matrix(array)
    state = {"_shape": m.shape, "data": m.data, "indices": m.indices, "indptr": m.indptr}
    return Foreign(module, "csc_matrix", {**state, "maxprint": 50})


class Python2:
    """Writes a value as Python 2's pickle does, protocol 0, 1 or 2."""

    def __init__(self, protocol: int = 2) -> None:
        self.protocol, self.out = protocol, io.BytesIO()

    def dumps(self, value: Any) -> bytes:
        self.out.write(b"\x80\x02" if self.protocol == 2 else b"")
        self._write(value)
        return self.out.getvalue() + b"."

    def _write(self, value: Any) -> None:
        put = self.out.write
        if value is None:
            put(b"N")
        elif isinstance(value, bool):
            put(b"I01\n" if value else b"I00\n")
        elif isinstance(value, int | np.integer):
            put(b"I%d\n" % value if self.protocol == 0 else b"J" + struct.pack("<i", value))
        elif isinstance(value, float):
            put(b"F%r\n" % value if self.protocol == 0 else b"G" + struct.pack(">d", value))
        elif isinstance(value, str):
            self._bytes(value.encode("latin1"))
        elif isinstance(value, bytes):
            self._bytes(value)
        elif isinstance(value, list | tuple):
            self._mark(*value)
            put(b"l" if isinstance(value, list) else b"t")
        elif isinstance(value, dict):
            self._mark(*(part for item in value.items() for part in item))
            put(b"d")
        elif isinstance(value, np.ndarray):
            self._array(value)
        elif isinstance(value, Foreign):
            self._foreign(value)

    def _bytes(self, raw: bytes) -> None:
        if self.protocol == 0:
            text = repr(raw)[1:].encode("ascii")
            self.out.write(b"S" + text + b"\n")
        elif len(raw) < 256:
            self.out.write(b"U" + bytes([len(raw)]) + raw)
        else:
            self.out.write(b"T" + struct.pack("<i", len(raw)) + raw)

    def _mark(self, *values: Any) -> None:
        self.out.write(b"(")
        for value in values:
            self._write(value)

    def _array(self, array: Any) -> None:
        self.out.write(b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n")
        self._write((0,))
        self._write("b")
        fortran = not array.flags.c_contiguous and array.flags.f_contiguous
        self.out.write(b"tR(")
        for part in (1, tuple(array.shape)):
            self._write(part)
        self.out.write(b"cnumpy\ndtype\n(")
        for part in (array.dtype.str[1:], 0, 1):
            self._write(part)
        self.out.write(b"tR(")
        for part in (3, array.dtype.str[0], None, None, None, -1, -1, 0):
            self._write(part)
        self.out.write(b"tb")
        self._write(bool(fortran))
        self._write(array.tobytes("F" if fortran else "C"))
        self.out.write(b"tb")

    def _foreign(self, value: Foreign) -> None:
        if value.name == "set":
            self.out.write(b"c__builtin__\nset\n((lS'x'\natR")
            return
        name = f"c{value.module}\n{value.name}\n".encode()
        if self.protocol == 2:
            self.out.write(name + b")\x81")
        else:
            self.out.write(b"ccopy_reg\n_reconstructor\n(" + name + b"c__builtin__\nobject\nNtR")
        self._write(value.state)
        self.out.write(b"b")


def raw_smplh(content: dict[str, Any]) -> dict[str, Any]:
    """The values of ``SMPLH_male.pkl`` as downloaded: chumpy objects, priors, no hand spaces."""
    regressor, weights = content["J_regressor"], content["weights"]
    return {
        "J_regressor_prior": csc(regressor[:24]),
        "f": content["f"],
        "J_regressor": csc(regressor),
        "kintree_table": content["kintree_table"],
        "J": chumpy(regressor @ content["v_template"]),
        "weights_prior": weights[:, :24],
        "weights": chumpy(weights),
        "vert_sym_idxs": mirrored_ids(content["v_template"]),
        "posedirs": chumpy(content["posedirs"]),
        "pose_training_info": {"gender": "male", "bs_style": "lbs"},
        "bs_style": "lbs",
        "v_template": chumpy(content["v_template"]),
        "shapedirs": selected(content["shapedirs"]),
        "bs_type": "lrotmin",
    }


def raw_mano(content: dict[str, Any]) -> dict[str, Any]:
    """The values of ``MANO_RIGHT.pkl`` as downloaded."""
    return {
        **content,
        "J_regressor": csc(content["J_regressor"]),
        "shapedirs": selected(content["shapedirs"]),
        "J": content["J_regressor"] @ content["v_template"],
    }


def write_python2(path: Path, values: dict[str, Any], protocol: int = 2) -> Path:
    path.write_bytes(Python2(protocol).dumps(values))
    return path


def write_supr(path: Path, content: dict[str, Any], meta: dict[str, Any] | None = None) -> Path:
    """A 0-d object array holding a dict, as numpy saves it."""
    values = {**content, "kintree_table": content["kintree_table"].astype(np.int64)}
    values["kintree_table"][0, 0] = -1
    values |= {} if meta is None else {"axis_meta": meta}
    np.save(path, np.array(values, dtype=object), allow_pickle=True)
    return path
