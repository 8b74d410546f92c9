"""The shipped assignments: the reference earns all, the starter nothing, every known mistake is named."""

from __future__ import annotations

import shutil
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import ModuleType

import pytest

from slamcmp.backends.sliding_window import SlidingWindow
from slamcmp.experiment.config_errors import ConfigError
from slamcmp.grading.assignment import SHIPPED, find_assignment, load_assignment
from slamcmp.grading.grader import Grading
from slamcmp.grading.publish import InProcess, check_publishable

NAMES = sorted(path.parent.name for path in SHIPPED.glob("*/assignment.yaml"))


@pytest.mark.parametrize("name", NAMES)
def test_gate(name: str) -> None:
    assert check_publishable(name, seeds=2, sandboxed=False) == []


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the sandbox needs Linux")
@pytest.mark.parametrize("name", NAMES)
def test_gate_in_the_sandbox(name: str) -> None:
    assert check_publishable(name, seeds=10, accept_weak_sandbox=True) == []


@pytest.mark.parametrize("name", NAMES)
def test_points_and_mutants(name: str) -> None:
    assignment = load_assignment(find_assignment(name))
    assert sum(test.fields.points for test in assignment.tests) == 100
    assert len(assignment.mutants) >= 8


class SmootherInside:
    """An assignment's solution with a smoother in place of its back end."""

    def __init__(self, module: ModuleType, back_end: str) -> None:
        self.__dict__.update(vars(module))
        setattr(self, back_end, partial(SlidingWindow, window=None, iterations=10))


@pytest.mark.parametrize(
    ("name", "back_end", "lost"),
    [
        ("ekf_slam", "EkfSlam", ["Linearised anew at every mean"]),
        ("factor_graph", "WindowOne", ["Window 1 is the EKF", "The past is gone"]),
    ],
)
def test_a_smoother_in_place_of_the_ekf_is_caught(name: str, back_end: str, lost: list[str]) -> None:
    assignment = load_assignment(find_assignment(name))
    wanted = tuple(test for test in assignment.tests if test.fields.name in ("Accuracy", *lost))
    # Only what is lost counts here, not how it is explained.
    fewer = replace(assignment, tests=wanted, mutants=())
    grading = Grading(fewer, "ada", b"a secret of the tests")
    smoother = InProcess(SmootherInside(assignment.solution(), back_end))  # type: ignore[arg-type]
    tests = {test.name: test for test in grading.run(smoother, lambda outcome: None).tests}
    # More accurate than what was asked for, and not it.
    assert tests["Accuracy"].score == tests["Accuracy"].max_score
    assert [tests[test].score for test in lost] == [0.0] * len(lost)


def test_mistakes_in_the_specification_have_a_place(tmp_path: Path) -> None:
    folder = tmp_path / "kalman_filter"
    shutil.copytree(find_assignment("kalman_filter"), folder)
    spec = folder / "assignment.yaml"
    text = spec.read_text().replace(
        "kind: unit\n    points: 20\n    function: predict", "kind: unti\n    points: 20"
    )
    spec.write_text(text.replace("runs: 40", "run: 40"))
    with pytest.raises(ConfigError) as caught:
        load_assignment(folder)
    first, second = caught.value.lines
    assert first.startswith(f"{spec}:7:11: unknown kind of test 'unti'; did you mean 'unit'?")
    assert "unknown key 'run'; did you mean 'runs'?" in second
