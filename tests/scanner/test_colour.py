"""Colours, texture map, files and cutting, on a sphere whose colours are known."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from synthgen.errors import ScanError, ShapeError
from synthgen.geometry.cameras import camera_from_K, pixel_rays
from synthgen.geometry.transforms import look_at
from synthgen.scanner.atlas import build_atlas
from synthgen.scanner.colour import UNSEEN, Coloured, ColourView, colour_vertices, sample
from synthgen.scanner.files import save_scan
from synthgen.scanner.glass import shifted_origins
from synthgen.scanner.result import Scan, empty_scan
from synthgen.scanner.rig import Glass
from synthgen.scanner.segment import CropPlane, is_green, segment, wrist_plane

RADIUS = 0.02
BALL = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS)
FACES = np.asarray(BALL.faces, np.int64)


def paint(points: Any) -> Any:
    """Colour by position; the lower half is green."""
    ramp = 60 + 100 * (np.asarray(points) / RADIUS + 1) / 2
    green = np.asarray(points)[..., 1:2] < -0.005
    return np.where(green, [20, 150, 20], ramp * [1, 0.5, 0.5])


def picture_of_ball(azimuth: float) -> ColourView:
    a = np.deg2rad(azimuth)
    return picture_from(0.4 * np.array([np.sin(a), 0, np.cos(a)]))


def picture_from(eye: Any, glass: Glass | None = None) -> ColourView:
    K = np.array([[900.0, 0, 100], [0, 900, 80], [0, 0, 1]])
    camera = camera_from_K(K, 200, 160, look_at(eye, np.zeros(3)))
    _, rays = pixel_rays(camera)
    ways = rays.reshape(-1, 3)
    starts = shifted_origins(glass, camera.position, ways)
    along = -np.einsum("nk,nk->n", starts, ways)
    under = along**2 - (starts**2).sum(axis=1) + RADIUS**2
    t = along - np.sqrt(np.where(under > 0, under, np.nan))
    points = starts + ways * np.nan_to_num(t)[:, None]
    shown = np.where(np.isfinite(t)[:, None], paint(points), 0).reshape(rays.shape)
    return ColourView(camera, np.rint(shown).astype(np.uint8), glass)


@pytest.fixture(scope="module")
def scanned() -> tuple[Scan, Coloured, list[ColourView]]:
    views = [picture_of_ball(0), picture_of_ball(60)]
    normals = np.asarray(BALL.vertices) / RADIUS
    coloured = colour_vertices(np.asarray(BALL.vertices), normals, FACES, views)
    atlas = build_atlas(coloured, FACES, views)
    provenance = {
        "unit": np.zeros(len(normals), np.int16),
        "confidence": np.full(len(normals), 0.9, np.float32),
        "barycentric": np.ones((len(normals), 3), np.float32),
    }
    scan = Scan(
        BALL.vertices.astype(np.float32), normals.astype(np.float32), FACES.astype(np.int32),
        coloured.colors, atlas.uv, atlas.corner_uv, atlas.texture, provenance,
    )  # fmt: skip
    return scan, coloured, views


def test_reference_colours_are_those_of_the_surface(scanned: Any) -> None:
    scan, coloured, _ = scanned
    seen = coloured.view >= 0
    assert 0.5 < seen.mean() < 0.75, "two views 60 degrees apart"
    off_rim = seen & (coloured.facing.max(axis=1) > 0.4)
    off_rim &= np.abs(scan.vertices[:, 1] + 0.005) > 0.0006
    assert np.abs(scan.colors[off_rim].astype(float) - paint(scan.vertices[off_rim])).max() < 4
    assert (scan.colors[~seen] == UNSEEN).all()
    assert (scan.vertices[~seen][:, 2] < 0.012).all()


def test_reference_colours_through_glass() -> None:
    """A slanted look up through a floor: what is coloured is what the refracted ray met."""
    glass = Glass(top_m=-0.022, thickness_m=0.02, ior=1.52)
    view = picture_from(np.array([0.2, -0.3, 0.15]), glass)
    points = np.asarray(BALL.vertices)
    coloured = colour_vertices(points, points / RADIUS, FACES, [view])
    inner = coloured.facing[:, 0] > 0.4
    assert inner.mean() > 0.25
    inner &= np.abs(points[:, 1] + 0.005) > 0.0006
    assert np.abs(coloured.colors[inner].astype(float) - paint(points[inner])).max() < 4


def test_properties_each_vertex_takes_the_view_that_faces_it(scanned: Any) -> None:
    scan, coloured, views = scanned
    middle = views[0].camera.position - views[1].camera.position
    towards_first = scan.vertices @ middle
    both = (coloured.facing > 0.2).all(axis=1)
    assert ((coloured.view == 0) == (towards_first > 0))[both].mean() > 0.98


def test_properties_what_is_blocked_is_not_coloured() -> None:
    """A plate before the ball takes the ball's colour away."""
    plate = trimesh.creation.box((0.06, 0.06, 0.001)).apply_translation((0, 0, 0.03))
    vertices = np.concatenate([BALL.vertices, plate.vertices])
    faces = np.concatenate([FACES, plate.faces + len(BALL.vertices)])
    normals = np.concatenate([BALL.vertices / RADIUS, np.asarray(plate.vertex_normals)])
    coloured = colour_vertices(vertices, normals, faces, [picture_of_ball(0)])
    assert (coloured.view[: len(BALL.vertices)] < 0).mean() > 0.99


def test_reference_texture_shows_what_the_vertices_have(scanned: Any) -> None:
    scan, coloured, views = scanned
    seen = coloured.view >= 0
    height, width = scan.texture.shape[:2]
    at = scan.uv * [width, -height] + [0, height] - 0.5
    looked_up = sample(scan.texture, at[seen])
    assert np.abs(looked_up.astype(int) - scan.colors[seen]).max() <= 1
    whole = build_atlas(coloured, FACES, views).face_view >= 0
    assert whole.mean() > 0.45
    corner = scan.corner_uv[whole].reshape(-1, 2) * [width, -height] + [0, height] - 0.5
    facing = coloured.facing[FACES[whole]].max(axis=2).ravel() > 0.5
    painted = paint(scan.vertices[scan.faces[whole]].reshape(-1, 3))
    error = np.abs(sample(scan.texture, corner).astype(float) - painted)[facing]
    assert np.quantile(error, 0.97) < 4


@pytest.mark.parametrize("ending", ["ply", "glb", "obj"])
def test_smoke_files_open_elsewhere(scanned: Any, tmp_path: Path, ending: str) -> None:
    scan = scanned[0]
    written = save_scan(scan, tmp_path / f"scan.{ending}")
    assert all(path.stat().st_size for path in written)
    mesh: Any = trimesh.load(tmp_path / f"scan.{ending}", process=False, force="mesh")
    assert len(mesh.faces) == len(scan.faces)
    assert mesh.area == pytest.approx(BALL.area, rel=1e-4)
    if ending == "ply":
        assert np.array_equal(np.asarray(mesh.visual.vertex_colors)[:, :3], scan.colors)
        assert mesh.vertices == pytest.approx(scan.vertices)
    else:
        material = mesh.visual.material
        picture = material.baseColorTexture if ending == "glb" else material.image
        image = np.asarray(picture.convert("RGB"))
        assert np.array_equal(image, scan.texture)
        uv = np.asarray(mesh.visual.uv)[np.asarray(mesh.faces)]
        assert uv == pytest.approx(scan.corner_uv, abs=1e-5)
        # The reader's own look-up in the picture: which way up it is.
        looked_up = np.asarray(mesh.visual.to_color().vertex_colors)[:, :3].astype(float)
        row = cKDTree(scan.vertices).query(mesh.vertices)[1]
        facing = scanned[1].facing[row].max(axis=1) > 0.5
        error = np.abs(looked_up - paint(np.asarray(mesh.vertices))).max(axis=1)[facing]
        assert np.quantile(error, 0.9) < 12


def test_reference_green_rule() -> None:
    colours = np.array([[0, 20, 0], [0, 21, 0], [50, 50, 0], [50, 51, 0], [200, 150, 120]])
    assert is_green(colours.astype(np.uint8)).tolist() == [False, True, False, True, False]


def test_properties_segment_leaves_holes(scanned: Any) -> None:
    scan = scanned[0]
    hand = segment(scan, CropPlane((0, 0, 0), (0, 0, 2)))
    assert (hand.vertices[:, 2] >= 0).all()
    assert not is_green(hand.colors).any()
    assert 0 < len(hand.vertices) < len(scan.vertices) / 2
    assert len(hand.provenance["unit"]) == len(hand.vertices) == len(hand.uv)
    kept = (scan.vertices[:, 2] >= 0) & ~is_green(scan.colors)
    first = scan.faces[kept[scan.faces].all(axis=1)][0]
    assert np.array_equal(hand.vertices[hand.faces[0]], scan.vertices[first])
    assert len(hand.corner_uv) == len(hand.faces)


def test_reference_wrist_plane() -> None:
    joints = np.zeros((16, 3))
    joints[[1, 4, 7, 10], 0] = 0.09
    plane = wrist_plane(joints, beyond_m=0.01)
    assert plane.keeps(np.array([[-0.009, 0.3, 0], [-0.011, 0, 0]])).tolist() == [True, False]


def test_edge_nothing_left(scanned: Any, tmp_path: Path) -> None:
    scan = scanned[0]
    gone = segment(scan, CropPlane((1, 0, 0), (1, 0, 0)))
    assert gone.problem is not None and "nothing is left" in gone.problem
    with pytest.raises(ScanError, match="nothing is left"):
        save_scan(gone, tmp_path / "scan.ply")
    with pytest.raises(ScanError, match=r"endings are \.ply"):
        save_scan(scan, tmp_path / "scan.stl")
    with pytest.raises(ScanError, match=r"there is no folder .*nowhere; make it"):
        save_scan(scan, tmp_path / "nowhere" / "scan.ply")
    with pytest.raises(ScanError, match="black"):
        save_scan(empty_scan((), "full", "black pictures"), tmp_path / "scan.ply")
    with pytest.raises(ShapeError, match="direction"):
        CropPlane((0, 0, 0), (0, 0, 0)).keeps(np.zeros((1, 3)))
    assert (
        len(dataclasses.replace(scan, problem=None).keep(np.zeros(len(scan.vertices), bool)).faces)
        == 0
    )
