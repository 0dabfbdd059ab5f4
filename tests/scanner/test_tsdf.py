"""Range grids, fusion and the surface that comes of it."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree
from speckle import Sphere, ring_of_grids

from synthgen.errors import ScanError
from synthgen.geometry.topology import boundary_edges
from synthgen.sampling.streams import stream
from synthgen.scanner import tsdf
from synthgen.scanner.isosurface import extract
from synthgen.scanner.provenance import measured_by, truth_of
from synthgen.scanner.range_grid import bridged
from synthgen.scanner.subject import scene_of
from synthgen.scanner.support import cut_unsupported
from synthgen.scanner.tsdf import BRICK, Field, FusionSettings, fuse

RADIUS = 0.02
BALL = Sphere(RADIUS)
SETTINGS = FusionSettings(voxel_m=0.001)


@pytest.fixture(scope="module")
def around() -> list[Any]:
    return ring_of_grids(BALL, range(0, 360, 60), (-40, 40))


@pytest.fixture(scope="module")
def front() -> list[Any]:
    return ring_of_grids(BALL, [0, 50], [0])


def test_reference_range_grid_lies_on_the_sphere(front: list[Any]) -> None:
    grid = front[0]
    points, normals = grid.world_points(), grid.world_normals()
    assert len(points) > 3000
    radius = np.linalg.norm(points, axis=1)
    assert np.abs(radius - RADIUS).max() < 1e-6
    assert np.einsum("nk,nk->n", points / radius[:, None], normals).min() > 0.97
    assert np.nanmin(grid.facing) > 0.25
    assert np.nanmedian(grid.sigma_m) == pytest.approx(0.01 * 0.58**2 / (3243 * 0.12), rel=0.05)


def test_reference_closed_sphere(around: list[Any]) -> None:
    vertices, faces = extract(fuse(around, SETTINGS), 200)
    ball = trimesh.Trimesh(vertices, faces, process=False)
    assert ball.is_watertight
    assert ball.volume == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.002), "faces look outwards"
    error = np.linalg.norm(vertices, axis=1) - RADIUS
    assert np.sqrt(np.mean(error**2)) < 1e-5


def test_properties_real_holes_stay_open(front: list[Any]) -> None:
    """What no unit saw has no face; filling closes nothing that it should not reach."""
    field = fuse(front, SETTINGS)
    vertices, faces = extract(field, 200)
    assert len(boundary_edges(faces)) > 50
    seen = np.concatenate([grid.world_points() for grid in front])
    away = np.linalg.norm(vertices[:, None] - seen[None, ::7], axis=2).min(axis=1)
    assert away.max() < 0.003
    filled, more = extract(field, 200, fill=4.0)
    assert len(more) > len(faces)
    assert np.linalg.norm(filled, axis=1).max() < 2 * RADIUS


def test_properties_what_no_pair_sees_squarely_is_cut_off(front: list[Any]) -> None:
    """On a ball the angle to each eye is known: nothing stays beyond it, nothing is missing."""
    vertices, faces = extract(fuse(front, SETTINGS), 200)
    kept, _ = cut_unsupported(vertices, faces, front, SETTINGS)
    assert len(kept) < len(vertices)
    squarely = _squarely(kept, front)
    assert squarely.min() > SETTINGS.facing - 0.1, "a rim vertex has faces on one side only"
    lost = ~np.isin(vertices[:, 0], kept[:, 0])
    inner = _squarely(vertices, front) > SETTINGS.facing + 0.15
    assert not (lost & inner).any()
    all_of_it = replace(SETTINGS, facing=-1.0)
    wide, _ = cut_unsupported(vertices, faces, front, all_of_it)
    assert len(kept) < len(wide) < len(vertices), "beyond the outermost samples nothing is known"
    with pytest.raises(ScanError, match="at a cosine above 1"):
        cut_unsupported(vertices, faces, front, replace(SETTINGS, facing=1.0))


def _squarely(points: Any, grids: list[Any]) -> Any:
    """Cosine (n,) on the ball to the worse eye of the better pair, from where the eyes stand."""
    normals = points / np.linalg.norm(points, axis=1)[:, None]
    found = []
    for grid in grids:
        right = grid.camera.position + grid.baseline_m * grid.camera.T[:3, 0]
        sights = [eye - points for eye in (grid.camera.position, right)]
        found.append(np.min([np.einsum("nk,nk->n", s, normals) / np.linalg.norm(s, axis=1)
                             for s in sights], axis=0))  # fmt: skip
    return np.max(found, axis=0)


def test_properties_samples_near_an_edge_count_less(front: list[Any]) -> None:
    trust = front[0].trust
    known = front[0].known
    assert trust[~known].max() == 0
    assert trust[known].min() > 0
    inner = cv2.erode(known.astype(np.uint8), np.ones((13, 13), np.uint8)) > 0
    assert (trust[inner] == 1).all()
    rim = known & ~(cv2.erode(known.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0)
    assert np.median(trust[rim]) < 0.5


def test_properties_every_vertex_knows_its_unit_and_its_error(front: list[Any]) -> None:
    vertices, _ = extract(fuse(front, SETTINGS), 200)
    measured = measured_by(vertices, front, 0.003)
    assert (measured.unit >= 0).mean() > 0.95
    left = vertices[:, 0] < -0.01
    assert (measured.unit[left] == 0).all()
    filled = measured_by(extract(fuse(front, SETTINGS), 200, fill=4.0)[0], front, 0.003)
    unseen = filled.unit < 0
    assert unseen.sum() > 100
    assert np.array_equal(np.isnan(filled.sigma_m), unseen), "an error of 0 would be a promise"
    assert not filled.confidence[unseen].any()
    ball = trimesh.creation.icosphere(subdivisions=5, radius=RADIUS)
    truth = truth_of(vertices, scene_of(ball))
    foot = np.einsum("vk,vkj->vj", truth.barycentric, ball.vertices[ball.faces[truth.face]])
    distance = np.linalg.norm(vertices - foot, axis=1)
    assert np.abs(truth.error_m) == pytest.approx(distance, abs=1e-7)
    beyond = np.linalg.norm(vertices, axis=1) > np.linalg.norm(foot, axis=1)
    clear = distance > 1e-6
    assert ((truth.error_m > 0) == beyond)[clear].all()


def test_properties_same_grids_same_bytes(front: list[Any]) -> None:
    a, b = (fuse(front, SETTINGS) for _ in range(2))
    assert a.distance_m.tobytes() == b.distance_m.tobytes()
    assert a.distance_m.shape[1:] == (BRICK,) * 3
    assert (np.diff((a.bricks * [10**8, 10**4, 1]).sum(axis=1)) > 0).all(), "lattice order"


@pytest.mark.parametrize("fill", [0.0, 4.0])
def test_reference_slabs_give_the_surface_of_the_whole_box(front: list[Any], fill: float) -> None:
    field = fuse(front, SETTINGS)
    whole, faces = extract(field, 200, fill, slab=10**9)
    thin, pieces = extract(field, 200, fill, slab=1)
    assert len(thin) == len(whole)
    away, row = cKDTree(whole).query(thin)
    assert away.max() < 1e-4 * SETTINGS.voxel_m
    assert turned(row[pieces]) == turned(faces)


def turned(faces: Any) -> set[tuple[int, ...]]:
    """Triangles, each with its smallest vertex first."""
    return {tuple(np.roll(face, -int(face.argmin())).tolist()) for face in faces}


def test_properties_memory_follows_the_surface_not_the_box() -> None:
    """Two balls a metre apart: a box of 20 million voxels, of which few are laid out."""
    near = ring_of_grids(BALL, [0], [0])
    far = [moved_grid(near[0], np.array([1.0, 0.1, 0.1]))]
    tracemalloc.start()
    field = fuse([*near, *far], SETTINGS)
    vertices, _ = extract(field, 200)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert np.ptp(vertices[:, 0]) > 1
    box = float(np.prod(field.shape))
    assert box > 2e7
    assert field.distance_m.size < 0.02 * box
    assert peak < 4 * box, "a dense box takes 20 bytes a voxel"


def moved_grid(grid: Any, shift: Any) -> Any:
    """Return the grid of the same surface and camera, both moved."""
    T = grid.camera.T
    T[:3, 3] += shift
    rows = tuple(tuple(float(v) for v in row) for row in T)
    return replace(grid, camera=replace(grid.camera, T_world_from_camera=rows))


def test_edge_empty(front: list[Any], monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ScanError, match="no unit measured"):
        fuse(ring_of_grids(Sphere(1e-5), [0], [0]), SETTINGS)
    with pytest.raises(ScanError, match="do not form a surface"):
        nothing = np.full((1, BRICK, BRICK, BRICK), np.nan, np.float32)
        extract(Field(np.zeros(3), 0.001, np.zeros((1, 3), np.int64), nothing), 1)
    with pytest.raises(ScanError, match="no piece"):
        extract(fuse(front, SETTINGS), 10**6)
    monkeypatch.setattr(tsdf, "MOST_VOXELS", 10_000)
    with pytest.raises(ScanError, match="larger voxel"):
        fuse(front, SETTINGS)


@pytest.mark.parametrize("reach", [3.0, 5.0, 9.0])
def test_properties_every_brick_within_reach_is_laid_out(reach: float) -> None:
    """Also where the reach is longer than half a brick: none in the middle is left out."""
    middle = np.full((1, 3), 5.5 * BRICK)
    found = tsdf._touched([middle], np.zeros(3), BRICK, reach)
    near = np.argwhere(np.ones((11, 11, 11)))
    away = np.abs(BRICK * (near + 0.5) - middle).max(axis=1) - BRICK / 2
    assert found.tolist() == near[away <= reach].tolist()


def test_edge_distances_of_exactly_nothing() -> None:
    """A face in the outermost plane of voxels belongs to the last cube."""
    rng = stream(0, "sample", 0, 0, "voxels")
    for _ in range(20):
        values = np.rint(rng.standard_normal((1, BRICK, BRICK, BRICK))).astype(np.float32)
        vertices, _ = extract(Field(np.zeros(3), 1.0, np.zeros((1, 3), np.int64), values), 1)
        assert 0 <= vertices.min() <= vertices.max() <= BRICK - 1


def test_properties_small_gaps_are_bridged_and_wide_ones_stay() -> None:
    ramp = np.add.outer(np.arange(20.0), 2 * np.arange(20.0)).astype(np.float32)
    holed = ramp.copy()
    holed[5, 5] = np.nan
    holed[10:16, 10:16] = np.nan
    filled = bridged(holed, 2)
    assert filled[5, 5] == pytest.approx(ramp[5, 5], abs=1e-4)
    assert np.isnan(filled[12:14, 12:14]).all()
