"""Every entry is judged by its own scale: a small one is not hidden by a large; rounding is no mistake."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from slamcmp.geometry import se2
from slamcmp.grading.assignment.description import load_source
from slamcmp.grading.run.closeness import Rounded, entry_scales, judge_entries, rounded_answers
from slamcmp.grading.run.diagnosis import explain
from slamcmp.grading.run.implementations import Remembered, TrustedImplementation

FULL, ZERO = 1e-8, 1e-2
COVARIANCE = np.diag([1e-3, 1.0, 100.0]) @ (np.eye(3) + 0.5) @ np.diag([1e-3, 1.0, 100.0])


def share(answer: np.ndarray, expected: np.ndarray, *alike: np.ndarray) -> float:
    found = judge_entries(answer, expected, alike=alike, shifted=list, full=FULL, zero=ZERO)
    return found.share


CASES = {
    "a pose's heading among hundreds of metres": (se2(300.0, -200.0, 0.7), (0, 1), 0.02),
    "the small variance": (COVARIANCE, (0, 0), 3e-8),
    "a covariance of small and large": (COVARIANCE, (0, 2), 2e-3),
    "a landmark near by one far off": (np.array([[2.0, 1.0], [4e4, 3e4], [3.0, 5.0]]), (0, 1), 0.05),
    "a state's heading": (np.array([450.0, -320.0, 0.2]), (2,), 0.004),
}


@pytest.mark.parametrize("case", CASES)
def test_a_wrong_small_entry_is_not_hidden_by_a_large_one(case: str) -> None:
    expected, index, error = CASES[case]
    wrong = expected.copy()
    wrong[index] += error
    assert np.abs(wrong - expected).max() < ZERO * np.abs(expected).max(), "of its largest entry it is small"
    found = judge_entries(wrong, expected, alike=(), shifted=list, full=FULL, zero=ZERO)
    assert (found.share, found.index) == (0.0, index)
    assert share(expected, expected) == 1.0


@pytest.mark.parametrize("case", CASES)
def test_a_result_in_single_precision_is_right(case: str) -> None:
    expected, _, _ = CASES[case]
    assert share(expected.astype(np.float32).astype(float), expected) == 1.0


def test_an_entry_that_is_zero_by_chance_is_judged_by_what_it_usually_is() -> None:
    usual = [np.array([3.0, angle]) for angle in (0.5, -0.2, 1.0, -1.2)]
    expected = np.array([3.0, 1e-9])
    assert entry_scales(expected, usual)[1] == pytest.approx(0.5)
    assert share(expected + np.array([0.0, 1e-9]), expected, *usual) == 1.0
    assert share(expected + np.array([0.0, 1e-2]), expected, *usual) == 0.0


def test_an_entry_that_is_always_zero_is_judged_by_its_neighbours() -> None:
    expected = np.array([[1.0, 0.0], [0.5, 2.0]])
    assert entry_scales(expected, [expected] * 3)[0, 1] == pytest.approx(0.02)
    assert share(expected + np.array([[0, 1e-10], [0, 0]]), expected, *[expected] * 3) == 1.0
    assert share(expected + np.array([[0, 1e-3], [0, 0]]), expected, *[expected] * 3) == 0.0


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_wrong_unless_it_should_be(value: float) -> None:
    expected = np.array([1.0, 2.0])
    assert share(np.array([1.0, value]), expected) == 0.0
    assert share(np.array([1.0, value]), np.array([1.0, value])) == 1.0


SOLVES = """
import numpy as np

def solve(A, b):
    return np.linalg.solve(A, b)
"""


def test_rounding_counts_by_the_condition() -> None:
    """x = A⁻¹ b moves by about cond(A) ε; what is off by more, or by a tenth of ``zero``, is a mistake."""
    reference = TrustedImplementation(load_source("slamcmp_solves", SOLVES, Path("solves.py")))
    for condition, forgiven, wrong in ((1.0, 1e-5, 1e-4), (1e3, 5e-4, 3e-3), (1e12, 5e-4, 3e-3)):
        A, b = np.array([[1.0, 1.0], [1.0, 1.0 + 4 / condition]]) if condition > 1 else np.eye(2), np.ones(2)
        expected = reference.call("solve", A, b) + 0.0
        expected[np.abs(expected) < 1e-6] = 1.0

        def shifted(A: np.ndarray = A, b: np.ndarray = b) -> list[np.ndarray]:
            found = rounded_answers(lambda who: who.call("solve", A, b), reference)
            return [answer[()] for answer in found]

        def judged(error: float, expected: np.ndarray = expected, shifted=shifted) -> float:  # type: ignore[no-untyped-def]
            answer = expected * (1 + error)
            return judge_entries(answer, expected, alike=(), shifted=shifted, full=FULL, zero=ZERO).share

        assert judged(forgiven) == 1.0
        assert 0 < judged(wrong) < 1
        assert judged(2 * ZERO) == 0.0


def test_arguments_are_rounded_by_half_a_unit_of_single_precision_and_stay_symmetric() -> None:
    seen = []

    class Listening:
        def call(self, name: str, *arguments: object) -> object:
            seen.append(arguments)
            return None

    matrix, number, label = COVARIANCE, 0.1, np.array([1, 2])
    Rounded(Listening(), np.random.default_rng(0)).call("f", matrix, [number], {"label": label}, "text")  # type: ignore[arg-type]
    ((given, (scalar,), labels, text),) = seen
    assert np.abs(given / matrix - 1).max() == pytest.approx(2.0**-24)
    assert np.array_equal(given, given.T)
    assert scalar != number
    assert labels["label"] is label
    assert text == "text"


def test_a_mistake_in_a_small_entry_is_told_from_another_in_it() -> None:
    """Beside a landmark far off a metre is nothing; who moves the near one is named all the same."""
    far = np.array([[2.0, 1.0], [4e7, 3e7]])
    right, wrong = [Remembered("f", (), far)], [Remembered("f", (), far + np.array([[1.0, 0.0], [0.0, 0.0]]))]
    other = [Remembered("f", (), far + np.array([[0.0, 1.0], [0.0, 0.0]]))]
    assert explain(wrong, right, [("in y", other), ("in x", wrong)]) == ["in x"]
    assert explain(wrong, right, [("in y", other)]) != ["in y"]
