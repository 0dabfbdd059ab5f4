"""Light under the skin: edges soften red first, highlights and other pixels stay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from synthgen.geometry.cameras import Camera, camera_from_K
from synthgen.render.diffusion import diffuse
from synthgen.render.labels import Labels

SIZE = 64


@pytest.fixture
def labels() -> Labels:
    shape = (SIZE, SIZE)
    part = np.zeros(shape, np.uint8)
    part[8:56, 8:56] = 1
    flat = np.zeros((*shape, 3), np.float32)
    return Labels(
        depth_z_m=np.full(shape, 0.5, np.float32), distance_m=np.full(shape, 0.5, np.float32),
        normals=flat, uv=flat[..., :2], part_id=part, instance_id=(part > 0).astype(np.uint8),
        face_id=np.zeros(shape, np.int32), barycentric=flat, valid=np.ones(shape, bool),
    )  # fmt: skip


@pytest.fixture
def camera() -> Camera:
    """One pixel is half a millimetre."""
    return camera_from_K(np.array([[1000.0, 0, 31.5], [0, 1000.0, 31.5], [0, 0, 1]]), SIZE, SIZE)


def albedo() -> np.ndarray:
    return np.broadcast_to(np.float32([0.5, 0.3, 0.2]), (SIZE, SIZE, 3)).copy()


def test_properties_even_light_stays(labels: Labels, camera: Camera) -> None:
    picture = albedo() * np.float32(0.7)
    np.testing.assert_allclose(diffuse(picture, albedo(), labels, camera), picture, rtol=1e-4)


def test_properties_a_shadows_edge_softens_red_most(labels: Labels, camera: Camera) -> None:
    light = np.where(np.arange(SIZE) < 32, 0.8, 0.6).astype(np.float32)[None, :, None]
    done = diffuse(albedo() * light, albedo(), labels, camera) / albedo()
    step = np.abs(done[32, 33] - done[32, 30])
    assert step[0] < step[1] < step[2] < 0.2 + 1e-4
    assert step[0] < 0.15


def test_properties_texture_stays_as_sharp_as_the_albedo(labels: Labels, camera: Camera) -> None:
    tint = albedo()
    tint[:, ::2] *= 0.6
    np.testing.assert_allclose(diffuse(tint, tint, labels, camera), tint, rtol=1e-4)


def test_properties_highlights_do_not_spread(labels: Labels, camera: Camera) -> None:
    """A bright spot stays a spot: beside it little more than the even light."""
    picture = albedo() * np.float32(0.5)
    picture[32, 32] += 20.0
    done = diffuse(picture, albedo(), labels, camera)
    assert done[32, 32].min() > 10
    assert np.all(done[32, 36] < 1.5 * picture[32, 36])


def test_properties_other_pixels_are_untouched(labels: Labels, camera: Camera) -> None:
    rng = np.linspace(0, 1, SIZE * SIZE * 3, dtype=np.float32).reshape(SIZE, SIZE, 3)
    done = diffuse(rng, albedo(), labels, camera)
    off = labels.part_id == 0
    np.testing.assert_array_equal(done[off], rng[off])


def test_edge_no_skin(labels: Labels, camera: Camera) -> None:
    none = replace(labels, part_id=np.zeros_like(labels.part_id))
    picture = albedo()
    assert diffuse(picture, albedo(), none, camera) is picture
