"""fit --sequence as a user types it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from synthgen.cli.main import main
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
    ],
)
def test_edge_errors(
    words: list[str], message: str, frames: list[str], tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    assert main(["fit", frames[0], *words, "--sequence", "--out", str(tmp_path / "out")]) == 2
    assert message in capsys.readouterr().err
