"""Loading a configuration: presets that extend one another, overrides, hash and resolved form."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from synthgen.config.explain import explain
from synthgen.config.presets import find_config
from synthgen.config.reading import MAX_DEPTH, parse_yaml, plain_value, read_yaml
from synthgen.config.schema import Config
from synthgen.errors import ConfigError

MAX_EXTENDS = 8
# Keys that do not decide any byte of a sample.
_NOT_HASHED = ("samples",)

Origins = dict[str, str]


def load_config(name: str | Path, overrides: Iterable[str] = ()) -> Config:
    """Load a preset or a file and apply overrides.

    Parameters
    ----------
    name : str or Path
        A preset's name, or the path of a YAML file.
    overrides : iterable of str
        ``"a.b=c"``; the value is read as YAML. Later ones win.

    Returns
    -------
    Config

    Raises
    ------
    ConfigError
        If something is unknown, out of range or unreadable; the message names the key, what is
        allowed, the nearest match, and the file.
    """
    origins: Origins = {}
    content = _read_extended(find_config(str(name)), (), origins)
    for text in overrides:
        content = _merge(content, _override(text, origins))
    return config_from_dict(content, origins)


def config_from_dict(content: Mapping[str, Any], origins: Origins | None = None) -> Config:
    """Validate plain data, as YAML or JSON would give it.

    Raises
    ------
    ConfigError
    """
    try:
        # JSON mode is strict about numbers and words, and takes lists for tuples.
        return Config.model_validate_json(json.dumps(content))
    except ValidationError as error:
        raise ConfigError(explain(error, Config, origins or {})) from None
    except (TypeError, ValueError) as error:
        raise ConfigError(f"the configuration is not plain data: {error}") from None


def config_hash(config: Config) -> str:
    """Return the SHA-256 (hex) over everything but ``samples``, so that a corpus can grow."""
    content = config.model_dump(mode="json", exclude=set(_NOT_HASHED))
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def resolved_yaml(config: Config) -> str:
    """Return the whole configuration as YAML that :func:`load_config` reads back, equal."""
    content = config.model_dump(mode="json")
    text: str = yaml.dump(
        content, Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=100
    )
    return f"# hash {config_hash(config)}\n{text}"


class _Dumper(yaml.SafeDumper):
    """Sections as blocks, lists on one line."""

    def represent_mapping(self, tag: str, mapping: Any, flow_style: bool | None = None) -> Any:
        """Keep mappings in block style."""
        return super().represent_mapping(tag, mapping, flow_style=False)

    def represent_str(self, data: str) -> Any:
        """Quote words that our reader, which is not PyYAML's, would take for something else."""
        style = None if isinstance(plain_value(data), str) else "'"
        return self.represent_scalar("tag:yaml.org,2002:str", data, style=style)


_Dumper.add_representer(str, _Dumper.represent_str)


def _read_extended(path: Path, above: tuple[Path, ...], origins: Origins) -> dict[str, Any]:
    """Read a file on top of what it extends; nearer files win and leave their origin."""
    chain = (*above, path.resolve())
    if path.resolve() in above:
        raise ConfigError(f"`extends` runs in a circle: {' -> '.join(map(str, chain))}")
    if len(chain) > MAX_EXTENDS:
        raise ConfigError(f"{path}: more than {MAX_EXTENDS} files extend one another")
    document = read_yaml(path)
    content = _section(document.content, str(path))
    base = content.pop("extends", None)
    merged: dict[str, Any] = {}
    if base is not None:
        if not isinstance(base, str):
            raise ConfigError(f"{path}: extends = {base!r}: give one preset's name or one path")
        merged = _read_extended(find_config(base, path.parent), chain, origins)
    origins.update({key: f"{path}, line {line}" for key, line in document.lines.items()})
    return _merge(merged, content)


def _section(content: Any, source: str) -> dict[str, Any]:
    if content is None:
        return {}
    if not isinstance(content, dict):
        kind = type(content).__name__
        raise ConfigError(f"{source}: holds a {kind}; expected keys and values, `render: ...`")
    return dict(content)


def _override(text: str, origins: Origins) -> dict[str, Any]:
    key, sign, value = text.partition("=")
    names = key.strip().split(".")
    if not sign or not all(names) or len(names) > MAX_DEPTH:
        raise ConfigError(f"--set {text}: write key=value, for example --set render.spp=64")
    source = f"--set {text}"
    content = parse_yaml(value, source).content
    origins[key.strip()] = source
    for name in reversed(names):
        content = {name: content}
    result: dict[str, Any] = content
    return result


def _merge(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Lay one tree over another; sections merge, everything else is replaced."""
    merged = dict(below)
    for key, value in above.items():
        old = merged.get(key)
        both = isinstance(old, dict) and isinstance(value, dict)
        merged[key] = _merge(old, value) if both else value  # type: ignore[arg-type]
    return merged
