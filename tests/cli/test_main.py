"""The command as a whole: exit codes, JSON alone on stdout, errors without tracebacks."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from synthgen import __version__
from synthgen.cli import main as cli
from synthgen.cli.output import Result
from synthgen.errors import SynthgenError, WorkLeft

JsonRun = Callable[..., tuple[int, dict[str, Any]]]


def raising(error: BaseException) -> Callable[..., Result]:
    def verb(*_: object, **__: object) -> Result:
        raise error

    return verb


def test_smoke_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out == f"synthgen {__version__}\n"


def test_smoke_help_lists_every_verb(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--help"]) == 0
    out = capsys.readouterr().out
    for verb in ("doctor", "models", "config", "plan", "generate", "show", "verify", "preview"):
        assert verb in out


@pytest.mark.parametrize(
    "words",
    [
        ["nonsense"],
        ["plan"],
        ["plan", "hand_rgbd"],
        ["config", "show", "hand_rgbd", "--nonsense"],
        ["config", "show", "no_such_preset"],
        ["config", "show", "hand_rgbd", "--set", "render.spp=0"],
        ["models", "show", "no-such-model"],
        ["show", "folder", "--sample", "x"],
        ["generate", "hand_rgbd", "--out", "folder", "--workers", "0"],
        ["bench", "no_such_benchmark"],
    ],
)
def test_edge_wrong_use_is_2(words: list[str], run_json: JsonRun) -> None:
    code, payload = run_json(*words)
    assert code == 2
    assert list(payload) == ["error"]
    assert len(payload["error"]) > 10


def test_edge_message_goes_to_stderr(capfd: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["config", "show", "hand_rgb"]) == 2
    captured = capfd.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("synthgen: no preset 'hand_rgb' - did you mean 'hand_rgbd'?")
    assert "Traceback" not in captured.err


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (SynthgenError("bad"), 2, "bad"),
        (WorkLeft("half"), 3, "half"),
        (KeyboardInterrupt(), 3, "run the same command again"),
        (OSError(28, "No space left on device", "/full"), 2, "/full: No space left"),
    ],
)
def test_reference_exit_codes(
    error: BaseException, code: int, words: str, run_json: JsonRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("synthgen.cli.config.configured", raising(error))
    found, payload = run_json("config", "show", "hand_rgbd")
    assert found == code
    assert words in payload["error"]


def test_edge_bugs_keep_their_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("synthgen.cli.config.configured", raising(ZeroDivisionError("bug")))
    with pytest.raises(ZeroDivisionError):
        cli.main(["config", "show", "hand_rgbd"])


def test_properties_json_stands_alone_even_when_libraries_print(
    run_json: JsonRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    def noisy(*_: object) -> Any:
        from synthgen.config import Config

        sys.stdout.write("from Python\n")
        os.write(1, b"from native code\n")
        return Config()

    monkeypatch.setattr("synthgen.cli.config.configured", noisy)
    code, payload = run_json("config", "show", "hand_rgbd")
    assert code == 0
    assert payload["config"]["seed"] == 0


def test_edge_reader_that_stops_early() -> None:
    command = f"{sys.executable} -m synthgen config schema | head -n 1"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True)
    assert done.stdout == "{\n"
    assert done.stderr == ""


def test_reference_python_m(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "synthgen", "config", "show", "no_such"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stdout == ""
