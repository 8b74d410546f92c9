"""What may be done otherwise with the statements of a block, and with what they assign."""

from __future__ import annotations

import ast
import itertools
from collections.abc import Iterator, Sequence

from slamcmp.grading.run.slips.kinds import (
    DEGREES,
    EXCHANGED,
    ONCE,
    SIGN,
    STEPS_ORDER,
    UNDER_CONDITION,
    Change,
)
from slamcmp.grading.run.slips.nodes import call, negative


def changes_of_order(body: Sequence[ast.stmt]) -> Iterator[tuple[str, list[ast.stmt]]]:
    """A block of statements with two of them in the other order, or one in another block."""
    for number, (first, second) in enumerate(itertools.pairwise(body)):
        if isinstance(first, ast.Return) or isinstance(second, ast.Return):
            continue
        before, behind = list(body[:number]), list(body[number + 2 :])
        yield STEPS_ORDER, [*before, second, first, *behind]
        if isinstance(first, ast.If) and not first.orelse:
            rest = [each for each in body[number + 1 :] if not isinstance(each, ast.Return)]
            last = [each for each in body[number + 1 :] if isinstance(each, ast.Return)]
            for moved, left in ((rest[:1], rest[1:]), (rest, [])):
                wider = ast.If(first.test, [*first.body, *moved], [])
                yield UNDER_CONDITION, [*before, wider, *left, *last]
    for number, loop in enumerate(body):
        # The first statement of a loop is its tick.
        if isinstance(loop, ast.For) and len(loop.body) > 2:
            hoisted = ast.For(loop.target, loop.iter, [loop.body[0], *loop.body[2:]], loop.orelse)
            yield ONCE, [*body[:number], loop.body[1], hoisted, *body[number + 1 :]]


def changes_of_local(names: Sequence[str], value: ast.expr) -> Iterator[Change]:
    """Of variables that were assigned, taken for something else from then on: put behind the assignment."""
    for name in names:
        read: ast.expr = ast.Name(name, ast.Load())
        for kind, new in (
            (SIGN, negative(read)),
            (DEGREES, call("np.degrees", read)),
            (DEGREES, call("np.radians", read)),
            ("a magnitude stood where the sign counts", call("np.abs", read)),
        ):
            yield Change(kind, ast.Assign([ast.Name(name, ast.Store())], new), (value,))
    for one, other in itertools.pairwise(names):
        exchanged = ast.Assign(
            [ast.Tuple([ast.Name(one, ast.Store()), ast.Name(other, ast.Store())], ast.Store())],
            ast.Tuple([ast.Name(other, ast.Load()), ast.Name(one, ast.Load())], ast.Load()),
        )
        yield Change(EXCHANGED, exchanged, (value,))


def changes_without_first(node: ast.For, number: str) -> Iterator[Change]:
    """Of a loop that counts: what is done under a condition is not done in its first step."""
    later = ast.Compare(ast.Name(number, ast.Load()), [ast.Gt()], [ast.Constant(0)])
    for place, each in enumerate(node.body):
        if isinstance(each, ast.If):
            both = ast.If(ast.BoolOp(ast.And(), [each.test, later]), each.body, each.orelse)
            body = [*node.body[:place], both, *node.body[place + 1 :]]
            yield Change(
                "the first of several were left out", ast.For(node.target, node.iter, body, node.orelse)
            )
