"""Turning validation errors into sentences that teach: the value, what is allowed, where it is."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ValidationError

from synthgen.errors import nearest


def explain(error: ValidationError, schema: type[BaseModel], origins: dict[str, str]) -> str:
    """Describe every fault of a configuration, one line each.

    Parameters
    ----------
    error : pydantic.ValidationError
    schema : type
        The model that refused.
    origins : dict of str to str
        Where each dotted key was set, for example ``"preset.yaml, line 7"`` or ``"--set"``; under
        ``""`` what is said of keys that were not set.
    """
    json_schema = schema.model_json_schema()
    lines = [_fault(dict(detail), json_schema, origins) for detail in error.errors()]
    return "\n".join(dict.fromkeys(lines))


def _fault(detail: dict[str, Any], schema: dict[str, Any], origins: dict[str, str]) -> str:
    names = [part for part in detail["loc"] if isinstance(part, str)]
    path = ".".join(names)
    where = _origin(names, origins)
    if detail["type"] == "extra_forbidden":
        return f"{where}unknown key {path!r}{_suggestion(names, schema)}"
    if detail["type"] == "missing":
        meant = allowed(path, schema) or f"keys {', '.join(_fields(_at(names, schema), schema))}"
        return f"{where}{path} is missing; it takes {meant}"
    value = detail["input"]
    text = f"{where}{path or 'the configuration'} = {_shown(value)}"
    if detail["type"] == "value_error":  # a check of ours, which says what to do
        return f"{text}: {str(detail['msg']).removeprefix('Value error, ')}"
    meant = allowed(path, schema)
    if not meant:
        return f"{text}: expected keys: {', '.join(_fields(_at(names, schema), schema))}"
    words = _at(names, schema).get("enum", [])
    close = nearest(value, words) if isinstance(value, str) else ""
    return f"{text}{close}; allowed is {meant}"


def _origin(names: list[str], origins: dict[str, str]) -> str:
    """Return where the key, or else the nearest section around or key inside it, was set."""
    path = ".".join(names)
    inside = [key for key in origins if key.startswith(f"{path}.")]
    around = [".".join(names[:count]) for count in range(len(names), 0, -1)]
    for key in [*reversed(inside), *around]:
        if key in origins:
            return f"{origins[key]}: "
    return f"{origins['']}: " if "" in origins else ""


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


def _suggestion(names: list[str], schema: dict[str, Any]) -> str:
    siblings = list(_fields(_at(names[:-1], schema), schema))
    leaves = dotted_keys(schema)
    same = [leaf for leaf in leaves if leaf.rsplit(".", 1)[-1] == names[-1]]
    found = f" - did you mean {same[0]!r}?" if same else nearest(names[-1], siblings)
    found = found or nearest(".".join(names), leaves)
    section = ".".join(names[:-1]) or "the top level"
    return f"{found}; {section} has {', '.join(siblings)}"


def dotted_keys(schema: dict[str, Any]) -> list[str]:
    """Return every key of a JSON schema that is not a section, dotted."""
    return _leaves("", schema, schema)


def _leaves(prefix: str, node: dict[str, Any], schema: dict[str, Any]) -> list[str]:
    found: list[str] = []
    for name, child in _fields(node, schema).items():
        inner = _resolve(child, schema)
        path = f"{prefix}{name}"
        found += _leaves(f"{path}.", inner, schema) if "properties" in inner else [path]
    return found


def allowed(path: str, schema: dict[str, Any]) -> str:
    """Say in words what may stand at a dotted key; empty for sections and unknown keys."""
    node = _at(path.split("."), schema) if path else {}
    return "" if "properties" in node else _words(node, schema)


def _words(node: dict[str, Any], schema: dict[str, Any]) -> str:
    node = _resolve(node, schema)
    if "anyOf" in node:
        return " or ".join(filter(None, (_words(child, schema) for child in node["anyOf"])))
    if "enum" in node:
        return "one of " + ", ".join(str(value) for value in node["enum"])
    if "const" in node:
        return str(node["const"])
    kind = node.get("type")
    if kind in ("integer", "number"):
        return ("a whole number" if kind == "integer" else "a number") + _bounds(node)
    if kind == "array" and "prefixItems" in node:
        inner = node["prefixItems"]
        return f"a list of {len(inner)}, each {_words(inner[0], schema)}"
    if kind == "array":
        return f"a list, each {_words(node.get('items', {}), schema)}"
    return {"string": "a text", "boolean": "true or false", "null": "null"}.get(str(kind), "")


def _bounds(node: dict[str, Any]) -> str:
    low, above = node.get("minimum"), node.get("exclusiveMinimum")
    high = node.get("maximum")
    if above is not None:
        return f" above {_number(above)} up to {_number(high)}"
    return f" from {_number(low)} to {_number(high)}" if low is not None else ""


def _number(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _at(names: list[str], schema: dict[str, Any]) -> dict[str, Any]:
    node = schema
    for name in names:
        inside = _resolve(node, schema)
        own = inside.get("properties", {}).get(name)
        # A mapping by free names, such as the units of a rig, has one schema for all of them.
        free: dict[str, Any] = next(iter(inside.get("patternProperties", {}).values()), {})
        node = _resolve(own or free, schema)
    return node


def _fields(node: dict[str, Any], schema: dict[str, Any]) -> dict[str, Any]:
    fields: dict[str, Any] = _resolve(node, schema).get("properties", {})
    return fields


def _resolve(node: dict[str, Any], schema: dict[str, Any]) -> dict[str, Any]:
    reference = node.get("$ref")
    if reference is None:
        return node
    found: dict[str, Any] = schema["$defs"][str(reference).rsplit("/", 1)[-1]]
    return found
