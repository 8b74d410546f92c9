"""What two results folders differ in: configuration, code, versions, from what their manifests say."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from slamcmp.results.grid import value_text
from slamcmp.results.store import Results

ABSENT = "not set"
UNKNOWN = "not known"
NO_SETTING = frozenset({"name", "question", "description", "seeds", "figures", "published"})
"""Keys of a configuration that change no run; how many seeds there are is seen in the pairs."""
MACHINE = ("python", "platform", "cpu")


@dataclass(frozen=True)
class Difference:
    """One thing that is otherwise."""

    key: str
    """``source.range_sigma_m``, ``back_ends.EKF.own_gate``, ``commit``, ``numpy``."""
    base: str
    other: str


@dataclass(frozen=True)
class Differences:
    """All that two folders differ in."""

    configuration: tuple[Difference, ...]
    code: tuple[Difference, ...]
    versions: tuple[Difference, ...]


def differences(base: Results, other: Results, names: Mapping[str, str] | None = None) -> Differences:
    """Of two folders; ``names`` maps labels of ``base`` to those of ``other`` that they are paired with."""
    manifests = base.manifest, other.manifest
    back = {theirs: ours for ours, theirs in (names or {}).items()}
    configs = [dict(_flat(_settings(each, known))) for each, known in zip(manifests, ({}, back), strict=True)]
    codes = [_code(manifests[0], {}), _code(manifests[1], back)]
    versions = [
        {**(each.get("versions") or {}), **{name: each[name] for name in MACHINE if each.get(name)}}
        for each in manifests
    ]
    return Differences(
        _between(*configs, missing=ABSENT),
        _between(*codes, missing=UNKNOWN),
        _between(*versions, missing=UNKNOWN),
    )


def setting(manifest: Mapping[str, Any], path: str) -> Any:
    """What a configuration sets under a path that a sweep could name; None where it sets nothing."""
    section, _, rest = path.partition(".")
    config = manifest.get("config") or {}
    if section != "back_ends":
        return (config.get(section) or {}).get(rest)
    label, _, parameter = rest.rpartition(".")
    return next(
        (each.get(parameter) for each in config.get("back_ends") or [] if each.get("label") == label), None
    )


def _settings(manifest: Mapping[str, Any], renamed: Mapping[str, str]) -> dict[str, Any]:
    """The configuration with back ends by their label and no defaults of what is not there."""
    config = {key: value for key, value in (manifest.get("config") or {}).items() if key not in NO_SETTING}
    entries = config.get("back_ends")
    if isinstance(entries, list):
        labelled = {str(each.get("label", each.get("name"))): each for each in entries}
        config["back_ends"] = {
            renamed.get(label, label): {key: value for key, value in each.items() if key != "label"}
            for label, each in labelled.items()
        }
    return config


def _code(manifest: Mapping[str, Any], renamed: Mapping[str, str]) -> dict[str, Any]:
    """The commit, and the version of what makes the stream and of each back end by its text."""
    commit = manifest.get("commit")
    text = None
    if isinstance(commit, Mapping):
        text = f"{str(commit.get('sha'))[:12]}{' with uncommitted changes' if commit.get('dirty') else ''}"
    elif commit:
        text = str(commit)
    parts = {
        renamed.get(str(part), str(part)): str(version)[:12]
        for part, version in (manifest.get("code") or {}).items()
    }
    return {**({} if text is None else {"commit": text}), **parts}


def _flat(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping) and value:
        for key, each in value.items():
            yield from _flat(each, f"{path}.{key}" if path else str(key))
    elif value not in (None, {}, []):
        yield path, value


def _between(base: Mapping[str, Any], other: Mapping[str, Any], *, missing: str) -> tuple[Difference, ...]:
    found = []
    for key in dict.fromkeys((*base, *other)):
        values = [value_text(each[key]) if key in each else missing for each in (base, other)]
        if values[0] != values[1]:
            found.append(Difference(key, *values))
    return tuple(found)
