"""Files of every kind, and units."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from synthgen.errors import ShapeError
from synthgen.registration.inspection import extent
from synthgen.registration.reading import read_scan
from tests.registration.hands import rng, scanned, surface, truth


def cloud() -> np.ndarray:
    return scanned()[0][:3000]


@pytest.mark.parametrize("kind", ["ply", "obj", "glb", "stl"])
def test_smoke_meshes(kind: str, tmp_path: Path) -> None:
    file = tmp_path / f"scan.{kind}"
    placed = surface().at(truth())
    trimesh.Trimesh(placed.vertices, surface().faces, process=False).export(file)
    found = read_scan(file)
    assert found.units == "m"
    assert found.normals is not None
    assert len(found.points) == len(found.normals) >= 20_000
    np.testing.assert_allclose(found.points.min(axis=0), placed.vertices.min(axis=0), atol=2e-3)


def test_reference_point_cloud_and_text(tmp_path: Path) -> None:
    ply, text = tmp_path / "cloud.ply", tmp_path / "cloud.xyz"
    trimesh.PointCloud(cloud()).export(ply)
    np.savetxt(text, np.concatenate([cloud(), scanned()[1][:3000]], axis=1), header="x y z n n n")
    points = read_scan(ply)
    np.testing.assert_allclose(points.points, cloud(), atol=1e-6)
    assert points.normals is None
    rows = read_scan(text)
    np.testing.assert_allclose(rows.points, cloud())
    assert rows.normals is not None


@pytest.mark.parametrize(("units", "factor"), [("mm", 1e3), ("cm", 1e2), ("inch", 1 / 0.0254)])
def test_properties_units_are_guessed_or_said(units: str, factor: float, tmp_path: Path) -> None:
    file = tmp_path / "cloud.xyz"
    np.savetxt(file, factor * cloud())
    found = read_scan(file)
    assert found.units == units
    assert "converted" in found.note
    np.testing.assert_allclose(found.points, cloud(), atol=1e-9)
    given = read_scan(file, units)
    np.testing.assert_allclose(given.points, cloud(), atol=1e-9)


def test_edge_ambiguous_units_are_not_converted(tmp_path: Path) -> None:
    """9 across: a fist in centimetres or a long hand in inches."""
    points = cloud() / extent(cloud()) * 9
    np.savetxt(tmp_path / "cloud.xyz", points)
    found = read_scan(tmp_path / "cloud.xyz")
    assert found.units == ""
    assert "cm or inch" in found.note
    np.testing.assert_allclose(found.points, points)


def test_edge_colours_are_no_normals(tmp_path: Path) -> None:
    colours = rng("colours").integers(100, 256, cloud().shape)
    np.savetxt(tmp_path / "cloud.xyz", np.concatenate([cloud(), colours], axis=1))
    found = read_scan(tmp_path / "cloud.xyz")
    assert found.normals is None
    np.testing.assert_allclose(found.points, cloud())


@pytest.mark.parametrize(
    ("name", "content"),
    [("a.xyz", "1 2\n3 4\n"), ("a.xyz", "one two three\n"), ("a.ply", "ply\nnonsense\n"),
     ("a.doc", "")],
)  # fmt: skip
def test_edge_bad_files(name: str, content: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(ShapeError, match=name):
        read_scan(tmp_path / name)


def test_edge_missing_file_and_unit(tmp_path: Path) -> None:
    with pytest.raises(ShapeError, match="no such file"):
        read_scan(tmp_path / "none.ply")
    with pytest.raises(ShapeError, match="furlong"):
        read_scan(tmp_path / "none.ply", "furlong")


def test_edge_empty_text(tmp_path: Path) -> None:
    (tmp_path / "empty.xyz").write_text("# nothing\n")
    assert len(read_scan(tmp_path / "empty.xyz").points) == 0


def far_away(digits: type, middle: float, file: Path) -> None:
    """A PLY of the cloud at a place far from the origin, its numbers float32 or float64."""
    kind = "double" if digits is np.float64 else "float"
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(cloud())}",
            *(f"property {kind} {axis}" for axis in "xyz"), "end_header", ""]  # fmt: skip
    file.write_bytes("\n".join(head).encode() + (cloud() + middle).astype(digits).tobytes())


def test_properties_doubles_keep_their_digits_far_away(tmp_path: Path) -> None:
    far_away(np.float64, 5e6, tmp_path / "far.ply")
    found = read_scan(tmp_path / "far.ply")
    np.testing.assert_allclose(found.points - 5e6, cloud(), atol=2e-9)
    assert "steps" not in found.note


@pytest.mark.parametrize(("middle", "step"), [(5e6, "500 mm"), (1e5, "7.81 mm")])
def test_edge_float32_far_away_has_lost_the_shape(middle: float, step: str, tmp_path: Path) -> None:
    far_away(np.float32, middle, tmp_path / "far.ply")
    with pytest.raises(ShapeError, match=f"float32 in steps of {step}; at most 2 mm: subtract"):
        read_scan(tmp_path / "far.ply")


def test_edge_coarse_steps_are_said(tmp_path: Path) -> None:
    far_away(np.float32, 3e3, tmp_path / "far.ply")
    assert read_scan(tmp_path / "far.ply").note.endswith("stored in steps of 0.24 mm")


@pytest.mark.parametrize(
    ("text", "message"),
    [("1 2 3\n1 2\n", "line 2 has 2 words; expected 3"), ("a b c\n", "line 1: could not convert"),
     ("# x\n1 2\n", "line 2 has 2 words; expected x y z"), ("1 2 3 \xff", "invalid start byte")],
)  # fmt: skip
def test_edge_bad_lines_are_named(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "bad.xyz").write_text(text, encoding="latin-1")
    with pytest.raises(ShapeError, match=message):
        read_scan(tmp_path / "bad.xyz")


def test_edge_what_is_no_file(tmp_path: Path) -> None:
    import os

    (tmp_path / "folder.ply").mkdir()
    os.mkfifo(tmp_path / "pipe.ply")
    for name, message in (("folder", "a folder, no scan"), ("pipe", "no regular file")):
        with pytest.raises(ShapeError, match=message):
            read_scan(tmp_path / f"{name}.ply")


def test_edge_parsers_may_raise_anything(tmp_path: Path) -> None:
    (tmp_path / "old.glb").write_bytes(b"glTF" + (1).to_bytes(4, "little") + bytes(100))
    with pytest.raises(ShapeError, match=r"old.glb: cannot be read as points"):
        read_scan(tmp_path / "old.glb")
    lacking = ["ply", "format ascii 1.0", "element vertex 1", "property float x",
               "property float y", "end_header", "0 0", ""]  # fmt: skip
    (tmp_path / "flat.ply").write_text("\n".join(lacking))
    with pytest.raises(ShapeError, match="it lacks 'z'"):
        read_scan(tmp_path / "flat.ply")


def test_edge_numbers_that_are_no_positions(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "huge.xyz", 1e200 * cloud())
    assert read_scan(tmp_path / "huge.xyz").units == ""
