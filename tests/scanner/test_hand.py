"""Hands as something to scan."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from synthgen.config import load_config
from synthgen.errors import ShapeError
from synthgen.geometry.rotations import matrix_from_axis_angle
from synthgen.models import load, pose_surface
from synthgen.sampling.draw import draw_sample
from synthgen.scanner.cap import cut_and_cap
from synthgen.scanner.hand import hand_solid, moved_subject, put_in_rig
from synthgen.scanner.segment import CropPlane

SUBJECT = draw_sample(load_config("hand_rgbd", []), 0).scene.subjects[0]


def test_smoke_hand_is_closed_and_coloured() -> None:
    hand = hand_solid(SUBJECT)
    mesh = trimesh.Trimesh(hand.solid.vertices, hand.solid.faces, process=False)
    assert mesh.is_watertight
    assert 1e-4 < mesh.volume < 1e-3
    assert hand.solid.colours is not None
    assert 0 < hand.solid.colours.min() < hand.solid.colours.max() < 1
    assert hand.wrist.keeps(hand.joints[1:]).all()
    assert not hand.wrist.keeps(hand.solid.vertices).all()


def test_reference_points_lie_on_the_model() -> None:
    hand = hand_solid(SUBJECT)
    model = load(SUBJECT.model, hand=SUBJECT.hand)
    points, _ = pose_surface(
        model, np.array(SUBJECT.shape), np.array(SUBJECT.pose), np.array(SUBJECT.translation_m),
        np.array(SUBJECT.wrist), np.array(SUBJECT.elbow),
    )  # fmt: skip
    own = np.flatnonzero(hand.source >= 0)[::50]
    middle = np.full((len(own), 3), 1 / 3)
    face, inside = hand.on_model(own, middle)
    there = np.einsum("nk,nkj->nj", inside, points[model.surface.faces[face]])
    drawn = hand.solid.vertices[hand.solid.faces[own]].mean(axis=1)
    away = np.linalg.norm(there - drawn, axis=1)
    assert np.median(away) < 0.0004, "the drawn surface bulges a little over the model's faces"
    assert away.max() < 0.004
    assert (hand.on_model(np.flatnonzero(hand.source < 0), middle[:1])[0] == -1).all()


def test_reference_moved_subject() -> None:
    R = matrix_from_axis_angle(np.array([0.3, -1.0, 0.4]))
    shift = np.array([0.1, 0.2, -0.3])
    moved = hand_solid(moved_subject(SUBJECT, R, shift)).solid.vertices
    assert moved == pytest.approx(hand_solid(SUBJECT).solid.vertices @ R.T + shift, abs=1e-6)


def test_properties_put_in_rig_stands_upright() -> None:
    for spin in (0.0, 2.0):
        hand = hand_solid(put_in_rig(SUBJECT, spin))
        box = hand.solid.vertices
        assert np.abs(box.min(axis=0) + box.max(axis=0)).max() < 1e-6
        along = hand.joints[7] - hand.joints[0]
        assert along[1] > 0.95 * np.linalg.norm(along)


def test_edge_cut_and_cap() -> None:
    box = trimesh.creation.box((1, 1, 1)).subdivide().subdivide()
    vertices, faces, source = cut_and_cap(box.vertices, box.faces, CropPlane((0, 0, 0), (0, 1, 0)))
    half = trimesh.Trimesh(vertices, faces, process=False)
    assert half.is_watertight
    assert half.volume == pytest.approx(0.5)
    assert (source == -1).sum() == 16
    with pytest.raises(ShapeError, match="turn its normal"):
        cut_and_cap(box.vertices, box.faces, CropPlane((0, 9, 0), (0, 1, 0)))
