"""A small world, and a back end that only this process has."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import slamcmp

WORLD = {"name": "circle", "landmarks": 8, "steps": 25}


class Reckoner:
    """Dead reckoning; ``scale`` stretches each step."""

    def __init__(self, problem: slamcmp.Problem, *, scale: float = 1.0) -> None:
        self.T, self.P, self.scale = np.array(problem.T_world_body), np.array(problem.P), scale

    def update(self, frame: slamcmp.Frame) -> None:
        step = np.array(frame.T_prev_body)
        step[:2, 2] *= self.scale
        self.T, self.P = self.T @ step, self.P + frame.Q

    def estimate(self) -> slamcmp.Estimate:
        return slamcmp.Estimate(self.T, self.P)


@pytest.fixture
def local_class() -> type:
    """A class that no other process can import, as if a notebook's cell had defined it."""

    class Cell(Reckoner):
        pass

    Cell.__module__ = "__main__"
    return Cell


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def ran() -> Callable[..., Any]:
    """``slamcmp.run`` of a mapping on the small world, one job at a time and without a word."""

    def run(back_ends: list[Any], **fields: Any) -> slamcmp.Results:
        options = {name: fields.pop(name) for name in ("folder", "executor", "progress") if name in fields}
        return slamcmp.run(
            {"source": WORLD, "back_ends": back_ends, **fields}, **{"progress": False} | options
        )

    return run
