"""The kinematic chain in NumPy, float64: from local rotations to maps of the rest pose."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def chain(rotations: Array, joints: Array, parents: NDArray[np.int64]) -> Array:
    """Compose joint placements (B, K, 4, 4) from local rotations and rest joints (B, K, 3)."""
    n, k = joints.shape[:2]
    G = np.zeros((n, k, 4, 4))
    G[..., 3, 3] = 1
    for j, p in enumerate(parents):
        if p < 0:
            G[:, j, :3, :3], G[:, j, :3, 3] = rotations[:, j], joints[:, j]
            continue
        G[:, j, :3, :3] = G[:, p, :3, :3] @ rotations[:, j]
        offset = (joints[:, j] - joints[:, p])[..., None]
        G[:, j, :3, 3] = G[:, p, :3, 3] + (G[:, p, :3, :3] @ offset)[..., 0]
    return G


def skinning_transforms(transforms: Array, joints: Array) -> Array:
    """Return (B, K, 3, 4) maps from rest-pose points to posed points."""
    A = transforms[..., :3, :].copy()
    A[..., 3] -= (A[..., :3] @ joints[..., None])[..., 0]
    return A
