"""Mirroring is exact, and its own inverse."""

from __future__ import annotations

import numpy as np

from synthgen.models import load, mirror_model, mirror_pose, pose_surface
from synthgen.sampling.streams import stream

M = np.array([-1.0, 1.0, 1.0])


def test_reference_left_is_the_mirrored_right() -> None:
    right, left = load("cc0-hand", hand="right"), load("cc0-hand", hand="left")
    rng = stream(0, "sample", 0, 0, "mirror")
    shape, pose, move = rng.normal(size=(3, 10)), rng.normal(0, 0.6, (3, 16, 3)), np.zeros((3, 3))
    a, _ = right.evaluate_reference(shape, pose, move)
    b, _ = left.evaluate_reference(shape, mirror_pose(pose), move)
    np.testing.assert_allclose(b, a * M, atol=1e-12)
    np.testing.assert_array_equal(left.faces, right.faces[:, ::-1])


def test_properties_arm_too() -> None:
    right, left = load("cc0-hand", hand="right"), load("cc0-hand", hand="left")
    pose = stream(0, "sample", 0, 0, "arm").normal(0, 0.4, (16, 3))
    wrist, elbow = np.array([0.2, 0.1, 0.3]), np.array([0.0, 1.0, 0.4])
    a, _ = pose_surface(right, np.ones(10), pose, np.zeros(3), wrist, elbow)
    b, _ = pose_surface(left, np.ones(10), mirror_pose(pose), np.zeros(3), mirror_pose(wrist),
                        mirror_pose(elbow))  # fmt: skip
    np.testing.assert_allclose(b, a * M, atol=1e-6)


def test_properties_twice_is_the_identity() -> None:
    model = load("cc0-hand", hand="right")
    again = mirror_model(mirror_model(model))
    for name in ("v_template", "shapedirs", "posedirs", "faces", "hands_mean", "hands_components"):
        np.testing.assert_array_equal(getattr(again, name), getattr(model, name))
    np.testing.assert_array_equal(again.surface.arm.template, model.surface.arm.template)
    assert again.hand == model.hand
