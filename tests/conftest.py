"""Experiments made of the plug-ins in ``user_plugins.py``."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from slamcmp.backends.filters import loops

# What a test computes is its own: nothing comes from, or goes to, the cache that experiments share.
os.environ["SLAMCMP_CACHE"] = "off"

PLUGINS = Path(__file__).with_name("user_plugins.py")


@pytest.fixture
def write_experiment(tmp_path: Path) -> Callable[..., Path]:
    """Write an experiment on the straight world: ``write(back_ends=[...], seeds=...)``.

    Back ends are names of classes in ``user_plugins.py``, or mappings that override.
    """

    def write(name: str = "experiment", **fields: Any) -> Path:
        fields.setdefault("source", {"name": f"{PLUGINS}:straight"})
        fields["back_ends"] = [
            {"name": f"{PLUGINS}:{each}"}
            if isinstance(each, str)
            else {**each, "name": f"{PLUGINS}:{each['name']}"}
            for each in fields["back_ends"]
        ]
        path = tmp_path / f"{name}.yaml"
        # JSON is YAML.
        path.write_text(json.dumps(fields))
        return path

    return write


@pytest.fixture
def plain_filters(monkeypatch: pytest.MonkeyPatch) -> None:
    """No filter is compiled: what is equal to the bit is so among filters that do their frames themselves."""
    monkeypatch.setattr(loops, "kernels", lambda: None)
