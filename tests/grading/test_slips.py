"""Slips: a function with one thing done otherwise is recognised by its answers, and no other is."""

from __future__ import annotations

import ast
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from slamcmp.grading.assignment.description import find_assignment, load_assignment, load_source
from slamcmp.grading.assignment.handout import SHIPPED
from slamcmp.grading.run.implementations import Remembered, Remembering, TrustedImplementation
from slamcmp.grading.run.slips.kinds import SORTED
from slamcmp.grading.run.slips.making import slips
from slamcmp.grading.run.slips.pieces import changes_of_part
from slamcmp.grading.run.slips.search import SlipSearch

SOLUTION = '''
import numpy as np


def divided(S, PC):
    """Helper that no student has."""
    return np.linalg.solve(S, PC).T


def update(mean, P, y, C, R):
    S = C @ P @ C.T + R
    gain = divided(S, C @ P)
    return mean + gain @ (y - C @ mean), P - gain @ C @ P


def turned(mean, angles):
    total = np.zeros(2)
    for number in range(len(angles)):
        total[0] += number * np.cos(angles[number]) * mean[0] / mean[1]
        total[1] += np.arctan2(mean[1], mean[0]) ** 2
    return total


def near(mean, P, y, C, R):
    distance = y - C @ mean
    return distance, bool(distance @ distance < 3 * len(distance))


def run(mean, P, observations, C, R):
    means = []
    for y in observations:
        mean, P = update(mean, P, y, C, R)
        means.append(mean)
    return np.array(means)
'''
ASKED = frozenset({"update", "turned", "near", "run"})


def module(source: str) -> ModuleType:
    return load_source("slamcmp_student_of_slips", source, Path("student.py"))


def covariance(generator: np.random.Generator, size: int) -> np.ndarray:
    root = generator.normal(size=(size, size))
    return root @ root.T + np.eye(size)


def calls_of(source: str, function: str) -> list[Remembered]:
    """What a student's code answers in three calls."""
    asked = Remembering(TrustedImplementation(module(source)))
    generator = np.random.default_rng(3)
    for _ in range(3):
        mean, P = generator.normal(size=3), covariance(generator, 3)
        C, R = generator.normal(size=(2, 3)), covariance(generator, 2)
        arguments = {
            "update": (mean, P, generator.normal(size=2), C, R),
            "near": (mean, P, generator.normal(size=2), C, R),
            "turned": (mean, generator.uniform(-3, 3, size=4)),
            "run": (mean, P, generator.normal(size=(5, 2)), C, R),
        }[function]
        try:
            asked.call(function, *arguments)
        except Exception:
            continue
    return asked.answers


def said(old: str, new: str, function: str) -> str:
    assert SOLUTION.count(old) == 1
    return SlipSearch(SOLUTION, ASKED).said(function, calls_of(SOLUTION.replace(old, new), function))


@pytest.mark.parametrize(
    ("old", "new", "function", "wanted"),
    [
        ("@ C.T + R", "@ C.T - R", "update", "R went in with the other sign"),
        ("@ C.T + R", "@ C.T", "update", "R were left out (zero)"),
        ("@ C.T + R", "@ C.T + R @ R", "update", "R went in multiplied by itself"),
        ("@ C.T + R", "@ C.T + R / 2", "update", "R counted half"),
        ("@ C.T + R", "@ C.T + np.diag(np.diag(R))", "update", "R went in with its diagonal only"),
        ("(y - C @ mean)", "(C @ mean - y)", "update", "a sign were turned round, in the part with mean"),
        ("mean + gain", "gain", "update", "a term were left out, in the part with mean"),
        ("P - gain @ C @ P", "P - gain @ C", "update", "a factor were left out, in the part with P"),
        ("np.linalg.solve(S, PC).T", "(S @ PC).T", "update", "a matrix stood where its inverse"),
        (
            "np.linalg.solve(S, PC).T",
            "(PC / np.diag(S)[:, None]).T",
            "update",
            "only the diagonal of a matrix",
        ),
        ("np.cos(angles[number])", "np.sin(angles[number])", "turned", "sine and cosine were exchanged"),
        ("np.cos(angles[number])", "np.cos(angles[number - 1])", "turned", "an index were off by one"),
        ("np.cos(angles[number])", "np.cos(np.degrees(angles[number]))", "turned", "angles were in degrees"),
        (
            "np.arctan2(mean[1], mean[0])",
            "np.arctan2(mean[0], mean[1])",
            "turned",
            "the arguments of arctan2 were",
        ),
        ("mean[0] / mean[1]", "mean[0] * mean[1]", "turned", "something multiplied where it divides"),
        ("** 2", "", "turned", "a root were too much or a square missing"),
        ("total[0] += ", "total[0] = ", "turned", "what is to be added up were overwritten"),
        ("in range(len(angles))", "in range(len(angles) - 1)", "turned", "the last of several were left out"),
        ("mean, P = update(", "mean, _ = update(", "run", "one of several answers were not taken over"),
        ("in observations", "in observations[1:]", "run", "the first of several were left out"),
        ("np.linalg.solve(S, PC).T", "np.linalg.solve(S, PC).T / 2", "update", "something counted half (or"),
        ("(y - C @ mean)", "(y - mean[: len(y)])", "update", "a factor were left out, in the part with C"),
        ("cos(angles[number])", "cos(angles[0])", "turned", "the first of several stood for all of them"),
        (
            "cos(angles[number]) * mean[0]",
            "cos(angles[number] * mean[0])",
            "turned",
            "a parenthesis stood in",
        ),
        ("means.append(mean)", "means.insert(0, mean)", "run", "what is new were put in front"),
        ("mean, P = update(", "mean[:], P[:] = update(", "run", "what was kept were overwritten in place"),
        ("means = []", "means = [mean]", "run", "a list had one thing more"),
        (
            "        mean, P = update(mean, P, y, C, R)\n        means.append(mean)\n",
            "        means.append(mean)\n        mean, P = update(mean, P, y, C, R)\n",
            "run",
            "two of its steps stood in the other order",
        ),
    ],
)
def test_a_slip_is_known_by_its_answers(old: str, new: str, function: str, wanted: str) -> None:
    assert said(old, new, function).startswith(wanted)


@pytest.mark.parametrize(
    ("old", "new", "function"),
    [
        ("mean + gain @", "mean + 1.37 * gain @", "update"),
        ("P - gain @ C @ P", "P - gain @ gain.T", "update"),
        ("P - gain @ C @ P", "np.nan * P", "update"),
        ("mean + gain @ (y - C @ mean), P - gain @ C @ P", "0 * mean, 0 * P", "update"),
        ("means.append(mean)", "means.append(mean + y[0])", "run"),
        ("distance < 3 *", "distance > 3 *", "near"),
        ("total = np.zeros(2)", "raise ValueError('no')", "turned"),
        ("total = np.zeros(2)", "total = np.zeros(2) + 0.0", "turned"),
    ],
)
def test_nothing_is_said_of_other_answers(old: str, new: str, function: str) -> None:
    """Loops of which slips have no end are among those looked at here."""
    assert said(old, new, function) == ""


def test_one_call_that_a_slip_does_not_explain_speaks_against_it() -> None:
    calls = calls_of(SOLUTION.replace("@ C.T + R", "@ C.T - R"), "update")
    search = SlipSearch(SOLUTION, ASKED)
    assert search.said("update", calls) == "R went in with the other sign"
    right = calls_of(SOLUTION, "update")
    assert search.said("update", [*calls, *right]) == ""
    assert search.said("update", calls) == "", "what was spoken against once is not said later"


def test_who_is_called_is_to_blame() -> None:
    wrong = SOLUTION.replace("@ C.T + R", "@ C.T - R")
    search = SlipSearch(SOLUTION, ASKED)
    calls = [*calls_of(wrong, "update"), *calls_of(wrong, "run")]
    assert search.others_to_blame("run", calls)
    assert not search.others_to_blame("update", calls)
    assert not search.others_to_blame("run", calls_of(wrong, "run")), "update was never seen alone"


WALKER = """
import numpy as np
from slamcmp.types import Estimate


class Walker:
    SIZE = 3

    def __init__(self, size=SIZE):
        self.T, self.P = np.eye(size), np.eye(size)
        self.way = []

    @staticmethod
    def _step(x, y):
        return np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])

    def update(self, frame):
        if frame.k > 0:
            self._move(frame)
        self.way.append(frame.k)

    def _move(self, frame):
        G = np.eye(3)
        G[0, 2] = frame.x
        G[1, :2] = frame.far[2:]
        self.T = self.T @ self._step(frame.x, frame.y)
        self.P = G @ self.P @ G.T + frame.Q * len(self.way)

    def estimate(self):
        return Estimate(self.T, self.P[:3, :3])
"""


def said_of_walker(old: str, new: str) -> str:
    assert WALKER.count(old) == 1
    asked = Remembering(TrustedImplementation(module(WALKER.replace(old, new))))
    generator = np.random.default_rng(5)
    for _ in range(2):
        walker = asked.construct("Walker", None)
        for k in range(20):
            x, y, *far = generator.normal(size=6)
            frame = SimpleNamespace(k=k, x=x, y=y, far=np.array(far), Q=covariance(generator, 3))
            asked.step(walker, frame)  # type: ignore[arg-type]
    return SlipSearch(WALKER, frozenset({"Walker"})).said_of("Walker", asked.drives)


@pytest.mark.parametrize(
    ("old", "new", "wanted"),
    [
        ("if frame.k > 0:", "if frame.k > 1:", "a number in it were another one"),
        ("G @ self.P @ G.T", "G.T @ self.P @ G.T", "a matrix stood where its transpose belongs"),
        ("+ frame.Q", "- frame.Q", "a sign were turned round"),
        ("* len(self.way)", "", "a factor were left out"),
        (", self.P[:3, :3])", ", np.diag(np.diag(self.P[:3, :3])))", "only a diagonal counted"),
        ("frame.far[2:]", "frame.far[:-2]", "an index counted from the other end"),
        # What no slip does, and what shows in nothing.
        ("+ frame.Q", "+ 1.37 * frame.Q", ""),
        ("self.way.append(frame.k)", "self.way.append(0)", ""),
        ("self.T = self.T @", "self.T = np.nan *", ""),
    ],
)
def test_a_slip_in_a_class_is_known_by_its_drives(old: str, new: str, wanted: str) -> None:
    said = said_of_walker(old, new)
    assert said.startswith(wanted) if wanted else said == ""


PLACES = """
import numpy as np


def places(count):
    out = []
    for k in range(0, count, 2):
        out.append(np.array([k, k * k + 1.0]))
    return out
"""


@pytest.mark.parametrize(
    ("student", "wanted"),
    [
        ("range(0, count - 1, 2)", "there were one step less"),
        ("range(0, count + 1, 2)", "there were one step more"),
        # Not one step more: another step.
        ("range(0, count, 3)", "a number in it were another one"),
    ],
)
def test_a_list_that_is_too_short_or_too_long_tells_its_slip(student: str, wanted: str) -> None:
    asked = Remembering(TrustedImplementation(module(PLACES.replace("range(0, count, 2)", student))))
    for count in range(4, 12):
        asked.call("places", count)
    assert SlipSearch(PLACES, frozenset({"places"})).said("places", asked.answers).startswith(wanted)


@pytest.mark.parametrize("name", sorted(path.parent.name for path in SHIPPED.glob("*/assignment.yaml")))
def test_no_text_names_more_of_the_solution_than_what_the_starter_does(name: str) -> None:
    assignment = load_assignment(find_assignment(name))
    starter = (assignment.folder / "starter.py").read_text()
    asked = frozenset(assignment.fields.functions)
    # One function of each: the rules are the same for all.
    made = list(slips(assignment.solution_source, assignment.fields.functions[1], asked))
    assert len({slip.kind for slip in made}) > 15
    assert {word for slip in made for word in slip.part if word not in starter} == set()
    assert {slip.named for slip in made if slip.named and slip.named.split()[0] not in starter} == set()


@pytest.mark.parametrize(
    ("chosen", "taken"), [(np.array([2, 0]), [5, 9]), (np.array([True, False, True]), [5, 9])]
)
def test_indices_are_sorted_and_masks_are_not(chosen: np.ndarray, taken: list[int]) -> None:
    """A sorted mask takes others, which explained a landmark too many by chance."""
    (change,) = (
        each
        for each in changes_of_part(ast.parse("sights[chosen]", mode="eval").body)  # type: ignore[arg-type]
        if each.kind == SORTED
    )
    code = compile(ast.fix_missing_locations(ast.Expression(change.new)), "slip", "eval")  # type: ignore[arg-type]
    assert eval(code, {"np": np, "sights": np.array([5, 7, 9]), "chosen": chosen}).tolist() == taken
