"""Which family a file belongs to, and whether its arrays fit together.

Nothing is compared with a constant of one published file: vertex, face, component and feature
counts come from the file; only the relations between its arrays are fixed.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final, cast, get_args

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ModelError
from synthgen.models.constrained import ConstrainedTree
from synthgen.models.content import Array, Content, digest_of
from synthgen.models.drawn_keys import check_drawn_keys
from synthgen.models.joints import MANO16_NAMES
from synthgen.models.model import Family

NEEDED: Final = (
    "v_template", "shapedirs", "posedirs", "weights", "J_regressor", "kintree_table", "f",
)  # fmt: skip
# Skinning weights may miss 1 by this much; more is a damaged or foreign file.
WEIGHT_TOLERANCE = 1e-3
# Rows of a joint regressor may miss 1 by as much without a word, and by REGRESSOR_TOLERANCE with a
# warning; more would move a joint by centimetres when its body moves by half a metre.
REGRESSOR_ROUNDING, REGRESSOR_TOLERANCE = 1e-3, 0.05
# Metres, or metres per unit of a coefficient: beyond it lies no unit of length anyone uses.
_LARGEST = 1e6
_HAND_KEYS = ("hands_mean", "hands_components")
_LENGTHS = ("v_template", "shapedirs", "posedirs", "exprdirs", "J_regressor")
_KNOWN_OTHERS = {5: "FLAME", 24: "SMPL", 55: "SMPL-X"}
_HAVE = "MANO (16 joints), SMPL+H (52), SUPR (quaternion features) and STAR (24) are read"


def checked(content: Content) -> Content:
    """Check a file's arrays and tell its family.

    Parameters
    ----------
    content : Content

    Returns
    -------
    Content
        With its family, digest and warnings.

    Raises
    ------
    ModelError
        Naming file, key, what was found and what was expected.
    """
    missing = [key for key in NEEDED if key not in content.arrays]
    if missing:
        raise content.fail(
            f"no {', '.join(missing)}; a model file has {', '.join(NEEDED)}, this one "
            f"{content.keys_text()}"
        )
    _check_ranks(content)
    family = family_of(content)
    _check_shapes(content, family)
    content.check_size()
    for key in _number_keys(content):
        _check_finite(content, key)
    _check_faces(content)
    _check_weights(content)
    off = _check_regressor(content, family)
    _check_tree(content)
    _check_style(content)
    if family == "mano":
        _check_hand_space(content, "")
    else:
        for side in "lr":
            if any(f"{key}{side}" in content.arrays for key in _HAND_KEYS):
                _check_hand_space(content, side)
    check_drawn_keys(content)
    warnings = (*content.warnings, *off, *_constrained_warnings(content))
    keys = [*NEEDED, *(("exprdirs",) if "exprdirs" in content.arrays else ())]
    digest = digest_of(content, keys)
    return replace(content, family=family, digest=digest, warnings=warnings)


def family_of(content: Content) -> Family:
    """Tell the family from the shapes of regressor and pose correctives.

    Raises
    ------
    ModelError
        If the file is of no family that is read.
    """
    named = content.text("family")
    if named in get_args(Family):  # parts of a body say so: they may have a hand's joint count
        return cast(Family, named)
    v, k = content.arrays["weights"].shape
    columns = content.arrays["posedirs"].size // max(3 * v, 1)
    rows = content.arrays["J_regressor"].shape
    if rows == (3 * k, 3 * v + 1) or content.meta is not None:
        return "supr"
    if columns == 4 * (k - 1) + 1:
        return "star"
    if columns == 9 * (k - 1):
        if k == len(MANO16_NAMES):
            return "mano"
        if k not in _KNOWN_OTHERS:
            return "smplh"
        known = _KNOWN_OTHERS[k]
        raise content.fail(
            f"weights name {k} joints, which looks like {known}: another family; {_HAVE}"
        )
    raise content.fail(
        f"posedirs is {content.arrays['posedirs'].shape} and J_regressor {rows} for {v} vertices "
        f"and {k} joints: another family, or arrays of different files. Expected {9 * (k - 1)} "
        f"features (MANO, SMPL+H), {4 * (k - 1) + 1} (STAR), or an affine regressor of shape "
        f"{(3 * k, 3 * v + 1)} (SUPR)"
    )


def _check_ranks(content: Content) -> None:
    ranks = {"v_template": 2, "shapedirs": 3, "weights": 2, "J_regressor": 2, "f": 2}
    if "exprdirs" in content.arrays:
        ranks["exprdirs"] = 3
    for key, rank in ranks.items():
        array = content.arrays[key]
        if array.dtype.kind not in "fiu":
            raise content.fail(f"{key} holds {array.dtype}; expected numbers")
        if array.ndim != rank or 0 in array.shape:
            raise content.fail(f"{key} is {array.shape}; expected {rank} dimensions, none 0")
    if content.arrays["posedirs"].size == 0:
        found = content.arrays["posedirs"].shape
        raise content.fail(f"posedirs is {found}; a model has at least two joints and correctives")


def _check_shapes(content: Content, family: Family) -> None:
    v, k = content.arrays["weights"].shape
    features = {
        "mano": (9 * (k - 1),),
        "smplh": (9 * (k - 1),),
        "star": (4 * (k - 1) + 1,),
        "supr": (4 * k, 4 * (k - 1)),
    }[family]
    regressor = (3 * k, 3 * v + 1) if family == "supr" else (k, v)
    components = content.arrays["shapedirs"].shape[2]
    expected: dict[str, list[tuple[int, ...]]] = {
        "v_template": [(v, 3)],
        "shapedirs": [(v, 3, components)],
        "posedirs": [(v, 3, n) for n in features] + [(3 * v, n) for n in features],
        "J_regressor": [regressor],
        "kintree_table": [(2, k)],
        "f": [(len(content.arrays["f"]), 3)],
    }
    if "exprdirs" in content.arrays:
        expected["exprdirs"] = [(v, 3, content.arrays["exprdirs"].shape[-1])]
    for key, last in (("joint_axes", 3), ("joint_range", 2)):
        if key in content.arrays:
            expected[key] = [(k, 3, last)]
    for key, shapes in expected.items():
        found = content.arrays[key].shape
        if found not in shapes:
            words = " or ".join(map(str, shapes[:2]))
            raise content.fail(
                f"{key} is {found}; expected {words} (weights are {v} vertices x {k} joints)"
            )


def _number_keys(content: Content) -> list[str]:
    spaces = [f"{k}{s}" for k in (*_HAND_KEYS, "hands_coeffs") for s in ("", "l", "r")]
    wanted = (*NEEDED, "exprdirs", "joint_axes", "joint_range", *spaces)
    return [key for key in wanted if key in content.arrays]


def _check_finite(content: Content, key: str) -> None:
    array = content.arrays[key]
    if array.dtype.kind not in "fiu":
        raise content.fail(f"{key} holds {array.dtype}; expected numbers")
    if array.dtype.kind != "f":
        return
    with np.errstate(all="ignore"):  # one pass without a mask: NaN and infinity survive a sum
        total = np.sum(array, dtype=np.float64)
    if not np.isfinite(total) and not (finite := np.isfinite(array)).all():
        bad = np.argwhere(~finite)
        raise content.fail(
            f"{key} holds NaN or infinity ({len(bad)} entries, the first at "
            f"{tuple(bad[0].tolist())}); "
            "expected finite numbers"
        )
    if key in _LENGTHS and (largest := max(float(array.max()), -float(array.min()))) > _LARGEST:
        raise content.fail(
            f"{key} holds {largest:.3g}; expected metres, and nothing beyond {_LARGEST:.0g}"
        )


def _check_faces(content: Content) -> None:
    v, faces = len(content.arrays["v_template"]), content.arrays["f"]
    if faces.dtype.kind == "f" and (faces % 1).any():
        raise content.fail("f holds broken numbers; expected the vertex ids of each face")
    low, high = int(faces.min()), int(faces.max())
    if low < 0 or high >= v:
        raise content.fail(f"f: faces refer to vertex {high if high >= v else low} of {v}")


def _check_weights(content: Content) -> None:
    weights = content.numbers("weights")
    off, lowest = np.abs(weights.sum(axis=1) - 1), weights.min(axis=1)
    expected = f"expected rows of positive weights that sum to 1 within {WEIGHT_TOLERANCE}"
    if off.max() > WEIGHT_TOLERANCE:
        worst = int(off.argmax())
        raise content.fail(
            f"weights do not sum to 1: vertex {worst} has {weights[worst].sum():.6g}; {expected}"
        )
    if lowest.min() < -WEIGHT_TOLERANCE:
        worst = int(lowest.argmin())
        raise content.fail(f"weights of vertex {worst} go down to {lowest[worst]:.3g}; {expected}")


def _check_regressor(content: Content, family: Family) -> tuple[str, ...]:
    """Refuse joints that no vertex places, or that do not move with their vertices; warn of few.

    The rows of SUPR's affine regressor and of a part's (which stands for vertices cut away) need
    not sum to 1.
    """
    regressor = content.numbers("J_regressor")
    rows = regressor.reshape(content.arrays["weights"].shape[1], -1)
    if (empty := np.flatnonzero(~rows.any(axis=1))).size:
        raise content.fail(
            f"J_regressor has only zeros for joint {empty[0]}; expected the vertices that place it"
        )
    if family == "supr" or "family" in content.arrays:
        return ()
    total = regressor.sum(axis=1)
    worst = int(np.abs(total - 1).argmax())
    words = (
        f"J_regressor: the row of joint {worst} sums to {total[worst]:.6g}; expected rows that "
        "sum to 1"
    )
    if abs(total[worst] - 1) > REGRESSOR_TOLERANCE:
        raise content.fail(f"{words} within {REGRESSOR_TOLERANCE}")
    return (words,) if abs(total[worst] - 1) > REGRESSOR_ROUNDING else ()


def parents_of(content: Content) -> NDArray[np.int64]:
    """Return the parent of each joint, -1 for the root.

    The second row of ``kintree_table`` names the joints; parts cut from a body keep the body's
    numbers there. Whatever stands for the root's parent (4294967295, -1, 0) is not read.
    """
    table = content.numbers("kintree_table")
    place = {name: k for k, name in enumerate(table[1])}
    parents = table[0].copy()
    if len(place) == len(parents):
        parents[1:] = [place.get(name, len(place)) for name in parents[1:]]
    parents[0] = -1
    return parents.astype(np.int64) if (parents % 1 == 0).all() else np.full(len(parents), -1)


def _check_tree(content: Content) -> None:
    parents = parents_of(content)
    wrong = np.flatnonzero((parents[1:] < 0) | (parents[1:] >= np.arange(1, len(parents)))) + 1
    if len(wrong):
        j = int(wrong[0])
        raise content.fail(
            "kintree_table does not list parents before children: its column "
            f"{j} is {content.numbers('kintree_table')[:, j].tolist()} (parent, joint); expected "
            "one of the joints before it for a parent"
        )


def _check_style(content: Content) -> None:
    for key, allowed in (("bs_style", "lbs"), ("bs_type", "lrotmin")):
        found = content.text(key, allowed)
        if found != allowed:
            raise content.fail(f"{key} is {found!r}; only {allowed!r} is evaluated")


def _check_hand_space(content: Content, side: str) -> None:
    for key in _HAND_KEYS:
        if f"{key}{side}" not in content.arrays:
            raise content.fail(
                f"no {key}{side}: the hand's pose space (PCA) is missing; expected "
                f"hands_mean{side} (45,) and hands_components{side} (n, 45)"
            )
    mean, rows = (content.arrays[f"{key}{side}"] for key in _HAND_KEYS)
    if mean.shape != (45,) or rows.ndim != 2 or rows.shape[1] != 45 or not len(rows):
        raise content.fail(
            f"hands_mean{side} is {mean.shape} and hands_components{side} {rows.shape}; expected "
            "(45,) and (n, 45)"
        )
    coeffs = content.arrays.get(f"hands_coeffs{side}")
    if coeffs is not None and (coeffs.ndim != 2 or coeffs.shape[1] != len(rows)):
        raise content.fail(
            f"hands_coeffs{side} is {coeffs.shape}; expected (N, {len(rows)}), a column for each "
            f"row of hands_components{side}"
        )


def _constrained_warnings(content: Content) -> tuple[str, ...]:
    if content.meta is None:
        return ()
    try:
        ConstrainedTree.from_meta(content.meta, content.arrays["weights"].shape[1])
    except ModelError as error:
        raise content.fail(str(error)) from None
    except (ValueError, TypeError, OverflowError) as error:
        raise content.fail(f"axis_meta: a list that is no table of numbers ({error})") from None
    return (
        "constrained tree: early female and male files had axes on wrong joints; compare the "
        "file's hash with that of a fresh download",
    )


def posedirs_of(content: Content) -> Array:
    """Return pose correctives (V, 3, n); some SUPR files store (3 V, n)."""
    return content.owned("posedirs").reshape(len(content.arrays["v_template"]), 3, -1)
