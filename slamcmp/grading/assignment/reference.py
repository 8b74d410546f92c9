"""The keys of ``assignment.yaml`` and ``mutants.yaml`` as Markdown, from the models that check them."""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel

from slamcmp.grading.assignment.description import (
    AssignmentFields,
    LimitFields,
    MutantFields,
    TestFields,
)
from slamcmp.registry import Plugin, test_kinds
from slamcmp.support.configuration.plugin_models import parameter_model

_ARGUMENT = re.compile(r"^(\w+): (.*)$")


def reference() -> str:
    """Tables of all keys, kind by kind."""
    parts = [
        _table("`assignment.yaml`", "", AssignmentFields, {}),
        _table("`limits`", "", LimitFields, {}),
        _table("A test: one entry of `tests`", "", TestFields, {}),
    ]
    for kind in test_kinds:
        summary = (inspect.getdoc(kind.target) or "").splitlines()[0]
        parts.append(_table(f"kind: {kind.name}", summary, parameter_model(kind), _documented(kind)))
    parts.append(_table("`mutants.yaml`: one entry of `mutants`", "", MutantFields, {}))
    return "\n".join(parts)


def _table(title: str, summary: str, model: type[BaseModel], docs: dict[str, str]) -> str:
    lines = [f"### {title}", ""]
    if summary:
        lines += [summary, ""]
    lines += ["| key | value | default | meaning |", "|---|---|---|---|"]
    schema = model.model_json_schema()["properties"]
    for name, field in model.model_fields.items():
        meaning = docs.get(name) or field.description or ""
        default = (
            "required" if field.is_required() else _default(field.get_default(call_default_factory=True))
        )
        cells = (f"`{name}`", _value(schema[name]), default, meaning)
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join([*lines, ""])


def _default(value: Any) -> str:
    if isinstance(value, BaseModel):
        return "below"
    if value in (None, "", ()):
        return ""
    return f"`{json.dumps(value)}`"


def _value(about: dict[str, Any]) -> str:
    """``number > 0``, ``list of texts``, from the JSON Schema of a key."""
    if "anyOf" in about:
        return " or ".join(_value(each) for each in about["anyOf"] if each.get("type") != "null")
    if "enum" in about:
        return ", ".join(f"`{each}`" for each in about["enum"])
    if about.get("type") == "array":
        return f"list of {_value(about['items'])}s"
    names = {"string": "text", "integer": "whole number", "object": "mapping", "boolean": "`true`, `false`"}
    signs = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}
    bounds = [f"{sign} {about[key]:g}" for key, sign in signs.items() if key in about]
    kind = about.get("type", "object")
    return " ".join([names.get(kind, kind), *bounds])


def _documented(kind: Plugin) -> dict[str, str]:
    """The ``Args:`` of its docstring by name."""
    return dict(_arguments(inspect.getdoc(kind.target) or ""))


def _arguments(doc: str) -> Iterator[tuple[str, str]]:
    _, _, after = doc.partition("Args:\n")
    name, text = "", ""
    for line in after.splitlines():
        if line and not line.startswith(" "):
            break
        found = _ARGUMENT.match(line.strip()) if line.startswith("    ") and line[4:5] != " " else None
        if found:
            if name:
                yield name, text
            name, text = found[1], found[2]
        else:
            text = f"{text} {line.strip()}".strip()
    if name:
        yield name, text
