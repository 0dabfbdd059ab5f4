"""Worn things: around the skin, not in it, and where the pose carries them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from synthgen.config import load_config
from synthgen.models import load
from synthgen.sampling.draw import draw_sample, surface_of
from synthgen.scene import Band, HandSubject, Sleeve
from synthgen.scene.surface import DrawnSurface
from synthgen.scene.wear import dress

CLOTH = Sleeve(0.06, 0.005, 0.0015, (0.1,) * 3, (0.5,) * 3, "plain", 7)
RING = Band("ring", 10, 0.62, 0.004, 0.0015, (0.9, 0.7, 0.3), True)
WATCH = Band("watch", 0, 0.03, 0.018, 0.0025, (0.02,) * 3, False)


def worn(index: int) -> tuple[HandSubject, np.ndarray]:
    subject = draw_sample(load_config("hand_rgbd"), index).scene.subjects[0]
    # A straight elbow: inside a bent one, skin and cloth both fold into themselves.
    subject = replace(subject, sleeve=CLOTH, bands=(RING, WATCH), elbow=(0.0, 0.0, 0.0))
    return subject, surface_of(load(subject.model, hand=subject.hand), subject)


@pytest.mark.parametrize("index", range(4))
def test_properties_around_the_skin(index: int) -> None:
    """Sleeves and bands lie near the skin, and outside it."""
    subject, surface = worn(index)
    model = load(subject.model, hand=subject.hand)
    drawn = DrawnSurface.for_model(model)
    skin = drawn.refine(surface)
    tree = cKDTree(skin)
    dressed = dress(model, subject)
    assert dressed.sleeve is not None
    _, normals = drawn.draw(surface)
    outward = np.zeros_like(skin)
    outward[drawn.source] = normals
    for mesh, near in ((dressed.sleeve, 0.03), (dressed.bands[0], 0.012), (dressed.bands[1], 0.02)):
        gap, row = tree.query(mesh.vertices)
        assert np.median(gap) < near
        side = np.einsum("ni,ni->n", mesh.vertices - skin[row], outward[row])
        assert np.mean(side < -0.002) < 0.05


def test_properties_the_sleeve_is_as_slack_as_asked() -> None:
    subject, _ = worn(0)
    model = load(subject.model, hand=subject.hand)
    tight, loose = (
        dress(model, replace(subject, sleeve=replace(CLOTH, slack_m=s, fold_m=0.0))).sleeve
        for s in (0.004, 0.009)
    )
    assert tight is not None
    assert loose is not None
    apart = np.linalg.norm(loose.vertices - tight.vertices, axis=1)
    assert np.median(apart) == pytest.approx(0.005, rel=0.05)


def test_properties_mirrored_hands_wear_mirrored_things() -> None:
    subject, _ = worn(1)
    for hand in ("left", "right"):
        model = load(subject.model, hand=hand)
        for band in dress(model, replace(subject, hand=hand)).bands:
            a, b, c = (band.vertices[band.triangles[:, k]] for k in range(3))
            normal = np.cross(b - a, c - a)
            out = np.einsum("ni,ni->n", normal, band.normals[band.triangles].sum(axis=1))
            assert np.mean(out >= 0) > 0.99


def test_edge_nothing_worn() -> None:
    subject = draw_sample(load_config("hand_rgbd"), 0).scene.subjects[0]
    dressed = dress(load(subject.model, hand=subject.hand), subject)
    assert dressed.sleeve is None
    assert dressed.bands == ()
