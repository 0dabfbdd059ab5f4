"""fit and train-init as a user types them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from synthgen.cli.fit_files import names_of
from synthgen.cli.main import main
from tests.registration.hands import error_mm, scanned, surface, truth


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, dict[str, Any]]:
    code = main([*words, "--json"])
    return code, json.loads(capsys.readouterr().out)


@pytest.fixture
def scan_file(tmp_path: Path) -> Path:
    """A scan in millimetres without normals."""
    file = tmp_path / "hand.ply"
    trimesh.PointCloud(1e3 * scanned()[0]).export(file)
    return file


def test_smoke_fit_in_millimetres(
    scan_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    code, payload = run(capsys, "fit", str(scan_file), "--out", str(out), "--coupled")
    assert code == 0
    report = payload["fits"][0]
    assert (report["verdict"], report["hand"], report["units"]) == ("pass", "right", "mm")
    assert "mm" in report["units_note"]
    for name in ("hand.npz", "hand.ply", "hand.png", "hand.json", "hand_free.ply"):
        assert (out / name).stat().st_size > 100, name
    with np.load(out / "hand.npz", allow_pickle=False) as stored:
        assert error_mm(stored["vertices"]) < 0.5
        x = surface().pack(stored["shape"], stored["pose"], stored["translation"])
    np.testing.assert_allclose(surface().at(x).vertices, trimesh.load(out / "hand.ply").vertices,
                               atol=1e-5)  # fmt: skip
    assert json.loads((out / "hand.json").read_text())["statistics"]["explained"] > 0.98


def test_smoke_batch_from_a_start(
    scan_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    start = tmp_path / "start.npz"
    shape, pose, translation = surface().unpack(truth())
    np.savez(start, shape=shape, pose=pose, translation=translation)
    out = tmp_path / "out"
    words = ["fit", str(scan_file), str(scan_file), "--out", str(out), "--hand", "right"]
    code, payload = run(capsys, *words, "--start", str(start))
    assert code == 0
    assert [f["start"] for f in payload["fits"]] == ["given", "given"]
    assert (out / "hand_0.npz").is_file()
    assert (out / "hand_1.npz").is_file()


def test_edge_bad_scan_is_a_failed_check(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    empty = tmp_path / "empty.xyz"
    empty.write_text("")
    code, payload = run(capsys, "fit", str(empty), "--out", str(tmp_path / "out"))
    assert code == 1
    assert payload["fits"][0]["reason"] == "no_points"
    assert main(["fit", str(empty), "--out", str(tmp_path / "out")]) == 1
    assert "fail (no_points)" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--start", "nowhere.npz"], "--start 'nowhere.npz': expected cold"),
        (["--hand", "third"], "hand='third'"),
        (["--preset", "slow"], "preset"),
        (["--units", "mile"], "units="),
        (["--model", "no-such-hand"], "no-such-hand"),
        (["--start", ""], "--start '': expected cold or a fit's .npz"),
        (["--start", "SCAN"], "this file is no .npz"),
        (["--start", "words.npz"], "it holds <U1, float64, float64, no numbers"),
        (["--start", "complex.npz"], "it holds complex128"),
        (["--start", "huge.npz"], "not finite, or beyond 1e+12"),
        (["--start", "flat.npz"], "start has shapes"),
        (["--model", "cc0-body", "--hand", "left"], "hand='left' is for hand models"),
    ],
)
def test_edge_wrong_use(
    words: list[str],
    message: str,
    scan_file: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    shape, pose, translation = surface().unpack(truth())
    starts = {"words": np.array(["a"]), "complex": shape + 1j, "huge": shape * 1e300,
              "flat": shape[:, None]}  # fmt: skip
    for name, first in starts.items():
        np.savez(tmp_path / f"{name}.npz", shape=first, pose=pose, translation=translation)
    there = {"SCAN": str(scan_file), **{f"{n}.npz": str(tmp_path / f"{n}.npz") for n in starts}}
    given = [there.get(word, word) for word in words]
    code, payload = run(capsys, "fit", str(scan_file), "--out", str(tmp_path / "out"), *given)
    assert code == 2
    assert message in payload["error"]
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("as_json", [False, True])
def test_edge_a_name_that_is_no_utf8(
    as_json: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """OpenCV crashes on such a path, and a strict terminal refuses it."""
    import os

    file = tmp_path / os.fsdecode(b"caf\xe9.xyz")
    file.write_text("0 0 0\n")
    words = ["--json"] if as_json else []
    assert main(["fit", str(file), "--out", str(tmp_path / "out"), *words]) == 1
    assert r"caf\udce9" in capsys.readouterr().out.encode("utf-8", "strict").decode()
    assert (tmp_path / "out" / os.fsdecode(b"caf\xe9.png")).is_file()


def test_properties_a_mesh_far_away_keeps_its_digits(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place = np.array([4.5e5, 112.0, 5.2e6])
    np.savetxt(tmp_path / "far.xyz", scanned()[0] + place, fmt="%.6f")
    out = tmp_path / "out"
    code, _ = run(capsys, "fit", str(tmp_path / "far.xyz"), "--out", str(out), "--hand", "right")
    assert code == 0
    mesh: Any = trimesh.load(out / "far.ply", process=False)
    assert error_mm(mesh.vertices - place) < 0.5
    np.testing.assert_array_equal(mesh.faces, surface().faces)


def test_edge_a_scan_is_not_written_over(
    scan_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = scan_file.read_bytes()
    code, payload = run(capsys, "fit", str(scan_file), "--out", str(tmp_path))
    assert code == 2
    assert "would replace the scan" in payload["error"]
    assert scan_file.read_bytes() == before


def test_properties_scans_of_one_name_get_results_of_their_own() -> None:
    names = names_of([Path("x/a.ply"), Path("y/a.ply"), Path("z/a_0.ply")])
    assert len(set(names)) == 3


def test_edge_free_meshes_meet_no_other_scan() -> None:
    """Of x.ply the free mesh is x_free.ply."""
    names = names_of([Path("x.ply"), Path("x_free.ply")])
    assert len({*names, *(f"{name}_free" for name in names)}) == 4
    assert names_of([Path("x_free.ply")]) == ["x_free"]


def test_smoke_train_init(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "init.npz"
    words = ["train-init", "cc0-hand", "--out", str(file), "--seconds", "1", "--hands", "100"]
    code, payload = run(capsys, *words)
    assert code == 0
    assert payload["steps"] >= 2
    assert file.is_file()
