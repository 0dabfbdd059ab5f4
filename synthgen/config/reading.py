"""Reading YAML that may be wrong or hostile: bounded, without aliases, tags or surprises.

Only the scalars of YAML 1.2's core schema are read: ``on`` stays a word and ``1e-3`` is a number.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from synthgen.errors import ConfigError

MAX_BYTES = 256 * 2**10
MAX_DEPTH = 12
MAX_DIGITS = 30

_NULL = re.compile(r"~|null|Null|NULL|")
_BOOL = re.compile(r"true|True|TRUE|false|False|FALSE")
_INT = re.compile(r"[-+]?[0-9]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")


@dataclass(frozen=True)
class Document:
    """A parsed file: its content, and the line (from 1) of every dotted key."""

    content: Any
    lines: dict[str, int]


def read_yaml(path: Path) -> Document:
    """Read one file.

    Raises
    ------
    ConfigError
        If the file is missing, too large, not UTF-8, or not the plain YAML that is wanted here;
        the message names file and line.
    """
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
        if len(data) > MAX_BYTES:
            raise ConfigError(f"{path} is larger than {MAX_BYTES} bytes; that is no configuration")
        text = data.decode("utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: byte {error.start} is not UTF-8; save it as UTF-8") from None
    return parse_yaml(text, str(path))


def parse_yaml(text: str, source: str) -> Document:
    """Parse YAML text.

    Parameters
    ----------
    text : str
    source : str
        Where the text comes from, for messages.

    Raises
    ------
    ConfigError
    """
    try:
        _refuse_what_is_not_plain(text, source)
        root = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.YAMLError as error:
        raise ConfigError(f"{_where(source, error)}: unreadable YAML: {_problem(error)}") from None
    lines: dict[str, int] = {}
    content = None if root is None else _value(root, "", lines, source)
    return Document(content, lines)


def _refuse_what_is_not_plain(text: str, source: str) -> None:
    """Walk the events before anything is built, so that neither bombs nor towers get far."""
    depth = 0
    for event in yaml.parse(text, Loader=yaml.SafeLoader):
        line = event.start_mark.line + 1 if event.start_mark else 0
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None):
            raise ConfigError(
                f"{source}, line {line}: anchors and aliases (&, *) are not read; "
                "write the value out or use `extends`"
            )
        tag = getattr(event, "tag", None)
        if tag is not None and tag != "!":
            raise ConfigError(f"{source}, line {line}: the tag {tag} is not read; remove it")
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if depth > MAX_DEPTH:
            raise ConfigError(f"{source}, line {line}: nested deeper than {MAX_DEPTH} levels")


def _value(node: yaml.Node, key: str, lines: dict[str, int], source: str) -> Any:
    if isinstance(node, yaml.MappingNode):
        return _mapping(node, key, lines, source)
    if isinstance(node, yaml.SequenceNode):
        return [_value(child, key, lines, source) for child in node.value]
    return _scalar(node, source)


def _mapping(
    node: yaml.MappingNode, key: str, lines: dict[str, int], source: str
) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for name_node, value_node in node.value:
        line = name_node.start_mark.line + 1
        if not isinstance(name_node, yaml.ScalarNode):
            raise ConfigError(f"{source}, line {line}: a key must be a word")
        name = str(name_node.value)
        if name in result:
            raise ConfigError(f"{source}, line {line}: key {name!r} is given twice; keep one")
        path = f"{key}.{name}" if key else name
        lines[path] = line
        result[name] = _value(value_node, path, lines, source)
    return result


def _scalar(node: yaml.Node, source: str) -> Any:
    text = str(node.value)
    if node.style in ("'", '"', "|", ">"):  # type: ignore[attr-defined]
        return text
    value = plain_value(text)
    if isinstance(value, float) and not math.isfinite(value):
        line = node.start_mark.line + 1
        raise ConfigError(f"{source}, line {line}: {text} is too large for a number")
    return value


def plain_value(text: str) -> Any:
    """Return what an unquoted scalar means: null, true or false, a number, or itself."""
    if _NULL.fullmatch(text):
        return None
    if _BOOL.fullmatch(text):
        return text.lower() == "true"
    if len(text) <= MAX_DIGITS and _INT.fullmatch(text):
        return int(text)
    if len(text) <= MAX_DIGITS and _FLOAT.fullmatch(text):
        return float(text)
    return text


def _where(source: str, error: yaml.YAMLError) -> str:
    mark = getattr(error, "problem_mark", None)
    return source if mark is None else f"{source}, line {mark.line + 1}"


def _problem(error: yaml.YAMLError) -> str:
    problem = getattr(error, "problem", None) or getattr(error, "reason", None)
    return str(problem or error).splitlines()[0]
