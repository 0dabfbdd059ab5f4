"""fit --sequence as a user types it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from synthgen.cli import fit_sequence, sequence_log
from synthgen.cli.main import main
from synthgen.registration.inspection import HAND
from synthgen.registration.tracked import Place
from tests.registration.hands import error_mm, scanned, surface, truth


@pytest.fixture
def frames(tmp_path: Path) -> list[str]:
    """A hand that stays where it is, in millimetres; the second frame is no scan."""
    files = [tmp_path / f"{name}.ply" for name in ("first", "second", "third")]
    points, normals = scanned()
    for file in (files[0], files[2]):
        trimesh.PointCloud(1e3 * points).export(file)
    text = tmp_path / "third.xyz"
    np.savetxt(text, np.column_stack([1e3 * points, normals]))
    files[1].write_text("no scan")
    return [str(files[0]), str(files[1]), str(text)]


def test_smoke_a_sequence(
    frames: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    start, out = tmp_path / "start.npz", tmp_path / "out"
    shape, pose, translation = surface().unpack(truth())
    np.savez(start, shape=shape, pose=pose, translation=translation)
    words = ["fit", *frames, "--sequence", "--out", str(out), "--hand", "right"]
    code = main([*words, "--start", str(start), "--json"])
    payload = json.loads(capsys.readouterr().out)
    assert code == 0
    assert [f["verdict"] for f in payload["fits"]] == ["pass", "unobserved", "pass"]
    assert [f["units"] for f in payload["fits"]] == ["mm", "", "mm"]
    whole = json.loads((out / "sequence.json").read_text())
    assert whole == payload["sequence"]
    assert [f["followed"] for f in whole["frames"]] == [True, False, True]
    for frame in whole["frames"]:
        assert all((out / name).stat().st_size > 100 for name in frame["files"].values())
    with np.load(out / "sequence.npz", allow_pickle=False) as stored:
        assert stored["pose"].shape == (3, 16, 3)
        x = surface().pack(stored["shape"], stored["pose"][2], stored["translation"][2])
        assert list(stored["verdict"]) == ["pass", "unobserved", "pass"]
    assert error_mm(surface().at(x).vertices) < 0.5


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nowhere.ply"], "nowhere.ply: no such file; name the frames in their order"),
        (["--preset", "paper"], "--preset paper is for single scans"),
        (["--template", "maybe"], "--template maybe; expected auto, yes, no"),
    ],
)
def test_edge_errors(
    words: list[str], message: str, frames: list[str], tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    assert main(["fit", frames[0], *words, "--sequence", "--out", str(tmp_path / "out")]) == 2
    assert message in capsys.readouterr().err


def test_edge_frames_far_from_the_origin_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "far.xyz"
    np.savetxt(file, scanned()[0][:2000] + 5e6, fmt="%.6f")
    assert main(["fit", str(file), "--sequence", "--out", str(tmp_path / "out")]) == 2
    assert "far.xyz: lies 8.66e+06 m from the origin" in capsys.readouterr().err


def test_edge_a_single_scan_has_no_template(
    frames: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["fit", frames[0], "--template", "yes", "--out", str(tmp_path / "out")]) == 2
    assert "--template yes is for --sequence" in capsys.readouterr().err


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """A hand that stays, five times, and the words to track it."""
    points, normals = scanned()
    folder = tmp_path_factory.mktemp("walk")
    files = [folder / f"walk{k}.xyz" for k in range(5)]
    for k, file in enumerate(files):
        np.savetxt(file, np.column_stack([points, normals])[k::2])
    start = folder / "start.npz"
    shape, pose, translation = surface().unpack(truth())
    np.savez(start, shape=shape, pose=pose, translation=translation)
    return ["fit", *map(str, files), "--sequence", "--hand", "right", "--start", str(start)]


@pytest.fixture(scope="module")
def whole(walk: list[str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What tracking them in one go writes."""
    out = tmp_path_factory.mktemp("whole") / "out"
    assert main([*walk, "--out", str(out)]) == 0
    return out


def contents(folder: Path) -> dict[str, bytes]:
    """Every file; reports without their CPU seconds."""

    def without(told: Any) -> Any:
        if isinstance(told, dict):
            return {k: without(v) for k, v in told.items() if "cpu_s" not in k}
        return [without(v) for v in told] if isinstance(told, list) else told

    return {
        file.name: json.dumps(without(json.loads(file.read_text()))).encode()
        if file.suffix == ".json" else file.read_bytes()
        for file in sorted(folder.iterdir())
    }  # fmt: skip


@pytest.mark.parametrize("stop", ["interrupt", "kill"])
def test_properties_a_stopped_sequence_goes_on_to_the_same_bytes(
    stop: str, walk: list[str], whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    broken = tmp_path / "broken"
    write, asked = fit_sequence.write, [str(walk[3]), str(walk[4])]

    class Killed(BaseException):
        pass

    def stopped(out: Path, name: str, path: Path, *rest: Any) -> Any:
        if str(path) == asked[0]:
            if stop == "kill":  # half of a frame's files are there
                (out / f"{name}.npz").write_bytes(b"half")
                raise Killed
            raise KeyboardInterrupt
        return write(out, name, path, *rest)

    monkeypatch.setattr(fit_sequence, "write", stopped)
    if stop == "kill":
        with pytest.raises(Killed):
            main([*walk, "--out", str(broken)])
    else:
        assert main([*walk, "--out", str(broken)]) == 3
        assert "after 2 of 5 frames" in capsys.readouterr().err
        assert not json.loads((broken / "sequence.json").read_text())["complete"]
    seen: list[str] = []
    monkeypatch.setattr(fit_sequence, "write", lambda *a: (seen.append(str(a[2])), write(*a))[1])
    assert main([*walk, "--out", str(broken)]) == 0
    assert seen == walk[3:6]
    assert contents(broken) == contents(whole)


def test_properties_another_command_begins_anew(
    walk: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"

    def stopped(*_: Any) -> Any:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(fit_sequence, "write", stopped)
        assert main([*walk, "--out", str(out)]) == 3
    reel = sequence_log.Reel([Path(p) for p in walk[1:6]], "auto", HAND)
    log = sequence_log.Log(out, reel, "one")
    log.paused(Place(None, np.zeros(0), {"hand": 0}, None, False, False, None, None))
    assert sequence_log.Log(out, reel, "one").recalled() is not None
    assert sequence_log.Log(out, reel, "other").recalled() is None
    (out / "sequence.state.npz").write_bytes(b"no archive")
    assert sequence_log.Log(out, reel, "one").recalled() is None


def test_properties_frames_are_never_called_like_the_whole(tmp_path: Path) -> None:
    names = [tmp_path / "sequence.xyz", tmp_path / "a.xyz"]
    for file in names:
        file.write_text("")
    assert sequence_log.Reel(names, "m", HAND).names == ["sequence_0", "a_1"]
