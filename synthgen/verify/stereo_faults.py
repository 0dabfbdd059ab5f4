"""Known defects of rectified pairs: of pictures, disparities, Q and calibrations of a scan."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.verify.draft import Draft, UnitDraft
from synthgen.verify.faults import Fault

Array = NDArray[Any]
_DISPARITIES = ("disparity", "true")
_ABSENT = "there is no other unit, or all are of one design and have the same"


def _units(change: Callable[[UnitDraft], None], witness: str = "") -> Fault:
    def apply(draft: Draft, _: Draft) -> None:
        for unit in draft.units.values():
            change(unit)

    return Fault(apply, "stereo", witness=witness)


def _facts(change: Callable[[dict[str, Any]], Any]) -> Fault:
    return _units(lambda unit: change(unit.facts))


def _disparities(change: Callable[[UnitDraft, Array], Array]) -> Fault:
    """Change the measured and the true disparities (h, w)."""

    def apply(unit: UnitDraft) -> None:
        for name in _DISPARITIES:
            unit[name] = change(unit, unit[name])

    return _units(apply)


def _array(name: str, change: Callable[[Array], Array], witness: str) -> Fault:
    def apply(unit: UnitDraft) -> None:
        unit[name] = change(unit[name])

    return _units(apply, witness)


def _of_next_unit(*names: str, witness: str = "") -> Fault:
    """Store arrays, or some facts, of the next unit with each."""

    def apply(draft: Draft, _: Draft) -> None:
        units = list(draft.units.values())
        taken = [{name: unit[name] for name in names} for unit in units]
        for unit, others in zip(units, [*taken[1:], taken[0]], strict=True):
            for name, value in others.items():
                if not _alike(value, unit[name]):
                    unit[name] = value

    return Fault(apply, "stereo", _ABSENT, witness)


def _alike(one: Any, other: Any) -> bool:
    """Whether two facts differ by their rounding alone; cameras and arrays are compared exactly."""
    if isinstance(one, (list, float)):
        return np.allclose(one, other, rtol=1e-9, atol=1e-9)
    return bool(np.array_equal(one, other)) if isinstance(one, np.ndarray) else bool(one == other)


def _swapped(first: str, second: str, witness: str = "") -> Fault:
    def apply(unit: UnitDraft) -> None:
        unit[first], unit[second] = unit[second], unit[first]

    return _units(apply, witness)


def _of_next_sample(draft: Draft, following: Draft) -> None:
    for ident, unit in draft.units.items():
        for name in _DISPARITIES:
            unit[name] = following.units[ident][name]


def _opposite_sign(facts: dict[str, Any]) -> None:
    facts["Q"][3] = [-v for v in facts["Q"][3]]


def _centre_of_K(facts: dict[str, Any]) -> None:
    """Count from pixel corners in place of centres in every camera, Q included."""
    facts["Q"][0][3] -= 0.5
    facts["Q"][1][3] -= 0.5
    facts["cx_right"] += 0.5
    for name in ("cx", "cy"):
        facts["rectified"][name] += 0.5


def _baseline_in_mm(facts: dict[str, Any]) -> None:
    facts["Q"][3] = [v / 1000 for v in facts["Q"][3]]


def _in_rig_frame(draft: Draft, _: Draft) -> None:
    """Leave every camera in the rig's frame; the scan is in the world's."""
    back = np.linalg.inv(draft.T_world_from_rig)
    for unit in draft.units.values():
        for name in ("left", "right", "rectified"):
            T = back @ np.array(unit.facts[name]["T_world_from_camera"])
            unit.facts[name]["T_world_from_camera"] = T.tolist()


def _half_right(image: Array, axis: int = 1) -> Array:
    """Move a picture by half a pixel (axis 0: down)."""
    mean = (image.astype(np.float64) + np.roll(image, 1, axis=axis)) / 2
    return np.asarray(np.rint(mean), np.uint8)


def _pair_half_off(unit: UnitDraft) -> None:
    """Move both pictures by half a pixel, as rectification from corners does."""
    for name in ("left.png", "right.png"):
        unit[name] = _half_right(unit[name])


def _matched_half_off(unit: UnitDraft) -> None:
    """Move what was measured from such pictures, too."""
    _pair_half_off(unit)
    measured = unit["disparity"]
    unit["disparity"] = measured - np.float32(0.5 / unit.facts["step"]) * (
        measured - np.roll(measured, 1, axis=1)
    )


def _as_depth(unit: UnitDraft, disparity: Array) -> Array:
    """Depth, metres, in place of disparity."""
    view: dict[str, Any] = unit.facts["rectified"]
    across = disparity + unit.facts["cx_right"] - view["cx"]
    return np.asarray(view["fx"] * unit.facts["baseline_m"] / across, np.float32)


def _raw_camera(facts: dict[str, Any]) -> None:
    """Keep the left camera from before rectification."""
    facts["rectified"] = {**facts["left"], "distortion": [0.0] * 5}


STEREO_FAULTS: dict[str, Fault] = {
    "pair swapped": _swapped("left.png", "right.png", "stereo pictures"),
    "cameras of a pair swapped": _swapped("left", "right"),
    "pictures of another unit": _of_next_unit("left.png", "right.png", witness="stereo pictures"),
    "disparities of another unit": _of_next_unit(*_DISPARITIES),
    "disparities of the next sample": Fault(
        _of_next_sample, "stereo", "a corpus of one sample has no next one"
    ),
    "calibration of another unit": _of_next_unit("left", "right", "rectified", "cx_right", "Q"),
    "Q of another unit": _of_next_unit("Q"),
    "Q with the opposite sign of disparity": _facts(_opposite_sign),
    "Q without the principal points' difference": _facts(lambda f: f["Q"][3].__setitem__(3, 0.0)),
    "Q with a baseline in millimetres": _facts(_baseline_in_mm),
    "Q's principal point half a pixel off": _facts(
        lambda f: f["Q"][0].__setitem__(3, f["Q"][0][3] - 0.5)
    ),
    "pixels counted from their corners": _facts(_centre_of_K),
    "rectified camera as before rectification": _facts(_raw_camera),
    "pairs left in the rig's frame": Fault(_in_rig_frame, "stereo"),
    "right picture half a pixel off": _array("right.png", _half_right, "stereo pictures"),
    "both pictures half a pixel off": _units(_pair_half_off, "stereo picture place"),
    "both pictures half a pixel off, matched": _units(_matched_half_off, "disparity place"),
    "disparity with the opposite sign": _disparities(lambda _, d: -d),
    "disparity half a pixel off": _disparities(lambda _, d: d + np.float32(0.5)),
    "measured disparity half a pixel off": _array(
        "disparity", lambda d: d + np.float32(0.5), "disparity"
    ),
    # OpenCV's matchers give sixteenths
    "disparity in sixteenths": _disparities(lambda _, d: 16 * d),
    "disparity in samples of its grid": _disparities(lambda unit, d: d / unit.facts["step"]),
    "depth stored as disparity": _disparities(_as_depth),
    "disparity grid a sample off": _disparities(lambda _, d: np.roll(d, 1, axis=1)),
}
