"""Hands as something to scan."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh

from synthgen.config import load_config
from synthgen.errors import ShapeError
from synthgen.geometry.rotations import matrix_from_axis_angle
from synthgen.models import load, pose_surface
from synthgen.sampling.draw import draw_sample
from synthgen.scanner.cap import cut_and_cap
from synthgen.scanner.hand import BEHIND_WRIST_M, hand_solid, moved_subject, put_in_rig
from synthgen.scanner.segment import CropPlane, wrist_plane

SUBJECT = draw_sample(load_config("hand_rgbd", []), 0).scene.subjects[0]


def welded(vertices: Any, faces: Any) -> trimesh.Trimesh:
    """Join the lid with its rim: they share no vertices, so that the edge is sharp."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.merge_vertices()
    return mesh


def test_smoke_hand_is_closed_and_coloured() -> None:
    hand = hand_solid(SUBJECT)
    mesh = welded(hand.solid.vertices, hand.solid.faces)
    assert mesh.is_watertight
    assert mesh.body_count == 1
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
    for side in ("left", "right"):  # seen from the front the index finger is to the left of both
        asked = [f"model.hands={side}"]
        subject = draw_sample(load_config("hand_rgbd", asked), 0).scene.subjects[0]
        joints = hand_solid(put_in_rig(subject)).joints
        assert joints[1, 0] < joints[7, 0] - 0.02


def test_properties_skin_scatters_as_the_sample_says() -> None:
    skin = replace(SUBJECT.skin, roughness=0.61)
    assert hand_solid(replace(SUBJECT, skin=skin)).solid.surface.roughness == 0.61


def test_properties_wrist_is_cut_straight() -> None:
    hand = hand_solid(SUBJECT)
    away = wrist_plane(hand.joints, BEHIND_WRIST_M).side(hand.solid.vertices)
    assert away.min() > -2e-6
    lid = np.unique(hand.solid.faces[hand.source < 0])
    assert np.abs(away[lid]).max() < 2e-6


def test_properties_an_arm_that_is_bent_back_is_no_part_of_the_hand() -> None:
    bent = replace(SUBJECT, elbow=(0.0, 0.9, 1.8))
    for subject in (SUBJECT, bent):
        hand = hand_solid(subject)
        assert welded(hand.solid.vertices, hand.solid.faces).body_count == 1
    apart = cut_and_cap(
        *two_boxes(), CropPlane((0, 0, 0), (0, 1, 0))
    )  # the second box reaches less far above the plane
    assert apart.vertices[:, 0].max() < 1


def two_boxes() -> tuple[Any, Any]:
    small = trimesh.creation.box((1, 0.2, 1)).apply_translation((3, 0, 0))
    both = trimesh.util.concatenate([trimesh.creation.box((1, 1, 1)).subdivide(), small])
    return both.vertices, both.faces


def test_edge_cut_and_cap() -> None:
    box = trimesh.creation.box((1, 1, 1)).subdivide().subdivide()
    cut = cut_and_cap(box.vertices, box.faces, CropPlane((0, 0, 0), (0, 1, 0)))
    half = welded(cut.vertices, cut.faces)
    assert half.is_watertight
    assert half.volume == pytest.approx(0.5)
    assert (cut.source == -1).sum() == 16
    with pytest.raises(ShapeError, match="turn its normal"):
        cut_and_cap(box.vertices, box.faces, CropPlane((0, 9, 0), (0, 1, 0)))


def test_reference_slanted_cut_of_a_ball() -> None:
    """The two sides of a cut through triangles are the whole: area, volume, attributes, corners."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    height = ball.vertices @ np.array([[1.0], [2.0], [3.0]])
    tagged = np.concatenate([ball.vertices, height], axis=1)
    area = volume = 0.0
    for sign in (1.0, -1.0):
        plane = CropPlane((0.03, 0.08, -0.05), (0.3 * sign, 0.8 * sign, -0.5 * sign))
        cut = cut_and_cap(tagged, ball.faces, plane)
        place, own = cut.vertices[:, :3], cut.source >= 0
        assert plane.side(place).min() > -2e-6
        assert welded(place, cut.faces).is_watertight
        volume += welded(place, cut.faces).volume
        area += trimesh.Trimesh(place, cut.faces[own], process=False).area
        assert cut.vertices[:, 3] == pytest.approx(place @ [1, 2, 3], abs=1e-12)
        parents = ball.vertices[ball.faces[cut.source[own]]]
        there = np.einsum("gij,gjk->gik", cut.corners[own], parents)
        assert there == pytest.approx(place[cut.faces[own]], abs=1e-12)
    assert area == pytest.approx(ball.area, rel=1e-9)
    assert volume == pytest.approx(ball.volume, rel=1e-9)
