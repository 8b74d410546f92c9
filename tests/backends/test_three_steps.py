"""The course's three steps are the code of every estimator that is this project's own."""

from __future__ import annotations

import ast
import inspect
import textwrap
from typing import Any

import pytest

from slamcmp.registry import back_ends

STEPS = ["construct", "solve", "marginalise"]
NOT_OWN = {
    "dead_reckoning": "estimates nothing",
    "isam2": "gtsam's",
    "batch": "gtsam's",
    "fixed_lag": "gtsam's",
}
ANOTHER_ORDER = {
    # A window of w poses is solved with w poses: its oldest leaves as soon as the new one has come.
    "sliding_window": ["construct", "marginalise", "solve"],
}


def own_estimators() -> list[Any]:
    names = [name for name in back_ends.names() if name not in NOT_OWN]
    return [pytest.param(back_ends.get(name).target, id=name) for name in names]


def calls_in_order(method: Any) -> list[str]:
    """Names of the methods that ``method`` calls on self, in the order in which they are read."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(method)))
    calls = [
        node.func
        for node in ast.walk(tree)
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and isinstance(node.func.value, ast.Name)
        and node.func.value.id == "self"
    ]
    return [call.attr for call in sorted(calls, key=lambda call: (call.lineno, call.col_offset))]


@pytest.mark.parametrize("estimator", own_estimators())
def test_update_reads_construct_solve_marginalise(estimator: Any, request: pytest.FixtureRequest) -> None:
    assert calls_in_order(estimator.update) == ANOTHER_ORDER.get(request.node.callspec.id, STEPS)
    for step in STEPS:
        assert inspect.getdoc(getattr(estimator, step)), f"{step} does not say what it is here"


def test_every_other_back_end_is_excused_by_name() -> None:
    assert set(back_ends.names()) >= set(NOT_OWN)
    for name in NOT_OWN:
        module = inspect.getmodule(back_ends.get(name).target)
        assert module is not None
        assert name == "dead_reckoning" or "gtsam_smoothers" in module.__name__


def test_the_reading_is_of_order_and_not_of_presence() -> None:
    class Muddled:
        def update(self, frame: Any) -> None:
            self.solve(self.construct(frame))
            self.marginalise()

    assert calls_in_order(Muddled.update) == ["solve", "construct", "marginalise"]
