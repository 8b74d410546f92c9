"""The shipped assignments: the reference earns all, the starter nothing, every known mistake is named."""

from __future__ import annotations

import shutil
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from slamcmp.backends.window.sliding_window import SlidingWindow
from slamcmp.errors import UsageError
from slamcmp.grading.assignment.description import find_assignment, load_assignment, load_source
from slamcmp.grading.assignment.handout import SHIPPED
from slamcmp.grading.run.grader import Grading
from slamcmp.grading.run.publish import InProcess, check_publishable
from slamcmp.support.configuration.config_errors import ConfigError

SECRET = b"a secret of the tests"
NAMES = sorted(path.parent.name for path in SHIPPED.glob("*/assignment.yaml"))


@pytest.mark.parametrize("name", NAMES)
def test_gate(name: str) -> None:
    assert check_publishable(name, seeds=2, mutants=4, sandboxed=False) == []


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
    fewer = replace(assignment, tests=wanted)
    grading = Grading(fewer, "ada", b"a secret of the tests", causes=False)
    smoother = InProcess(SmootherInside(assignment.solution(), back_end))  # type: ignore[arg-type]
    tests = {test.name: test for test in grading.run(smoother, lambda outcome: None).tests}
    # More accurate than what was asked for, and not it.
    assert tests["Accuracy"].score == tests["Accuracy"].max_score
    assert [tests[test].score for test in lost] == [0.0] * len(lost)


FRONT_END_BY_OTHER_MEANS = """
import random

def samples_needed(share, confidence):
    clean = share**SAMPLE
    return 1 if clean == 1 else int(np.ceil(np.log(1 - confidence) / np.log1p(-clean)))

def eigen_fit(first, second):
    (x1, T1), (x2, T2) = normalised(first), normalised(second)
    A = np.array([np.kron(two, one) for one, two in zip(x1, x2)])
    F = np.linalg.eigh(A.T @ A)[1][:, 0].reshape(3, 3)
    U, s, Vt = np.linalg.svd(F)
    return scaled(-T2.T @ (F - s[2] * np.outer(U[:, 2], Vt[2])) @ T1)

fundamental_least_squares = eigen_fit

def ransac_fundamental(first, second, threshold_px, confidence, samples_max, seed):
    draws, best, needed, drawn = random.Random(seed), [], samples_max, 0
    while drawn < needed:
        drawn += 1
        sample = draws.sample(range(len(first)), SAMPLE)
        F = eigen_fit(first[sample], second[sample])
        inliers = np.flatnonzero(sampson_distance(F, first, second) <= threshold_px)
        if len(inliers) > len(best):
            best = inliers
            needed = min(samples_max, samples_needed(len(best) / len(first), confidence))
    for _ in range(20):
        F = eigen_fit(first[best], second[best])
        best = np.flatnonzero(sampson_distance(F, first, second) <= threshold_px)
    return F, np.isin(np.arange(len(first)), best)
"""
LEAST_SQUARES_FOR_RANSAC = """
def ransac_fundamental(first, second, threshold_px, confidence, samples_max, seed):
    F = fundamental_least_squares(first, second)
    return F, sampson_distance(F, first, second) <= threshold_px
"""


def front_end_scores(more: str, *names: str) -> tuple[dict[str, float], dict[str, str]]:
    assignment = load_assignment(find_assignment("front_end"))
    assignment = replace(
        assignment, tests=tuple(test for test in assignment.tests if not names or test.fields.name in names)
    )
    module = load_source("front_end_of_ada", assignment.solution_source + more, Path("ada.py"))
    tests = Grading(assignment, "ada", SECRET).run(InProcess(module), lambda outcome: None).tests
    return {test.name: test.score for test in tests}, {test.name: test.message for test in tests}


def test_a_right_front_end_with_other_draws_and_other_algebra_earns_everything() -> None:
    scores, messages = front_end_scores(FRONT_END_BY_OTHER_MEANS)
    assert sum(scores.values()) == pytest.approx(100), messages


def test_least_squares_in_place_of_ransac_is_caught() -> None:
    relevant = ("Least squares", "RANSAC", "The majority decides")
    scores, messages = front_end_scores(LEAST_SQUARES_FOR_RANSAC, *relevant)
    # F itself is so near in one case of four that it earns a five-hundredth.
    assert [scores[name] for name in relevant] == [10, pytest.approx(0, abs=0.1), 0]
    cause = "Your F is the least-squares fit to all matches"
    assert [messages[name].startswith(cause) for name in relevant] == [False, True, True]


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


class Recording:
    """A module's functions, with what two of them answered."""

    def __init__(self, module: ModuleType) -> None:
        self._module = module
        self.answers: dict[str, list[np.ndarray]] = {}

    def call(self, name: str, *arguments: object) -> object:
        answer = getattr(self._module, name)(*arguments)
        self.answers.setdefault(name, []).append(answer)
        return answer


@pytest.mark.parametrize("seed", range(3))
def test_most_corners_are_found_again_at_half_the_size(seed: int) -> None:
    """Of those of the large picture that the small one shows at the same place, one level lower."""
    assignment = load_assignment(find_assignment("front_end"))
    recording = Recording(assignment.solution())
    assignment.cases.half_the_size(recording, np.random.default_rng(seed))
    *large, small_0, small_1 = recording.answers["at_full_size"]
    ((pairs,),) = [recording.answers["match"]]
    level = np.repeat([0, 1, 2], [len(each) for each in large])
    lower = np.repeat([0, 1], [len(small_0), len(small_1)])
    here, there = np.concatenate(large), 2.0 * (np.concatenate([small_0, small_1]) + 0.5) - 0.5
    near = np.linalg.norm(here[:, None] - there, axis=2) < 3.0
    repeatable = (near & (level[:, None] == lower + 1)).any(axis=1)
    right = np.zeros(len(here), dtype=bool)
    right[pairs[near[pairs[:, 0], pairs[:, 1]], 0]] = True
    assert repeatable.sum() > 20
    assert right[repeatable].mean() > 0.6


def test_cases_may_be_a_package_and_two_of_one_name_do_not_mix(tmp_path: Path) -> None:
    for number in (1, 2):
        folder = tmp_path / str(number) / "kalman_filter"
        shutil.copytree(find_assignment("kalman_filter"), folder)
        (folder / "cases").mkdir()
        (folder / "cases.py").rename(folder / "cases" / "all_of_them.py")
        with (folder / "cases" / "all_of_them.py").open("a") as file:
            file.write(f"\nNUMBER = {number}\n")
        (folder / "cases" / "__init__.py").write_text("from .all_of_them import NUMBER, predictions\n")
        cases = load_assignment(folder).cases
        assert number == cases.NUMBER
        assert callable(cases.predictions)
    (folder / "cases" / "all_of_them.py").unlink()
    with pytest.raises(UsageError, match="does not import"):
        _ = load_assignment(folder).cases
