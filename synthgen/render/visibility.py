"""Keypoints of a hand in a view, and whether each can be seen.

Joints lie 5-34 mm inside the flesh, so depth alone cannot tell: a joint is visible when the first
surface on the way to it is the hand's own skin over that joint (its own, parent or child bone) and
no farther in front of it than the finger is thick.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.cameras import Camera, project, to_camera
from synthgen.models.joints import OPENPOSE21_JOINT
from synthgen.render.labels import NOTHING, Hits, trace
from synthgen.render.upload import LiveScene

Array = NDArray[np.float64]
OUT, OCCLUDED, VISIBLE = 0, 1, 2
# Flesh in front of a joint, over the typical radius there; and the tolerance at a fingertip.
_FLESH, _TIP_M, _BEHIND_M = 2.2, 0.004, 1e-3
_TIPS = (4, 8, 12, 16, 20)


@dataclass(frozen=True, eq=False)
class HandLabels:
    """The 21 keypoints of one hand in one view, OpenPose order.

    ``keypoints_2d`` (21, 2) px in the (distorted) image, ``keypoints_3d`` (21, 3) camera frame,
    metres, ``keypoints_state`` (21,) uint8: 0 out of the frame, 1 occluded, 2 visible.
    """

    keypoints_2d: NDArray[np.float32]
    keypoints_3d: NDArray[np.float32]
    keypoints_state: NDArray[np.uint8]


def label_hand(live: LiveScene, subject: int, keypoints: Array, camera: Camera) -> HandLabels:
    """Label one hand's keypoints.

    Parameters
    ----------
    live : LiveScene
        With the sample uploaded.
    subject : int
        Index of the hand in the scene.
    keypoints : (21, 3)
        World, metres, OpenPose order.
    camera : Camera
    """
    pixels, z = project(camera, keypoints)
    size = np.array([camera.width, camera.height]) - 0.5
    inside = np.all((pixels >= -0.5) & (pixels < size), axis=1) & (z > 0)
    offset = keypoints - camera.position
    away = np.linalg.norm(offset, axis=1)
    hits = trace(live, camera.position, offset / away[:, None])
    seen = _own_flesh(live, subject, hits, away)
    state = np.where(inside, np.where(seen, VISIBLE, OCCLUDED), OUT)
    return HandLabels(
        keypoints_2d=pixels.astype(np.float32),
        keypoints_3d=to_camera(camera, keypoints).astype(np.float32),
        keypoints_state=state.astype(np.uint8),
    )


def _own_flesh(live: LiveScene, subject: int, hits: Hits, away: Array) -> NDArray[np.bool_]:
    """Tell per keypoint whether its ray ends in the skin around it.

    A fingertip is a vertex of that skin: rays aimed at one may slip between its triangles, and then
    end behind it, or nowhere, with nothing before it.
    """
    model, drawn = live.models[subject], live.drawn[subject]
    joints = np.array(OPENPOSE21_JOINT)
    depth = away - hits.distance_m
    limit = _FLESH * model.finger_radius[joints]
    limit[list(_TIPS)] = _TIP_M
    own = hits.solid == subject
    face, inside = drawn.parent(hits.prim, hits.barycentric)
    face = np.where(own, face, 0)
    part = drawn.part(face, inside).astype(np.int64)
    related = np.array([_related(int(p), int(j), model.parents) for p, j in zip(part, joints,
                        strict=True)])  # fmt: skip
    slipped = np.isin(np.arange(len(joints)), _TIPS)
    slipped &= (hits.solid == NOTHING) | (depth < -_BEHIND_M)
    return np.asarray(own & related & (depth <= limit) & (depth >= -_BEHIND_M) | slipped)


def _related(part: int, joint: int, parents: NDArray[np.int64]) -> bool:
    """Skin of a part covers a joint: its own bone, its parent's or its child's; arm and wrist."""
    if part == 17:
        return joint == 0
    bone = part - 1
    return bone == joint or int(parents[bone]) == joint or int(parents[joint]) == bone
