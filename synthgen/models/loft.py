"""An arm, atlas and masks for MANO-form files that bring none.

Never a cut hand: rings are lofted from the wrist's boundary loop along the forearm.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ModelError
from synthgen.geometry.normals import face_cross, unit, vertex_normals
from synthgen.geometry.topology import boundary_loops
from synthgen.models.joints import PART_FOREARM
from synthgen.models.surface import Arm, HandSurface

Array = NDArray[np.float64]

ELBOW_M = 0.25
_RINGS_M = np.concatenate([np.linspace(0.008, 0.20, 17), np.linspace(0.215, 0.56, 18)])
# Girth of the forearm and upper arm over that of the wrist, by distance from the wrist.
_GIRTH = ((0.0, 0.03, 0.08, 0.16, 0.21, 0.25, 0.32, 0.56), (1, 1, 1.12, 1.4, 1.45, 1.4, 1.42, 1.55))


def loft_surface(
    v_template: Array,
    shapedirs: Array,
    faces: NDArray[np.int64],
    weights: Array,
    joints: Array,
    fingertip_ids: NDArray[np.int64],
) -> HandSurface:
    """Build the surface of a bare hand.

    Parameters
    ----------
    v_template : (V, 3), shapedirs : (V, 3, nb), faces : (F, 3), weights : (V, 16)
        As in the model, right or left.
    joints : (16, 3)
        Rest joints, metres.
    fingertip_ids : (5,)

    Raises
    ------
    ModelError
        If the mesh has no single open wrist.
    """
    loops = boundary_loops(faces)
    if len(loops) != 1:
        raise ModelError(f"the hand has {len(loops)} open boundaries; expected one, the wrist")
    loop = loops[0]
    away = unit(joints[0] - joints[[1, 4, 7, 10]].mean(axis=0))
    arm = _loft(v_template, shapedirs, loop, joints[0], away)
    surface_faces = np.concatenate([faces, arm.faces])
    uv, uv_faces = _atlas(v_template, faces, len(loop), len(_RINGS_M), joints)
    n = len(v_template) + len(arm.template)
    palm, nail = np.zeros(n), np.zeros(n)
    palm[: len(v_template)] = _palm(v_template, faces, joints)
    nail[: len(v_template)] = _nails(v_template, faces, weights, joints, fingertip_ids)
    part = np.full(n, PART_FOREARM, dtype=np.uint8)
    part[: len(v_template)] = weights.argmax(axis=1) + 1
    return HandSurface(arm, surface_faces, uv, uv_faces, nail, palm, part)


def _loft(
    vertices: Array, shapedirs: Array, loop: NDArray[np.int64], wrist: Array, away: Array
) -> Arm:
    ring = vertices[loop]
    centre = ring.mean(axis=0)
    along = (ring - centre) @ away
    radial = ring - centre - along[:, None] * away
    radius = np.linalg.norm(radial, axis=1, keepdims=True)
    circle = radial / radius * radius.mean()
    template, weights = [], []
    for u in _RINGS_M:
        round_off = _ramp(u, 0.0, 0.10)
        section = (1 - round_off) * radial + round_off * circle
        girth = np.interp(u, *_GIRTH)
        axial = u + (1 - _ramp(u, 0.0, 0.05)) * along
        template.append(centre + axial[:, None] * away + girth * section)
        fore, upper = _ramp(u, 0.0, 0.05), _ramp(u, ELBOW_M - 0.06, ELBOW_M + 0.06)
        row = [1 - fore, fore * (1 - upper), fore * upper]
        weights.append(np.tile(row, (len(loop), 1)))
    n, count = len(vertices), len(loop)
    ids = np.concatenate([loop, n + np.arange(len(_RINGS_M) * count)]).reshape(-1, count)
    return Arm(
        template=np.concatenate(template),
        shapedirs=np.tile(shapedirs[loop], (len(_RINGS_M), 1, 1)),
        weights=np.concatenate(weights),
        elbow=wrist + ELBOW_M * away,
        elbow_shapedirs=shapedirs[loop].mean(axis=0),
        faces=_tube_faces(ids),
        end_ids=ids[-1],
    )


def _tube_faces(ids: NDArray[np.int64]) -> NDArray[np.int64]:
    """Triangles between consecutive rings; the first ring runs along the hand's own edges."""
    a, b = ids, np.roll(ids, -1, axis=1)
    first = np.stack([b[:-1], a[:-1], a[1:]], axis=-1).reshape(-1, 3)
    second = np.stack([b[:-1], a[1:], b[1:]], axis=-1).reshape(-1, 3)
    return np.concatenate([first, second])


def _ramp(x: float, low: float, high: float) -> float:
    t = float(np.clip((x - low) / (high - low), 0, 1))
    return t * t * (3 - 2 * t)


def _palm(vertices: Array, faces: NDArray[np.int64], joints: Array) -> Array:
    back = _back(vertices, joints)
    facing = vertex_normals(vertices, faces) @ back
    return np.asarray(np.clip(0.5 - 1.2 * facing, 0, 1))


def _back(vertices: Array, joints: Array) -> Array:
    """Direction out of the back of the hand in the flat rest pose: +y in MANO's frame."""
    fingers = unit(joints[[1, 4, 7, 10]].mean(axis=0) - joints[0])
    up = np.array([0.0, 1.0, 0.0])
    return unit(up - (up @ fingers) * fingers)


def _nails(
    vertices: Array, faces: NDArray[np.int64], weights: Array, joints: Array,
    tips: NDArray[np.int64],
) -> Array:  # fmt: skip
    """Mark a patch on the back of each last segment, just behind the tip."""
    normals, back = vertex_normals(vertices, faces), _back(vertices, joints)
    nail = np.zeros(len(vertices))
    for tip, joint in zip(tips, (15, 3, 6, 12, 9), strict=True):
        along = unit(vertices[tip] - joints[joint])
        length = np.linalg.norm(vertices[tip] - joints[joint])
        out = back if joint != 15 else unit(np.cross(along, np.cross(back + 0.8 * _z(), along)))
        behind = (vertices[tip] - vertices) @ along
        own = weights.argmax(axis=1) == joint
        patch = own & (behind > 0.05 * length) & (behind < 0.6 * length) & (normals @ out > 0.6)
        nail[patch] = 1.0
    return nail


def _z() -> Array:
    return np.array([0.0, 0.0, 1.0])


def _atlas(
    vertices: Array, faces: NDArray[np.int64], count: int, rings: int, joints: Array
) -> tuple[Array, NDArray[np.int64]]:
    """Two flat charts (back, palm) of the hand above one strip for the arm."""
    back = _back(vertices, joints)
    fingers = unit(joints[[1, 4, 7, 10]].mean(axis=0) - joints[0])
    flat = np.stack([vertices @ fingers, vertices @ np.cross(fingers, back)], axis=1)
    flat = (flat - flat.min(axis=0)) / np.ptp(flat, axis=0).max()
    palmar = (face_cross(vertices, faces) @ back < 0).astype(np.int64)
    charts = np.concatenate([flat * 0.48 + [0.01, 0.35], flat * 0.48 + [0.51, 0.35]])
    hand_faces = faces + palmar[:, None] * len(vertices)
    u, v = np.meshgrid(np.linspace(0.02, 0.98, rings + 1), np.linspace(0.02, 0.30, count + 1))
    strip = np.stack([u.T.ravel(), v.T.ravel()], axis=1)
    ids = 2 * len(vertices) + np.arange((rings + 1) * (count + 1)).reshape(rings + 1, count + 1)
    a, b = ids[:, :-1], ids[:, 1:]
    first = np.stack([b[:-1], a[:-1], a[1:]], axis=-1).reshape(-1, 3)
    second = np.stack([b[:-1], a[1:], b[1:]], axis=-1).reshape(-1, 3)
    # Of either chart only the half that faces its way is used.
    used, faces = np.unique(np.concatenate([hand_faces, first, second]), return_inverse=True)
    return np.concatenate([charts, strip])[used], faces.reshape(-1, 3).astype(np.int64)
