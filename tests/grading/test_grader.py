"""One bad test costs that test only, hidden seeds stay apart, and mistakes get their name."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slamcmp.errors import DataError, UsageError
from slamcmp.grading.assignment.description import find_assignment, load_assignment
from slamcmp.grading.assignment.seeds import hidden_seed
from slamcmp.grading.results.outcome import GradeOutcome, Visibility, load_outcome, save_outcome
from slamcmp.grading.results.scoring import log_linear
from slamcmp.grading.run.diagnosis import contradicted, explain
from slamcmp.grading.run.grader import Grading, grade
from slamcmp.grading.run.implementations import Remembered
from slamcmp.grading.run.publish import InProcess
from tests.grading.outcomes import example, path_plot, plot

SECRET = b"a secret of the tests"
linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the sandbox needs Linux")


def graded(folder: Path, source: str, seen: list[GradeOutcome] | None = None) -> GradeOutcome:
    path = folder / "kalman_filter.py"
    path.write_text(source)
    return grade(
        find_assignment("kalman_filter"),
        path,
        student="ada",
        secret=SECRET,
        out=folder / "outcome.json",
        accept_weak_sandbox=True,
        progress=seen.append if seen is not None else None,
    )


@linux
def test_bad_functions_cost_their_own_tests_only(tmp_path: Path) -> None:
    solution = load_assignment(find_assignment("kalman_filter")).solution_source
    crash = "\ndef run_filter(*arguments):\n    import ctypes\n    ctypes.string_at(0)\n"
    seen: list[GradeOutcome] = []
    outcome = graded(tmp_path, solution + crash, seen)
    assert [test.status for test in outcome.tests] == [
        *["passed"] * 3,
        *["error"] * 4,
        "skipped",
    ]
    assert outcome.score == pytest.approx(50)
    assert "SIGSEGV" in outcome.tests[3].message
    assert [len(each.tests) for each in seen] == list(range(1, 9))
    assert [each.complete for each in seen] == [False] * 7 + [True]
    assert load_outcome(tmp_path / "outcome.json") == outcome


@linux
def test_strange_answers_are_told_apart(tmp_path: Path) -> None:
    outcome = graded(
        tmp_path,
        "import numpy as np\n"
        "def predict(m, P, A, Q):\n    return np.full(len(m), np.nan), np.zeros(99)\n"
        "def correct(m, P, y, C, R):\n    return None\n",
    )
    assert outcome.score == 0
    assert outcome.complete
    assert "[0] of predict is not finite" in outcome.tests[0].message
    assert "shape (99,)" in outcome.tests[0].message
    assert "correct returned 1 values" in outcome.tests[1].message
    assert "run_filter" in outcome.tests[3].message


@linux
def test_a_submission_that_is_no_python_gets_a_zero_that_says_why(tmp_path: Path) -> None:
    outcome = graded(tmp_path, "def predict(:\n")
    assert (outcome.score, outcome.max_score, outcome.complete) == (0, 100, True)
    assert "kalman_filter.py, line 1" in outcome.tests[0].message
    text = tmp_path / "essay.txt"
    text.write_text("no code")
    refused = grade(find_assignment("kalman_filter"), text, student="a", secret=SECRET, out=None)
    assert refused.score == 0
    assert "hand in a .py file" in refused.notes[0]


@pytest.mark.parametrize("visibility", ["visible", "hidden", "after_due_date", "after_published"])
def test_the_leaderboard_holds_visible_tests_only(visibility: Visibility) -> None:
    assignment = load_assignment(find_assignment("kalman_filter"))
    (accuracy,) = (test for test in assignment.tests if test.fields.kind == "accuracy")
    only = replace(accuracy, fields=accuracy.fields.model_copy(update={"visibility": visibility}))
    grading = Grading(replace(assignment, tests=(only,)), "ada", SECRET)
    outcome = grading.run(InProcess(assignment.solution()), lambda outcome: None)
    expected = (("error / reference", 1.0, "asc"),) if visibility == "visible" else ()
    assert (outcome.score, outcome.leaderboard) == (10, expected)


@pytest.mark.parametrize("name", ["ekf", "ekf_slam"])
def test_accuracy_draws_the_path_that_was_driven(name: str) -> None:
    assignment = load_assignment(find_assignment(name))
    (accuracy,) = (test for test in assignment.tests if test.fields.kind == "accuracy")
    grading = Grading(replace(assignment, tests=(accuracy,)), "ada", SECRET)
    outcome = grading.run(InProcess(assignment.solution()), lambda outcome: None)
    path, error = outcome.tests[0].plots
    truth, reference, yours = path.series
    assert path.equal_scales
    assert (yours.x, yours.y) == (reference.x, reference.y)
    apart = np.hypot(np.subtract(yours.x, truth.x), np.subtract(yours.y, truth.y))
    # The body's axes or the world's: a distance is the same.
    assert apart == pytest.approx(error.series[0].y, abs=0.02)
    assert 0.01 < apart.max() < 2.0


def test_outcomes_of_another_format_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "outcome.json"
    test = replace(example().tests[1], plots=(plot(), path_plot()))
    outcome = replace(example(), tests=(test,), leaderboard=())
    save_outcome(outcome, path)
    assert load_outcome(path) == outcome
    path.write_text(path.read_text().replace('"format": 2', '"format": 1'))
    with pytest.raises(DataError, match="format 1, written by another version"):
        load_outcome(path)


def test_short_secrets_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="at least 16"):
        grade(find_assignment("kalman_filter"), tmp_path, student="a", secret=b"short", out=None)


def test_seeds_differ_by_every_part() -> None:
    parts = [("a", "b", "c"), ("ab", "", "c"), ("a", "bc", ""), ("a", "b", "d")]
    seeds = {hidden_seed(SECRET, *part) for part in parts} | {hidden_seed(b"another secret..", *parts[0])}
    assert len(seeds) == 5
    assert hidden_seed(SECRET, *parts[0]) == hidden_seed(SECRET, *parts[0])


def test_credit_falls_with_the_logarithm() -> None:
    errors = (0.0, 1e-8, 1e-5, 1e-2, math.nan, math.inf)
    assert [log_linear(error, 1e-8, 1e-2) for error in errors] == pytest.approx([1, 1, 0.5, 0, 0, 0])


def test_diagnosis_prefers_known_mistakes_and_falls_back_on_signatures() -> None:
    right = [Remembered("f", (), (np.array([0.1, 2.0]), np.eye(2)))]
    turned = [Remembered("f", (), (np.array([0.1 + 2 * np.pi, 2.0]), np.eye(2)))]
    known = [("bearing {yours:.2f} for {expected:.1f} in call {call}", turned)]
    assert explain(turned, right, known) == ["bearing 6.38 for 0.1 in call 1"]
    assert explain(turned, right, []) == [
        "output 1 of f in [0] is off by whole turns; angles are wrapped to (-π, π]."
    ]
    negated = [Remembered("f", (), (-right[0].answer[0], np.eye(2)))]
    assert explain(negated, right, known) == ["output 1 of f has the wrong sign throughout."]
    assert explain(right, right, known) == []


def test_diagnosis_knows_an_inverse_from_any_other_wrong_matrix() -> None:
    covariance = np.array([[2.0, 0.5], [0.5, 1.0]])
    right = [Remembered("f", (), covariance)]
    inverse = [Remembered("f", (), np.linalg.inv(covariance))]
    assert explain(inverse, right, []) == ["f is the inverse of what it should be."]
    other = [Remembered("f", (), np.array([[2.0, 0.1], [0.1, 1.0]]))]
    assert explain(other, right, []) == []


def test_diagnosis_claims_nothing_where_several_mistakes_answer_the_same() -> None:
    right, wrong = [Remembered("f", (), 1.0)], [Remembered("f", (), 3.0)]
    known = [("first", [Remembered("f", (), 2.0)]), ("second", wrong), ("third", wrong)]
    assert explain(wrong, right, known[:2]) == ["second"]
    assert explain(wrong, right, known) == []


def test_diagnosis_claims_no_mistake_that_one_output_speaks_against() -> None:
    """Two of three outputs are those of the mistake, the third is right: it is another mistake."""
    right = [Remembered("f", (), (1.0, 2.0, 5.0))]
    known = [("a sign", [Remembered("f", (), (-1.0, -2.0, -5.0))])]
    assert explain([Remembered("f", (), (-1.0, -2.0, 5.0))], right, known) != ["a sign"]
    assert explain([Remembered("f", (), (-1.0, -2.0, -5.0))], right, known) == ["a sign"]
    later = [*right, Remembered("f", (), (3.0, 4.0, 6.0))]
    mutant = [known[0][1][0], Remembered("f", (), (-3.0, -4.0, -6.0))]
    once = [known[0][1][0], later[1]]
    assert "a sign" not in explain(once, later, [("a sign", mutant)])


def test_diagnosis_looks_for_no_mistake_in_what_is_still_to_be_written() -> None:
    right = [Remembered("f", (), 1.0)]
    assert explain([Remembered("f", (), "NotImplementedError: ")], right, [("any", right)]) == []


def test_a_mistake_speaks_against_itself_where_the_student_is_right() -> None:
    right = [Remembered("g", (1.0,), 2.0), Remembered("g", (2.0,), 4.0)]
    mutant = [right[0], Remembered("g", (2.0,), 5.0)]
    assert contradicted(mutant, right)
    assert not contradicted(mutant, mutant)
    assert not contradicted([Remembered("g", (7.0,), 1.0)], right), "another question"


def test_a_mistake_that_leaves_wrong_answers_unexplained_is_not_the_one() -> None:
    """Both branches of a condition exchanged: where one of them is asked for it looks like half of it."""
    right = [Remembered("g", ("a",), 2.0), Remembered("g", ("b",), 4.0)]
    exchanged = [Remembered("g", ("a",), 4.0), Remembered("g", ("b",), 2.0)]
    always = [right[0], Remembered("g", ("b",), 2.0)]
    assert contradicted(always, exchanged)
    assert contradicted(right, exchanged)


def test_diagnosis_takes_no_common_error_for_a_known_mistake() -> None:
    right = [Remembered("f", (), np.eye(2))]
    stopped = [Remembered("f", (), "LinAlgError: Matrix is not positive definite")]
    assert explain(stopped, right, [("an unrelated mistake", stopped)]) == []


def test_diagnosis_tells_rows_too_many_and_too_few_and_swapped_columns() -> None:
    pairs = np.array([[0, 3], [1, 2], [4, 4]])

    def cause(answer: np.ndarray) -> list[str]:
        return explain([Remembered("match", (), answer)], [Remembered("match", (), pairs)], [])

    more = np.vstack([pairs[:1], [[0, 1], [3, 1]], pairs[1:]])
    assert cause(more) == ["match holds all that it should and 2 rows more."]
    assert cause(pairs[:2]) == ["match lacks 1 rows and is right in the others."]
    assert cause(pairs[:, ::-1]) == ["match has its two columns swapped."]
    assert cause(pairs[[0, 0, 0]]) == [], "as many rows, one of them three times"


def test_diagnosis_tells_what_is_seen_and_does_not_guess() -> None:
    right = [Remembered("f", (), np.array([1.0, 2.0]))]
    for answer, said in (
        ("LinAlgError: Singular matrix", "f solves equations that have no unique solution."),
        (np.array([3e9, -1e9]), "f is larger than what it should be by many orders of magnitude."),
        (np.array([np.nan, 2.0]), "f holds numbers that are not finite (NaN or infinite)."),
        (np.array([1.0, -2.0]), "f in [1] has the wrong sign."),
        (np.array([1.0, np.degrees(2.0)]), "f in [1] is in degrees where radians are needed."),
    ):
        assert explain([Remembered("f", (), answer)], right, []) == [said]


def test_diagnosis_names_the_mistake_that_explains_most() -> None:
    right = [Remembered("test", (), (4.0, True)), Remembered("test", (), (9.0, False))]
    root = [Remembered("test", (), (2.0, True)), Remembered("test", (), (3.0, True))]
    lenient = [Remembered("test", (), (4.0, True)), Remembered("test", (), (9.0, True))]
    known = [("accepts everything", lenient), ("takes the root", root)]
    assert explain(root, right, known) == ["takes the root"]
    assert explain(lenient, right, known) == ["accepts everything"]


def test_diagnosis_looks_for_no_mistake_where_another_question_was_asked() -> None:
    def answers(first: float, second: float) -> list[Remembered]:
        return [Remembered("f", (1.0,), first), Remembered("g", (first,), second)]

    right, wrong_f = answers(2.0, 20.0), answers(3.0, 30.0)
    # Another mistake of g answers 30 too, to what f rightly answered.
    known = [("a mistake in g", answers(2.0, 30.0)), ("a mistake in f", answers(3.0, 30.0))]
    assert explain(wrong_f, right, known) == ["a mistake in f"]
