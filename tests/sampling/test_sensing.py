"""Drawn lenses: every one that may be drawn can be inverted over the whole frame."""

from __future__ import annotations

import numpy as np
import pytest

from synthgen.geometry.cameras import pixel_rays, project
from synthgen.sampling.placement import Lens
from synthgen.sampling.sensing import distorted
from synthgen.sampling.streams import stream

NONE = np.zeros((0, 3))


@pytest.mark.parametrize("size", [(48, 48), (64, 36), (24, 64)])
@pytest.mark.parametrize("fov_deg", [5.0, 120.0])
def test_properties_no_lens_folds_the_picture(size: tuple[int, int], fov_deg: float) -> None:
    focal = max(size) / 2 / np.tan(np.deg2rad(fov_deg) / 2)
    plain = Lens(*size, focal, fov_deg).camera(np.eye(4))
    reach = ((size[0] / 2) ** 2 + (size[1] / 2) ** 2) / focal**2
    moved = []
    for index in range(60):
        (camera,) = distorted((plain,), 0.2, NONE, rng=stream(0, "sample", index, 0, "distortion"))
        rays = pixel_rays(camera)[1]
        pixels, _ = project(camera, rays)
        v, u = np.mgrid[: size[1], : size[0]]
        np.testing.assert_allclose(pixels, np.stack([u, v], axis=-1), atol=1e-6)
        moved.append(camera.distortion[0] * reach)
    assert min(moved) < -0.1
    assert max(moved) > 0.18


def test_reference_weak_lenses_are_as_drawn() -> None:
    plain = Lens(64, 48, 60.0, 56.0).camera(np.eye(4))
    reach = (32**2 + 24**2) / 60.0**2
    for index in range(40):
        key = (0, "sample", index, 0, "distortion")
        (camera,) = distorted((plain,), 0.05, NONE, rng=stream(*key))
        rng = stream(*key)
        wanted, (p1, p2) = rng.uniform(-0.05, 0.05), 0.05 * rng.normal(0, 0.1, 2)
        found = np.array(camera.distortion) * [reach, 0, *[np.sqrt(reach)] * 2, 0]
        np.testing.assert_allclose(found, [wanted, 0, p1, p2, 0], atol=1e-8)


def test_properties_barrels_do_not_bring_the_arms_open_end_into_the_picture() -> None:
    """An end just outside the frame stays there; lenses that leave it there stay as drawn."""
    plain = Lens(64, 48, 60.0, 56.0).camera(np.eye(4))
    end = np.array([[-33.5, 22.0, 60.0]]) / 120  # at pixel (-2, 45.5)
    weaker = 0
    for index in range(60):
        drawn, kept = (
            distorted((plain,), 0.15, e, rng=stream(0, "sample", index, 0, "distortion"))[0]
            for e in (NONE, end)
        )
        assert project(kept, end)[0][0, 0] < -0.5
        assert (drawn == kept) == (project(drawn, end)[0][0, 0] < -0.5)
        weaker += drawn != kept
    assert 10 < weaker < 50


def test_edge_no_distortion() -> None:
    plain = Lens(64, 48, 60.0, 56.0).camera(np.eye(4))
    assert distorted((plain,), 0.0, NONE, rng=stream(0, "sample", 0, 0, "x")) == (plain,)
