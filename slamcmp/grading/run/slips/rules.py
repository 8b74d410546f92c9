"""What may be done otherwise in one place of a formula: the rules by which slips are made."""

from __future__ import annotations

import ast
import copy
import itertools
from collections.abc import Iterator, Sequence

from slamcmp.grading.run.slips.blocks import changes_without_first
from slamcmp.grading.run.slips.calls import changes_of_call
from slamcmp.grading.run.slips.kinds import (
    ANOTHER,
    BY_ENTRY,
    CONDITION,
    CONDITION_TURNED,
    CONSTANT,
    DEGREES,
    DIAGONAL,
    EXCHANGED,
    FACTOR,
    FACTOR_MORE,
    FACTOR_TWICE,
    HALF,
    IN_PLACE,
    INDEX,
    INVERSE,
    LEFT_OUT,
    NOT_EMPTY,
    OFF_BY_ONE,
    ORDER,
    OUTPUTS,
    REVERSED,
    ROOT,
    SIGN,
    SORTED,
    SQUARED,
    TERM,
    TERM_MORE,
    TRANSPOSE,
    TWICE,
    Change,
)
from slamcmp.grading.run.slips.nodes import (
    call,
    called,
    in_order,
    negative,
    reversed,
    sign_turned,
    sliced,
    times,
    transpose,
    transposed,
)
from slamcmp.grading.run.slips.pieces import (
    changes_of_comprehension,
    changes_of_pairs_in,
    changes_of_parentheses,
    changes_of_part,
)


def changes_of_expression(
    node: ast.expr, parent: ast.AST, names: Sequence[str], index: bool
) -> Iterator[Change]:
    """Of an expression that is read.

    Args:
        node: the expression.
        parent: what it stands in.
        names: variables of the function.
        index: whether it stands between square brackets.
    """
    match node:
        case ast.BinOp():
            yield from _of_operation(node)
        case ast.UnaryOp(op=ast.USub()):
            yield Change(SIGN, node.operand, (node.operand,))
        case ast.Subscript() if not index:
            yield from changes_of_part(node)
        case ast.ListComp() | ast.GeneratorExp() if len(node.generators) == 1:
            yield from changes_of_comprehension(node)
        case ast.Attribute(attr="T"):
            yield Change(TRANSPOSE, node.value, (node.value,))
            yield Change(
                "an inverse stood where a transpose belongs",
                call("np.linalg.inv", node.value),
                (node.value,),
            )
        case ast.Call() if not any(isinstance(each, ast.Starred) for each in node.args):
            yield from changes_of_call(node)
        case ast.Compare(ops=[op], comparators=[right]):
            yield from _of_comparison(node.left, op, right)
        case ast.Constant(value=value) if isinstance(value, int | float) and not isinstance(value, bool):
            yield from _of_number(value, index)
        case ast.Name():
            # A list that is put into itself has no end.
            kept = isinstance(parent, ast.Call) and called(parent) in ("append", "extend", "insert")
            yield from _of_name(node, [] if kept else names, index)
        case ast.List(elts=[]) if isinstance(parent, ast.Assign | ast.Tuple) and not index:
            for name in names:
                yield Change(NOT_EMPTY, ast.List([ast.Name(name, ast.Load())], ast.Load()), (node,))
        case ast.List(elts=[_]) if not index:
            yield Change(TWICE, ast.BinOp(node, ast.Mult(), ast.Constant(2)), (node,))
        case ast.List() | ast.Tuple() if len(node.elts) > 1:
            if not index:
                yield from changes_of_pairs_in(node)
            text = (
                OUTPUTS
                if isinstance(parent, ast.Return)
                else "rows and columns were exchanged"
                if index
                else EXCHANGED
            )
            for number in range(len(node.elts) - 1):
                elements = list(node.elts)
                elements[number : number + 2] = elements[number + 1], elements[number]
                yield Change(text, type(node)(elements, ast.Load()), tuple(node.elts[number : number + 2]))
    if not index and not isinstance(node, ast.Constant | ast.UnaryOp | ast.List | ast.Tuple):
        yield Change(SIGN, negative(node), (node,))
    if isinstance(parent, ast.Assign | ast.Return | ast.Tuple) and not index:
        yield from _as_a_whole(node)
    if isinstance(parent, ast.BinOp) and isinstance(parent.op, ast.MatMult) and not transposed(node):
        yield Change(TRANSPOSE, transpose(node), (node,))
        yield Change(INVERSE, call("np.linalg.inv", node), (node,))
    if isinstance(parent, ast.If | ast.IfExp) and parent.test is node:
        yield Change("a condition were always met", ast.Constant(True), (node,))
        yield Change("a condition were never met", ast.Constant(False), (node,))
        yield Change(CONDITION_TURNED, ast.UnaryOp(ast.Not(), node), (node,))
    if isinstance(parent, ast.For) and parent.iter is node and not _is_unread(parent.target):
        yield Change("only the first of several counted", sliced(call("list", node), None, 1), (node,))
        yield Change("the first of several were left out", sliced(call("list", node), 1, None), (node,))
        yield Change("the last of several were left out", sliced(call("list", node), None, -1), (node,))


def changes_of_statement(node: ast.stmt) -> Iterator[Change]:
    """Of a statement as a whole."""
    match node:
        case ast.AugAssign():
            flipped = sign_turned(node.op)
            if flipped is not None:
                yield Change(SIGN, ast.AugAssign(node.target, flipped, node.value), (node.value,))
                alone = negative(node.value) if isinstance(node.op, ast.Sub) else node.value
                yield Change(
                    "what is to be added up were overwritten",
                    ast.Assign([node.target], alone),
                    (node.value,),
                )
            yield Change(TERM, ast.Pass(), (node.value,))
            twice, half = times(2.0, node.value), times(0.5, node.value)
            yield Change(TWICE, ast.AugAssign(node.target, node.op, twice), (node.value,))
            yield Change(HALF, ast.AugAssign(node.target, node.op, half), (node.value,))
        case ast.Assign(targets=[ast.Subscript() as target]):
            yield Change("a part of the result were left as it was", ast.Pass(), (target, node.value))
            there = ast.Subscript(target.value, target.slice, ast.Load())
            added = ast.BinOp(there, ast.Add(), node.value)
            yield Change(
                "something were added where it is to be put",
                ast.Assign([target], added),
                (target, node.value),
            )
        case ast.Assign(targets=[ast.Tuple(elts=several)], value=value) if isinstance(value, ast.Call):
            for number, unread in enumerate(several):
                others = [*several[:number], ast.Name("_", ast.Store()), *several[number + 1 :]]
                fewer = ast.Assign([ast.Tuple(others, ast.Store())], value)
                yield Change("one of several answers were not taken over", fewer, (unread,))
            if all(isinstance(each, ast.Name | ast.Attribute) for each in several):
                parts: list[ast.expr] = [
                    ast.Subscript(copy.deepcopy(each), ast.Slice(), ast.Store()) for each in several
                ]
                for part in parts:
                    part.value.ctx = ast.Load()  # type: ignore[attr-defined]
                yield Change(IN_PLACE, ast.Assign([ast.Tuple(parts, ast.Store())], value), tuple(several))
        case ast.For(target=ast.Tuple(elts=[ast.Name(id=number), *_]), iter=ast.Call() as counting) if (
            called(counting) == "enumerate"
        ):
            yield from changes_without_first(node, number)
        case ast.Assign(targets=[ast.Name(id=name)], value=value) if _reads(value, name):
            yield Change(LEFT_OUT, ast.Pass(), (value,))


def changes_of_pairs(node: ast.stmt, names: Sequence[str]) -> Iterator[Change]:
    """Of a statement in which two variables have changed their places."""
    for first, second in itertools.combinations(names, 2):
        exchanged = copy.deepcopy(node)
        for each in ast.walk(exchanged):
            if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Load) and each.id in (first, second):
                each.id = second if each.id == first else first
        yield Change(EXCHANGED, exchanged, (ast.Name(first), ast.Name(second)))


def changes_of_entry(name: str) -> Iterator[Change]:
    """Of what a function is given, taken for something else all through."""
    given: ast.expr = ast.Name(name, ast.Load())
    array = call("np.asarray", given)
    for kind, text, new in (
        (TRANSPOSE, "stood where its transpose belongs", transpose(array)),
        (INVERSE, "stood where its inverse belongs, or the other way round", call("np.linalg.inv", given)),
        (SIGN, "went in with the other sign", negative(array)),
        (SQUARED, "went in multiplied by itself", ast.BinOp(given, ast.MatMult(), given)),
        (SQUARED, "went in squared", ast.BinOp(array, ast.Pow(), ast.Constant(2))),
        (ROOT, "went in as its root", call("np.sqrt", call("np.abs", given))),
        (DIAGONAL, "went in with its diagonal only", call("np.diag", call("np.diag", given))),
        (
            "something stood for its complement",
            "went in as 1 minus itself",
            ast.BinOp(ast.Constant(1), ast.Sub(), array),
        ),
        (TERM, "were left out (zero)", times(0.0, array)),
        (FACTOR, "were left out (the identity)", call("np.eye", call("len", given))),
        (TWICE, "counted twice", times(2.0, array)),
        (HALF, "counted half", times(0.5, array)),
        (DEGREES, "were in degrees", call("np.degrees", given)),
        (DEGREES, "were turned into radians once more", call("np.radians", given)),
        (REVERSED, "came in the reverse order", reversed(given)),
        (SORTED, "were sorted", in_order(given)),
    ):
        yield Change(kind, ast.Assign([ast.Name(name, ast.Store())], new), text=f"{name} {text}")


def _of_operation(node: ast.BinOp) -> Iterator[Change]:
    left, right = node.left, node.right
    yield from changes_of_parentheses(node)
    match node.op:
        case ast.Add() | ast.Sub():
            flipped = sign_turned(node.op)
            assert flipped is not None
            yield Change(SIGN, ast.BinOp(left, flipped, right), (right,))
            yield Change(SIGN, ast.BinOp(right, ast.Sub(), left), (left,))
            if not any(isinstance(each, ast.Constant) for each in (left, right)):
                yield Change(
                    "a product stood where a sum belongs", ast.BinOp(left, ast.Mult(), right), (left,)
                )
            yield Change(TERM, left, (right,))
            yield Change(TERM, right, (left,))
            yield Change(TERM, negative(right), (left,))
            for text, factor in ((TWICE, 2.0), (HALF, 0.5)):
                yield Change(text, ast.BinOp(left, node.op, times(factor, right)), (right,))
                yield Change(text, ast.BinOp(times(factor, left), node.op, right), (left,))
        case ast.MatMult():
            yield Change(BY_ENTRY, ast.BinOp(left, ast.Mult(), right), (left, right))
            yield Change(BY_ENTRY, ast.BinOp(_by_entry(left), ast.Mult(), _by_entry(right)), (left, right))
            yield Change(ORDER, ast.BinOp(right, ast.MatMult(), left), (left, right))
            yield Change(FACTOR, left, (right,))
            yield Change(FACTOR, right, (left,))
            as_long = ast.Subscript(right, ast.Slice(None, call("len", left)), ast.Load())
            yield Change(FACTOR, as_long, (left,))
        case ast.Mult() | ast.Div():
            other = ast.Div() if isinstance(node.op, ast.Mult) else ast.Mult()
            how = (
                "something divided where it multiplies"
                if isinstance(node.op, ast.Mult)
                else "something multiplied where it divides"
            )
            yield Change(how, ast.BinOp(left, other, right), (right,))
            yield Change(FACTOR, left, (right,))
            yield Change(FACTOR, right, (left,))
            yield Change(FACTOR_TWICE, ast.BinOp(node, node.op, right), (right,))
        case ast.Pow():
            yield Change(
                ROOT if isinstance(right, ast.Constant) and right.value == 2 else "a power were missing",
                left,
                (left,),
            )
            yield Change(
                "a factor stood where an exponent belongs", ast.BinOp(left, ast.Mult(), right), (left,)
            )
        case ast.BitAnd() | ast.BitOr():
            yield Change(CONDITION, left, (right,))
            yield Change(CONDITION, right, (left,))


def _of_comparison(left: ast.expr, op: ast.cmpop, right: ast.expr) -> Iterator[Change]:
    edge = "a comparison were wrong at its edge (< for ≤)"
    turned = CONDITION_TURNED
    others: dict[type[ast.cmpop], tuple[tuple[str, ast.cmpop], ...]] = {
        ast.Lt: ((edge, ast.LtE()), (turned, ast.Gt())),
        ast.LtE: ((edge, ast.Lt()), (turned, ast.Gt())),
        ast.Gt: ((edge, ast.GtE()), (turned, ast.Lt())),
        ast.GtE: ((edge, ast.Gt()), (turned, ast.Lt())),
        ast.Eq: ((turned, ast.NotEq()),),
        ast.NotEq: ((turned, ast.Eq()),),
    }
    for text, other in others.get(type(op), ()):
        yield Change(text, ast.Compare(left, [other], [right]), (left, right))


def _of_number(value: float, index: bool) -> Iterator[Change]:
    if index:
        for by in (1, -1, 2, -2):
            yield Change(OFF_BY_ONE if abs(by) == 1 else INDEX, ast.Constant(value + by))
    else:
        for other in sorted({value + 1, value - 1, 0, 2 * value, value / 2} - {value}):
            yield Change(CONSTANT, ast.Constant(other))


def _of_name(node: ast.Name, names: Sequence[str], index: bool) -> Iterator[Change]:
    if node.id.isupper() and node.id not in names:
        # A number that the module names.
        for by in (1, -1):
            yield Change(CONSTANT, ast.BinOp(node, ast.Add(), ast.Constant(by)))
    for name in names if node.id in names else ():
        if name != node.id:
            other = ast.Name(name, ast.Load())
            yield Change(ANOTHER, other, (node, other))
            if not index:
                for factors in (
                    ast.BinOp(node, ast.Mult(), other),
                    ast.BinOp(node, ast.MatMult(), other),
                    ast.BinOp(other, ast.MatMult(), node),
                ):
                    yield Change(FACTOR_MORE, factors, (node, other))
                yield Change(TERM_MORE, ast.BinOp(node, ast.Add(), other), (node, other))
    if index:
        for by in (1, -1):
            yield Change(OFF_BY_ONE, ast.BinOp(node, ast.Add(), ast.Constant(by)), (node,))
    else:
        yield Change(DIAGONAL, call("np.diag", call("np.diag", node)), (node,))
        yield Change(ROOT, call("np.sqrt", call("np.abs", node)), (node,))
        yield Change(SQUARED, ast.BinOp(node, ast.Pow(), ast.Constant(2)), (node,))


def _as_a_whole(node: ast.expr) -> Iterator[Change]:
    """Of a value that is kept or returned."""
    array = call("np.asarray", node)
    if not transposed(node):
        yield Change(TRANSPOSE, transpose(array), (node,))
    yield Change(INVERSE, call("np.linalg.inv", node), (node,))
    yield Change(DIAGONAL, call("np.diag", call("np.diag", node)), (node,))
    yield Change(TWICE, times(2.0, array), (node,))
    yield Change(HALF, times(0.5, array), (node,))
    yield Change(DEGREES, call("np.degrees", node), (node,))
    yield Change("an angle were wrapped that is not to be", call("wrap", node), (node,))


def _by_entry(node: ast.expr) -> ast.expr:
    """With * for @ in all of it that is a product."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult):
        return ast.BinOp(_by_entry(node.left), ast.Mult(), _by_entry(node.right))
    return node


def _is_unread(target: ast.expr) -> bool:
    """Whether a loop only counts: then it does not matter which of its steps is left out."""
    return isinstance(target, ast.Name) and target.id == "_"


def _reads(node: ast.expr, name: str) -> bool:
    return any(isinstance(each, ast.Name) and each.id == name for each in ast.walk(node))
