"""Bodies and their parts as something to scan."""

from __future__ import annotations

import numpy as np
import pytest

from synthgen.errors import ModelError, ShapeError
from synthgen.geometry.topology import boundary_edges, pieces
from synthgen.models import load
from synthgen.scanner import CropPlane, ScanScene, body_scene, centred, load_rig, standing

BODY = load("cc0-body")
SUPR = load("cc0-supr")


def box(scene: ScanScene) -> np.ndarray:
    points = np.concatenate([solid.vertices for solid in scene.solids])
    return np.stack([points.min(axis=0), points.max(axis=0)])


def test_smoke_a_dressed_body_stands_on_the_floor() -> None:
    rig = load_rig("body22")
    scene = standing(body_scene(BODY, levels=1), rig)
    assert len(scene.solids) == 3  # skin, eyes, garment
    low, high = box(scene)
    assert low[1] == pytest.approx(-1.05)
    assert 1.5 < high[1] - low[1] < 1.9
    assert abs(low[0] + high[0]) < 1e-9
    garment = scene.solids[2]
    assert garment.colours is not None
    assert garment.colours.max() < 0.35, "dark cloth"
    assert garment.surface.subsurface == 0


def test_reference_the_skin_is_the_models() -> None:
    """Refinement passes through the model's vertices; the pose is the model's."""
    pose = np.zeros((52, 3))
    pose[16, 2] = -0.8
    shape = np.linspace(-1, 1, 16)
    skin = body_scene(BODY, shape, pose, wear=(), levels=1).solids[0]
    vertices = BODY.evaluate(shape[None], pose[None]).vertices[0]
    np.testing.assert_allclose(skin.vertices[: len(vertices)], vertices, atol=1e-6)


def test_properties_a_head_is_cut_and_closed() -> None:
    head = centred(
        body_scene(SUPR, wear=("eyes",), keep=(CropPlane((0, 0.48, 0), (0, 1, 0)),), levels=1)
    )
    assert len(head.solids) == 2
    skin, eyes = head.solids
    # The lid has a rim of its own, so that it is a sharp edge; there is no other border.
    rim = np.unique(boundary_edges(skin.faces))
    height = skin.vertices[rim, 1]
    assert np.ptp(height) < 1e-9
    assert len(np.unique(skin.vertices[rim].round(9), axis=0)) * 2 == len(rim)
    assert len(np.unique(pieces(eyes.faces, len(eyes.vertices)))) > 1
    size = np.ptp(box(head), axis=0)
    assert (size < 0.45).all()
    np.testing.assert_allclose(box(head).sum(axis=0), 0, atol=1e-9)


def test_properties_a_pressed_foot_is_flat_on_the_glass() -> None:
    rig = load_rig("foot10")
    assert rig.glass is not None
    planes = CropPlane((0, 0, 0), (1, 0, 0)), CropPlane((0, -0.8, 0), (0, -1, 0))
    flat, free = (
        standing(body_scene(SUPR, wear=(), keep=planes, pressed=p, levels=0), rig).solids[0]
        for p in (True, False)
    )
    assert flat.vertices[:, 1].min() == pytest.approx(rig.glass.top_m)
    low, usual = ((s.vertices[:, 1] < rig.glass.top_m + 0.001).sum() for s in (flat, free))
    assert low > 1.5 * usual
    assert (flat.vertices[:, 0] > -0.1).all()


def test_edge_unknown_wear_and_no_feet() -> None:
    with pytest.raises(ModelError, match=r"no 'garmet' - did you mean 'garment'"):
        body_scene(BODY, wear=("garmet",), levels=0)
    with pytest.raises(ModelError, match="foot networks"):
        body_scene(BODY, pressed=True, levels=0)
    with pytest.raises(ShapeError, match="kept side"):
        body_scene(BODY, keep=(CropPlane((0, 9, 0), (0, 1, 0)),), levels=0)
