"""Self-penetration: known depths on bodies made for it, and on the shipped hand."""

from __future__ import annotations

import numpy as np
import pytest

from synthgen.models import ManoModel, load
from synthgen.sampling.penetration import part_of_finger, probe_of


@pytest.fixture(scope="module")
def hand() -> ManoModel:
    return load("cc0-hand", hand="right")


def curled(joints: list[int], model: ManoModel, degrees: float) -> np.ndarray:
    """Pose with the given joints flexed about the model's own flexion axes."""
    pose = np.zeros((16, 3))
    axes = np.asarray(model.joint_axes)
    for joint in joints:
        pose[joint] = np.deg2rad(degrees) * axes[joint, 0]
    return pose


def vertices(model: ManoModel, pose: np.ndarray) -> np.ndarray:
    return model.evaluate(np.zeros((1, 10)), pose[None]).vertices[0]


def test_smoke_rest_pose_is_free(hand: ManoModel) -> None:
    assert probe_of(hand).depth_m(hand.v_template) == 0.0


def test_properties_finger_through_palm_is_deep(hand: ManoModel) -> None:
    through = vertices(hand, curled([4, 5, 6], hand, 115.0))
    assert probe_of(hand).depth_m(through) > 0.004


def test_reference_a_finger_pushed_into_its_neighbour(hand: ManoModel) -> None:
    """Pushing the index finger 2 mm farther into the middle one makes it about 2 mm deeper."""
    points = np.array(hand.v_template, dtype=np.float64)
    index = part_of_finger(hand) == 1
    depths = []
    for push in np.arange(0, 0.03, 0.001):
        moved = points.copy()
        moved[index, 2] -= push
        depths.append(probe_of(hand).depth_m(moved))
    touch = int(np.argmax(np.array(depths) > 0))
    assert depths[0] == 0
    assert touch > 2
    assert depths[touch + 2] - depths[touch] == pytest.approx(0.002, abs=0.001)


def test_properties_moving_the_whole_hand_changes_nothing(hand: ManoModel) -> None:
    fist = vertices(hand, curled([4, 5, 6], hand, 100.0)).astype(np.float64)
    turned = fist[:, [2, 0, 1]] + [0.3, -1.0, 2.0]
    probe = probe_of(hand)
    assert probe.depth_m(turned) == pytest.approx(probe.depth_m(fist), abs=1e-6)
