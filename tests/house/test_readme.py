"""The README stays true: verbs, options, settings, targets and pictures it names exist."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import typer.main

import synthgen
from synthgen.cli.main import app
from synthgen.config import load_config

ROOT = Path(synthgen.__file__).parents[1]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
SHELL = re.findall(r"^```\n(.*?)^```", TEXT, re.S | re.M)
COMMANDS = [
    shlex.split(line, comments=True)
    for block in SHELL
    for line in block.splitlines()
    if re.match(r"([A-Z_]+=\S+ )?synthgen ", line)
]


def command_of(words: list[str]) -> Any:
    command: Any = typer.main.get_command(app)
    while hasattr(command, "commands"):
        command = command.commands[words.pop(0)]
    return command


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_reference_commands_exist(words: list[str]) -> None:
    rest = list(words[words.index("synthgen") + 1 :])
    command = command_of(rest)
    options = {name for parameter in command.params for name in parameter.opts}
    assert {word for word in rest if word.startswith("--")} <= options
    arguments = [p for p in command.params if p.param_type_name == "argument" and p.required]
    assert len([w for w in rest[: len(arguments)] if not w.startswith("-")]) == len(arguments)


def test_reference_settings_load() -> None:
    found = re.findall(r"--set '?([\w.]+=[^\s'`]+)", TEXT)
    assert len(found) >= 4
    for setting in found:
        if setting != "a.b=c":
            load_config("hand_rgbd", [setting])


def test_smoke_every_verb_is_shown() -> None:
    shown = {words[words.index("synthgen") + 1] for words in COMMANDS}
    assert shown == set(command_of_app())


def command_of_app() -> list[str]:
    command: Any = typer.main.get_command(app)
    return list(command.commands)


def test_smoke_pictures_are_there() -> None:
    for picture in re.findall(r"!\[.*?\]\((.*?)\)", TEXT):
        assert (ROOT / picture).is_file()


def test_reference_make_targets() -> None:
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.M))
    assert set(re.findall(r"(?:^|`)make ([a-z]+)", TEXT, re.M)) <= targets
    assert re.search(r"make check$", (ROOT / ".ci" / "run").read_text().strip())


def test_properties_names_no_path_of_a_machine() -> None:
    assert not re.search(r"/(tmp|root|home|work)/", TEXT)


def test_properties_nothing_asks_the_package_index_for_our_name() -> None:
    """The index has another project called synthgen; ours is installed from a checkout."""
    texts = {"README.md": TEXT}
    for path in [*(ROOT / "synthgen").rglob("*.py"), *(ROOT / "configs").glob("*.yaml")]:
        texts[str(path.relative_to(ROOT))] = path.read_text(encoding="utf-8")
    asked = re.compile(r"install[\s\"]+(--?[\w-]+\s+)*'?synthgen\b")
    assert [name for name, text in texts.items() if asked.search(text)] == []
