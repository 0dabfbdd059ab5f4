"""Whether what a file holds for pictures fits its model: texture coordinates, masks, the arm.

Published files have none of these keys; files of synthgen do, and a user may add them.
"""

from __future__ import annotations

import numpy as np

from synthgen.models.content import Content

_ARM = (
    "arm_template", "arm_shapedirs", "arm_weights", "arm_elbow", "arm_elbow_shapedirs",
    "arm_faces", "arm_end_ids", "uv", "uv_faces", "mask_nail", "mask_palm",
)  # fmt: skip
Shape = tuple[int | None, ...]


def check_drawn_keys(content: Content) -> None:
    """Check those of the keys that the file has; of an arm it must have all.

    Raises
    ------
    ModelError
        Naming file, key, what was found and what was expected.
    """
    arrays = content.arrays
    arm = "arm_template" in arrays
    missing = [key for key in _ARM if arm and key not in arrays]
    if missing:
        raise content.fail(f"no {', '.join(missing)}; a file with an arm has {', '.join(_ARM)}")
    v, _, components = arrays["shapedirs"].shape
    n_arm = len(_of_shape(content, "arm_template", (None, 3))) if arm else 0
    n_arm_faces = len(_of_shape(content, "arm_faces", (None, 3))) if arm else 0
    shapes: dict[str, Shape] = {
        "arm_shapedirs": (n_arm, 3, components),
        "arm_weights": (n_arm, 3),
        "arm_elbow": (3,),
        "arm_elbow_shapedirs": (3, components),
        "arm_end_ids": (None,),
        "uv": (None, 2),
        "uv_faces": (len(arrays["f"]) + n_arm_faces, 3),
        **{key: (v + n_arm,) for key in arrays if key.startswith("mask_")},
    }
    for key, shape in shapes.items():
        if key in arrays:
            _of_shape(content, key, shape)
    for key in ("arm_faces", "arm_end_ids"):
        _check_ids(content, key, v + n_arm, "vertices of the hand and its arm")
    if "uv_faces" in arrays:
        _check_ids(content, "uv_faces", len(arrays.get("uv", ())), "texture coordinates (uv)")
    if arm:
        off = np.abs(content.numbers("arm_weights").sum(axis=1) - 1).max(initial=0.0)
        if off > 1e-3:
            raise content.fail(f"arm_weights do not sum to 1 (one row is {off:.3g} off)")


def _of_shape(content: Content, key: str, shape: Shape) -> np.ndarray[tuple[int, ...], np.dtype]:
    """Return finite numbers of a shape; None stands for any length but 0."""
    values = content.numbers(key)
    fits = values.ndim == len(shape) and all(
        n == m if m is not None else n > 0 for n, m in zip(values.shape, shape, strict=True)
    )
    if not fits:
        words = ", ".join("n" if n is None else str(n) for n in shape)
        raise content.fail(f"{key} is {values.shape}; expected ({words})")
    if not np.isfinite(values).all():
        raise content.fail(f"{key} holds NaN or infinity; expected finite numbers")
    return values


def _check_ids(content: Content, key: str, n: int, what: str) -> None:
    if key not in content.arrays:
        return
    ids = content.numbers(key)
    if (ids % 1).any() or ids.min(initial=0) < 0 or ids.max(initial=-1) >= n:
        raise content.fail(
            f"{key} refers to {ids.max(initial=-1):.6g} (lowest {ids.min(initial=0):.6g}); "
            f"expected whole numbers from 0 to {n - 1}, for {n} {what}"
        )
