"""The reference rasteriser against brute-force rays in float64."""

from __future__ import annotations

import numpy as np
import pytest

from synthgen.errors import ShapeError
from synthgen.geometry.cameras import camera_from_K, pixel_rays
from synthgen.geometry.raster import pierce, rasterise, split
from synthgen.sampling.streams import stream

K = np.array([[40.0, 0, 15.5], [0, 40.0, 11.5], [0, 0, 1]])


def soup() -> tuple[np.ndarray, np.ndarray]:
    rng = stream(0, "sample", 0, 0, "soup")
    centres = rng.uniform([-0.4, -0.3, 0.8], [0.4, 0.3, 1.6], (30, 1, 3))
    return (centres + rng.normal(0, 0.15, (30, 3, 3))).reshape(-1, 3), np.arange(90).reshape(-1, 3)


def brute(v: np.ndarray, f: np.ndarray, o: np.ndarray, d: np.ndarray) -> tuple[int, float]:
    """Nearest Moeller-Trumbore hit of one ray."""
    best, face = np.inf, -1
    for k, (a, b, c) in enumerate(v[f]):
        p = np.cross(d, c - a)
        det = (b - a) @ p
        if abs(det) < 1e-15:
            continue
        u = (o - a) @ p / det
        q = np.cross(o - a, b - a)
        w, t = d @ q / det, (c - a) @ q / det
        if u >= 0 and w >= 0 and u + w <= 1 and 0 < t < best:
            best, face = t, k
    return face, best


def test_reference_brute_force() -> None:
    v, f = soup()
    camera = camera_from_K(K, 32, 24)
    face, barycentric, z = rasterise(v, f, camera)
    origin, rays = pixel_rays(camera)
    for row in range(24):
        for column in range(32):
            expected, t = brute(v, f, origin, rays[row, column])
            assert face[row, column] == expected
            if expected >= 0:
                hit = origin + t * rays[row, column]
                assert z[row, column] == pytest.approx(hit[2], abs=1e-9)
                np.testing.assert_allclose(
                    barycentric[row, column] @ v[f[expected]], hit, atol=1e-9
                )


def test_reference_brute_force_under_distortion() -> None:
    """Split into small triangles, a distorted view shows what undistorted rays meet."""
    v, f = soup()
    camera = camera_from_K(K, 32, 24, None, np.array([0.12, -0.05, 0.002, -0.001, 0.0]))
    pieces, parts = split(v, f, times=5)
    _, _, z = rasterise(pieces, parts, camera)
    flat = rasterise(pieces, parts, camera_from_K(K, 32, 24))[2]
    origin, rays = pixel_rays(camera)
    expected = np.zeros_like(z)
    for row, column in np.ndindex(z.shape):
        face, t = brute(v, f, origin, rays[row, column])
        expected[row, column] = (t * rays[row, column])[2] if face >= 0 else 0
    assert np.mean(np.abs(z - expected) < 1e-5) > 0.99  # but for a silhouette's pixel or two
    assert np.mean(np.abs(flat - expected) < 1e-5) < 0.9  # distortion is not small here


def test_properties_split_keeps_the_surface() -> None:
    v, f = soup()
    pieces, parts = split(v, f, times=2)
    assert parts.shape == (16 * len(f), 3)

    def area(p: np.ndarray, t: np.ndarray) -> float:
        a, b, c = p[t].transpose(1, 0, 2)
        return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)

    assert area(pieces, parts) == pytest.approx(area(v, f))


def test_edge_empty_and_behind() -> None:
    v, f = soup()
    camera = camera_from_K(K, 32, 24)
    face, _, z = rasterise(v, f[:0], camera)
    assert np.all(face == -1)
    assert np.all(z == 0)
    with pytest.raises(ShapeError, match="behind"):
        rasterise(v - [0, 0, 2], f, camera)


def test_reference_rays_at_pixel_centres_are_what_is_drawn() -> None:
    v, f = soup()
    camera = camera_from_K(K, 32, 24)
    rows, columns = np.mgrid[:24, :32]
    pixels = np.stack([columns.ravel(), rows.ravel()], axis=1)
    drawn, single = rasterise(v, f, camera), pierce(v, f, camera, pixels)
    assert (drawn[0] >= 0).sum() > 100
    for once, again in zip(drawn, single, strict=True):
        np.testing.assert_allclose(again.reshape(once.shape), once, atol=1e-12)
