"""fit of many scans: what is done is not done again."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import igl
import numpy as np
import pytest

from synthgen.cli import fit_batch
from synthgen.cli.main import main
from synthgen.geometry.normals import vertex_normals
from synthgen.geometry.subdivision import InterpolatingSubdivision
from synthgen.models import load
from synthgen.registration.initialiser import initialiser_path
from tests.cli.test_fit_sequence import contents
from tests.registration.hands import scanned, surface, truth

WRITE = fit_batch.write


@pytest.fixture
def batch(tmp_path: Path) -> list[str]:
    """Three scans of one hand, and a start."""
    points, normals = scanned()
    files = [tmp_path / f"scan{k}.xyz" for k in range(3)]
    for k, file in enumerate(files):
        np.savetxt(file, np.column_stack([points, normals])[k::3], fmt="%.6f")
    shape, pose, translation = surface().unpack(truth())
    np.savez(tmp_path / "start.npz", shape=shape, pose=pose, translation=translation)
    words = ["--start", str(tmp_path / "start.npz"), "--hand", "right"]
    return ["fit", *map(str, files), *words]


@pytest.fixture
def fitted(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the scans that were fitted, as they are."""
    seen: list[str] = []
    monkeypatch.setattr(fit_batch, "write", lambda *a: (seen.append(a[1]), WRITE(*a))[1])
    return seen


@pytest.mark.parametrize("stop", ["interrupt", "kill"])
def test_properties_a_stopped_batch_goes_on_to_the_same_bytes(
    stop: str, batch: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    assert main([*batch, "--out", str(whole)]) == 0
    assert "3 scans: 3 pass, 0 unobserved, 0 fail" in capsys.readouterr().out

    class Killed(BaseException):
        pass

    def stopped(out: Path, name: str, *rest: Any) -> Any:
        if name == "scan1":
            if stop == "kill":  # half of a scan's files are there
                (out / f"{name}.npz").write_bytes(b"half")
                raise Killed
            raise KeyboardInterrupt
        return WRITE(out, name, *rest)

    with monkeypatch.context() as patch:
        patch.setattr(fit_batch, "write", stopped)
        if stop == "kill":
            with pytest.raises(Killed):
                main([*batch, "--out", str(broken)])
        else:
            assert main([*batch, "--out", str(broken)]) == 3
            assert "after 1 of 3 scans" in capsys.readouterr().err
    seen: list[str] = []
    monkeypatch.setattr(fit_batch, "write", lambda *a: (seen.append(a[1]), WRITE(*a))[1])
    assert main([*batch, "--out", str(broken)]) == 0
    assert seen == ["scan1", "scan2"]
    told = capsys.readouterr().out
    assert "1 were there already (--again fits them anew)" in told
    assert contents(broken) == contents(whole)


def test_properties_only_what_changed_is_fitted_again(
    batch: list[str], fitted: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = [*batch, "--out", str(tmp_path / "out")]
    assert main(command) == 0
    del fitted[:]
    capsys.readouterr()
    assert main([*command, "--json"]) == 0
    payload = json.loads(capsys.readouterr().out)
    assert (payload["there_already"], fitted) == (3, [])
    assert payload["verdicts"] == {"pass": 3, "unobserved": 0, "fail": 0}
    (tmp_path / "out" / "scan0.png").unlink()
    Path(batch[2]).write_text(Path(batch[2]).read_text() + "0.001 0 0 1 0 0\n")
    (tmp_path / "out" / "scan2.json").write_text("half of a rep")
    assert main(command) == 0
    assert fitted == ["scan0", "scan1", "scan2"]
    assert main([*command[:2], *command[4:], "--again"]) == 0
    assert fitted[3:] == ["scan0"]


def test_properties_a_key_names_all_that_decides_a_fit(tmp_path: Path) -> None:
    scan, options = tmp_path / "a.xyz", fit_batch.Options("auto", "cold", False, "fast", "auto")
    scan.write_text("0 0 0")
    given = (np.zeros(10), np.zeros((16, 3)), np.zeros(3))
    others = [replace(options, hand="left"), replace(options, start=given),
              replace(options, coupled=True), replace(options, preset="paper"),
              replace(options, units="m"), replace(options, smooth=True)]  # fmt: skip
    keys = {fit_batch.key_of(scan, "model", one) for one in (options, *others)}
    assert fit_batch.key_of(scan, "model", options) in keys
    keys |= {fit_batch.key_of(scan, "other model", options)}
    scan.write_text("0 0 1")
    assert len(keys | {fit_batch.key_of(scan, "model", options)}) == 9


def test_properties_a_key_knows_the_files_beside_a_gltf(tmp_path: Path) -> None:
    options = fit_batch.Options("auto", "cold", False, "fast", "auto")
    scan, points = tmp_path / "a.gltf", tmp_path / "its points.bin"
    own = {"uri": "data:application/octet-stream;base64,AAAA"}
    keys = set()
    for buffers in ([own], [own, {"uri": "its%20points.bin"}], [{"uri": "absent.bin"}], 7):
        scan.write_text(json.dumps({"buffers": buffers}))
        for content in (b"1", b"2"):
            points.write_bytes(content)
            keys.add(fit_batch.key_of(scan, "model", options))
    assert len(keys) == 5


def test_properties_what_was_learned_anew_is_fitted_again(
    batch: list[str], fitted: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    command = [*batch[:2], *batch[4:], "--out", str(tmp_path / "out")]
    assert main(command) == main(command) == 0
    assert fitted == ["scan0"]
    file = initialiser_path(load("cc0-hand"))
    file.parent.mkdir(parents=True)
    file.write_bytes(b"other weights")  # the one in use is in memory
    assert main(command) == 0
    assert fitted == ["scan0", "scan0"]


def test_properties_scans_of_smooth_skin_are_fitted_as_such(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As corpora draw it, through the model's vertices; and pictured so."""
    far: list[float] = []

    def pictured(scan: Any, mesh: Any, faces: Any, *_: Any) -> Any:
        far.append(np.sqrt(igl.point_mesh_squared_distance(scan, mesh, faces)[0]).mean())
        return np.zeros((2, 2, 3), np.uint8)

    monkeypatch.setattr("synthgen.registration.overlay.draw_overlay", pictured)
    vertices = surface().at(truth()).vertices
    smooth = InterpolatingSubdivision.build(surface().faces, len(vertices))
    points = smooth.apply(vertices)
    scan, start = tmp_path / "scan.xyz", tmp_path / "start.npz"
    np.savetxt(scan, np.column_stack([points, vertex_normals(points, smooth.faces)]), fmt="%.6f")
    shape, pose, translation = surface().unpack(truth())
    np.savez(start, shape=shape, pose=pose, translation=translation)
    off = []
    for word in ([], ["--smooth"]):
        command = ["fit", str(scan), "--start", str(start), "--hand", "right", *word]
        assert main([*command, "--out", str(tmp_path / "out")]) == 0
        with np.load(tmp_path / "out" / "scan.npz") as found:
            off.append(np.linalg.norm(found["vertices"] - vertices, axis=1).mean())
    assert off[1] < 1e-4
    assert off[1] < 0.5 * off[0]
    assert far[1] < 5e-5
    assert far[1] < 0.5 * far[0]


@pytest.mark.parametrize("more", [["--sequence"], ["--model", "cc0-body"]])
def test_edge_smooth_is_for_single_hands(
    more: list[str], batch: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    words = (
        [word for word in batch if word not in ("--hand", "right")] if "--model" in more else batch
    )
    assert main([*words, *more, "--smooth", "--out", "nowhere"]) == 2
    assert not Path("nowhere").exists()
    assert "leave it out" in capsys.readouterr().err


def test_edge_a_scan_that_cannot_be_read_stops_no_batch(
    batch: list[str], fitted: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path(batch[2]).write_text("no scan")
    assert main([*batch, "--out", str(tmp_path / "out")]) == 2
    assert fitted == ["scan0", "scan2"]
    told = capsys.readouterr().out
    assert "scan1.xyz: cannot be read as points: line 1 has 2 words; expected x y z" in told
    assert "3 scans: 2 pass, 0 unobserved, 0 fail, 1 unreadable" in told


def test_edge_what_is_missing_stops_a_batch_before_it_begins(
    batch: list[str], fitted: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path(batch[3]).unlink()
    assert main([*batch, "--out", str(tmp_path / "out")]) == 2
    assert "scan2.xyz: no such file" in capsys.readouterr().err
    assert fitted == []
    assert not (tmp_path / "out").exists()
