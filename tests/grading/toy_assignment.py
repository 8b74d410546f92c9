"""The smallest assignment: three functions of one number, 10 points each, the last one hidden."""

from __future__ import annotations

from pathlib import Path

_YAML = """
title: Toy
entry: toy.py
functions: [double, half, square]
packages: [numpy]
limits: {request_s: 2, load_s: 2, memory_mb: 512}
tests:
  - {name: Double, kind: unit, points: 10, function: double, cases: numbers}
  - {name: Half, kind: unit, points: 10, function: half, cases: numbers}
  - {name: SECRET-SQUARE, kind: unit, points: 10, function: square, cases: numbers, visibility: hidden}
"""
_CASES = """
from slamcmp.grading.run.trial import Case


def numbers(reference, generator):
    return [Case((float(number),)) for number in generator.uniform(1, 9, size=10)]
"""
SOLUTION = """
def double(x): return 2.0 * x
def half(x): return x / 2.0
def square(x): return x * x
"""


def write(parent: Path) -> Path:
    """The assignment's folder, made in ``parent``."""
    folder = parent / "toy"
    (folder / "solution").mkdir(parents=True)
    (folder / "assignment.yaml").write_text(_YAML)
    (folder / "cases.py").write_text(_CASES)
    (folder / "solution" / "solution.py").write_text(SOLUTION)
    return folder
