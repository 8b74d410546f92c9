"""What may be done otherwise in all places of a statement that are written alike."""

from __future__ import annotations

import ast
import copy
from collections.abc import Callable, Iterator

from slamcmp.grading.run.slips.kinds import DEGREES, FACTOR, LEFT_OUT, ROOT, SIGN, SQUARED, TERM, Change
from slamcmp.grading.run.slips.nodes import call, called, negative, sign_turned


def changes_of_alike(node: ast.stmt) -> Iterator[Change]:
    """Of a statement in which all that is written alike is changed alike."""
    alike: dict[str, list[ast.expr]] = {}
    for each in ast.walk(node):
        if isinstance(each, ast.BinOp | ast.Call | ast.Subscript | ast.Name | ast.UnaryOp) and not isinstance(
            getattr(each, "ctx", None), ast.Store
        ):
            alike.setdefault(ast.dump(each), []).append(each)
    signs = _Signs()
    turned = signs.visit(copy.deepcopy(node))
    if signs.count > 1:
        yield Change(SIGN, turned, (node,))
    for kind, change in _ANGLES_INSTEAD:
        angles = _Angles(change)
        turned = angles.visit(copy.deepcopy(node))
        if angles.count > 1:
            yield Change(kind, turned, (node,))
    called_names = {id(each.func) for each in ast.walk(node) if isinstance(each, ast.Call)}
    for written, places in alike.items():
        first = places[0]
        if len(places) < 2 or any(id(each) in called_names for each in places):
            continue
        for kind, new in _alike_instead(first):
            yield Change(kind, _Instead(written, new).visit(copy.deepcopy(node)), (first,))


def _alike_instead(node: ast.expr) -> Iterator[tuple[str, ast.expr]]:
    yield SIGN, negative(node)
    match node:
        case ast.Name():
            yield DEGREES, call("np.degrees", node)
            yield DEGREES, call("np.radians", node)
            yield ROOT, call("np.sqrt", call("np.abs", node))
            yield SQUARED, ast.BinOp(node, ast.Pow(), ast.Constant(2))
        case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=2)):
            yield ROOT, left
        case ast.BinOp(left=left, op=op, right=right) if not isinstance(op, ast.Pow):
            yield (TERM if isinstance(op, ast.Add | ast.Sub) else FACTOR), left
            yield (TERM if isinstance(op, ast.Add | ast.Sub) else FACTOR), right
        case ast.Call() if len(node.args) == 1 and not node.keywords:
            yield LEFT_OUT, node.args[0]


_ANGLES_INSTEAD: tuple[tuple[str, Callable[[ast.expr], ast.expr]], ...] = (
    (DEGREES, lambda angle: call("np.degrees", angle)),
    (DEGREES, lambda angle: call("np.radians", angle)),
    (SIGN, negative),
)
"""What every angle of a statement may be taken for."""


class _Angles(ast.NodeTransformer):
    """Changes what every sine and cosine is taken of."""

    def __init__(self, change: Callable[[ast.expr], ast.expr]) -> None:
        self._change, self.count = change, 0

    def visit_Call(self, node: ast.Call) -> ast.AST:
        self.generic_visit(node)
        if called(node) in ("sin", "cos") and len(node.args) == 1:
            self.count += 1
            return ast.Call(node.func, [self._change(node.args[0])], [])
        return node


class _Signs(ast.NodeTransformer):
    """Adds what is subtracted, and the other way round, everywhere."""

    count = 0

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        self.generic_visit(node)
        flipped = sign_turned(node.op)
        if flipped is None:
            return node
        self.count += 1
        return ast.BinOp(node.left, flipped, node.right)

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        # Indices have no signs.
        return node


class _Instead(ast.NodeTransformer):
    """Puts something else in the place of all that is written alike."""

    def __init__(self, written: str, new: ast.expr) -> None:
        self._written, self._new = written, new

    def visit(self, node: ast.AST) -> ast.AST:
        if isinstance(node, ast.expr) and ast.dump(node) == self._written:
            return copy.deepcopy(self._new)
        return self.generic_visit(node)
