"""Verbs run as a user types them, in the tests' own process: starting one imports for seconds."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest

from synthgen.cli.main import main


@pytest.fixture
def run_json(capfd: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, dict[str, Any]]]:
    """Run a verb with --json: its exit code, and the one object on its stdout."""

    def run(*words: str) -> tuple[int, dict[str, Any]]:
        code = main([*words, "--json"])
        out = capfd.readouterr().out
        assert out.count("\n") == 1
        return code, json.loads(out)

    return run
