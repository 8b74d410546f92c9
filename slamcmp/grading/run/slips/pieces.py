"""What may be done otherwise with pieces of an expression: parentheses, parts of arrays, rows, lists."""

from __future__ import annotations

import ast
import copy
import itertools
from collections.abc import Iterator, Sequence

from slamcmp.grading.run.slips.kinds import (
    EXCHANGED,
    FIRST_FOR_ALL,
    OFF_BY_ONE,
    OTHER_END,
    PARENTHESIS,
    REVERSED,
    SORTED,
    Change,
)
from slamcmp.grading.run.slips.nodes import call, in_order, negative, reversed, sliced


def changes_of_parentheses(node: ast.BinOp) -> Iterator[Change]:
    """(a + b) c for a + b c, f(a) b for f(a b), and the other way round."""
    left, op, right = node.left, node.op, node.right
    product, total = (ast.Mult, ast.Div, ast.MatMult, ast.Pow), (ast.Add, ast.Sub)
    if isinstance(op, product) and isinstance(left, ast.BinOp) and isinstance(left.op, total):
        later = ast.BinOp(left.left, left.op, ast.BinOp(left.right, op, right))
        yield Change(PARENTHESIS, later, (left, right))
    if isinstance(op, product) and isinstance(right, ast.BinOp) and isinstance(right.op, total):
        sooner = ast.BinOp(ast.BinOp(left, op, right.left), right.op, right.right)
        yield Change(PARENTHESIS, sooner, (left, right))
    if isinstance(op, total) and isinstance(right, ast.BinOp) and isinstance(right.op, product):
        together = ast.BinOp(ast.BinOp(left, op, right.left), right.op, right.right)
        yield Change(PARENTHESIS, together, (left, right))
    if isinstance(op, total) and isinstance(left, ast.BinOp) and isinstance(left.op, product):
        together = ast.BinOp(left.left, left.op, ast.BinOp(left.right, op, right))
        yield Change(PARENTHESIS, together, (left, right))
    if isinstance(op, total) and isinstance(right, ast.BinOp) and isinstance(right.op, total):
        yield Change(PARENTHESIS, ast.BinOp(ast.BinOp(left, op, right.left), right.op, right.right), (right,))
    if isinstance(op, ast.Mult) and isinstance(right, ast.Call) and len(right.args) == 1:
        inside = ast.Call(right.func, [ast.BinOp(left, op, right.args[0])], right.keywords)
        yield Change(PARENTHESIS, inside, (left, right))
    if isinstance(left, ast.Call) and len(left.args) == 1:
        inside = ast.Call(left.func, [ast.BinOp(left.args[0], op, right)], left.keywords)
        yield Change(PARENTHESIS, inside, (left, right))
    match left:
        # s * f(a) / b
        case ast.BinOp(left=far, op=ast.Mult() as inner, right=ast.Call(func=func, args=[argument])):
            inside = ast.Call(func, [ast.BinOp(argument, op, right)], [])
            yield Change(PARENTHESIS, ast.BinOp(far, inner, inside), (left, right))


def changes_of_part(node: ast.Subscript) -> Iterator[Change]:
    """Of rows and columns that are taken from something."""
    slices = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
    other_end = [_from_other_end(each) for each in slices]
    if any(each is not None for each in other_end):
        yield Change(
            OTHER_END, _taken(node, [new or old for new, old in zip(other_end, slices, strict=True)])
        )
    for number, each in enumerate(slices):
        moved = list(slices)
        if isinstance(each, ast.Slice) and each.step is None and (each.lower or each.upper):
            for by in (1, -1) if each.lower else (1,):
                lower, upper = (
                    end and ast.BinOp(end, ast.Add(), ast.Constant(by)) for end in (each.lower, each.upper)
                )
                moved[number] = ast.Slice(lower or ast.Constant(by), upper)
                yield Change(OFF_BY_ONE, _taken(node, moved))
        elif isinstance(each, ast.Name):
            moved[number] = ast.Constant(0)
            yield Change(FIRST_FOR_ALL, _taken(node, moved), (node.value,))
            moved[number] = in_order(each)
            yield Change(SORTED, _taken(node, moved), (node.value,))
        elif isinstance(each, ast.Call):
            for by in (1, -1):
                moved[number] = ast.BinOp(each, ast.Add(), ast.Constant(by))
                yield Change(OFF_BY_ONE, _taken(node, moved), (node.value,))


def changes_of_comprehension(node: ast.ListComp | ast.GeneratorExp) -> Iterator[Change]:
    over = node.generators[0]
    several = call("list", over.iter)
    alone = ast.BinOp(sliced(several, None, 1), ast.Mult(), call("len", several))
    first = ast.comprehension(over.target, alone, over.ifs, over.is_async)
    yield Change(FIRST_FOR_ALL, type(node)(node.elt, [first]), (over.iter,))
    back = ast.comprehension(over.target, reversed(several), over.ifs, over.is_async)
    yield Change(REVERSED, type(node)(node.elt, [back]), (over.iter,))


def changes_of_pairs_in(node: ast.List | ast.Tuple) -> Iterator[Change]:
    """Of one row of an array, in which two variables have changed their places."""
    speaks_of = sorted({each.id for each in ast.walk(node) if isinstance(each, ast.Name)} - {"np", "math"})
    if 2 <= len(speaks_of) <= 5:
        for first, second in itertools.combinations(speaks_of, 2):
            yield Change(EXCHANGED, _exchanged(node, first, second), (node,))


def _exchanged(node: ast.expr, first: str, second: str) -> ast.expr:
    new = copy.deepcopy(node)
    for each in ast.walk(new):
        if isinstance(each, ast.Name) and each.id in (first, second):
            each.id = second if each.id == first else first
    return new


def _taken(node: ast.Subscript, slices: Sequence[ast.expr]) -> ast.expr:
    index = ast.Tuple(list(slices), ast.Load()) if isinstance(node.slice, ast.Tuple) else slices[0]
    return ast.Subscript(node.value, index, ast.Load())


def _from_other_end(each: ast.expr) -> ast.expr | None:
    match each:
        case ast.Slice(lower=None, upper=ast.Constant() as end, step=None):
            return ast.Slice(negative(end), None)
        case ast.Slice(lower=ast.Constant() as end, upper=None, step=None):
            return ast.Slice(None, negative(end))
        case ast.Constant(value=0):
            return negative(ast.Constant(1))
        case ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=1)):
            return ast.Constant(0)
    return None
