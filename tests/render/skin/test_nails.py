"""Nails: five plates of the right size, with root, edge and fold."""

from __future__ import annotations

import numpy as np
import pytest

from synthgen.models import load
from synthgen.render.skin.nails import Nails, lay_nails
from synthgen.render.skin.sites import Sites, atlas_sites
from synthgen.scene.anatomy import anatomy_of


@pytest.fixture(scope="module")
def laid() -> tuple[Sites, Nails]:
    model = load("cc0-hand")
    sites, _ = atlas_sites(model, 512)
    return sites, lay_nails(sites, anatomy_of(model))


def test_smoke_shapes(laid: tuple[Sites, Nails]) -> None:
    sites, nails = laid
    for values in (nails.plate, nails.along, nails.across, nails.cuticle, nails.height):
        assert values.shape == (len(sites.points),)


def test_reference_plates_lie_on_the_backs_of_the_last_segments(
    laid: tuple[Sites, Nails],
) -> None:
    sites, nails = laid
    plate = nails.plate > 0.5
    assert sites.weights[plate][:, [3, 6, 9, 12, 15]].sum(axis=1).min() > 0.4
    for nail_joint, finger in zip((3, 6, 9, 12, 15), anatomy_of(load("cc0-hand")).fingers,
                                  strict=True):  # fmt: skip
        own = plate & (sites.weights[:, nail_joint] > 0.5)
        assert own.sum() > 40
        assert (sites.normals[own] @ finger.back).mean() > 0.6


def test_properties_coordinates_run_from_root_to_free_edge(laid: tuple[Sites, Nails]) -> None:
    sites, nails = laid
    finger = anatomy_of(load("cc0-hand")).fingers[1]
    own = (nails.plate > 0.5) & (sites.weights[:, 6] > 0.5)
    along = (sites.points[own] - finger.points[2]) @ (finger.points[3] - finger.points[2])
    assert np.corrcoef(along, nails.along[own])[0, 1] > 0.99
    assert np.abs(nails.across[own]).max() < 1.1
    assert (nails.along[~(nails.plate > 0) & ~(nails.cuticle > 0)] >= 0.99).mean() > 0.9


def test_properties_the_fold_rings_the_plate(laid: tuple[Sites, Nails]) -> None:
    sites, nails = laid
    fold = sites.points[nails.cuticle > 0.5]
    plate = sites.points[nails.plate > 0.5]
    away = np.linalg.norm(fold[:, None] - plate[None], axis=2).min(axis=1)
    assert np.quantile(away, 0.95) < 2 * sites.spacing_m + 0.0005


def test_edge_a_mesh_without_nails(laid: tuple[Sites, Nails]) -> None:
    from dataclasses import replace

    anatomy = anatomy_of(load("cc0-hand"))
    bald = replace(anatomy, fingers=tuple(replace(f, nail=None) for f in anatomy.fingers))
    nails = lay_nails(laid[0], bald)
    assert nails.plate.max() == nails.cuticle.max() == np.abs(nails.height).max() == 0
