"""Pieces of Python's syntax tree."""

from __future__ import annotations

import ast


def negative(node: ast.expr) -> ast.expr:
    return ast.UnaryOp(ast.USub(), node)


def times(factor: float, node: ast.expr) -> ast.expr:
    return ast.BinOp(ast.Constant(factor), ast.Mult(), node)


def transpose(node: ast.expr) -> ast.expr:
    return ast.Attribute(node, "T", ast.Load())


def transposed(node: ast.expr) -> bool:
    return isinstance(node, ast.Attribute) and node.attr == "T"


def reversed(node: ast.expr) -> ast.expr:
    step = ast.Slice(None, None, ast.UnaryOp(ast.USub(), ast.Constant(1)))
    return ast.Subscript(node, step, ast.Load())


def in_order(node: ast.expr) -> ast.expr:
    """Sorted; a mask stays as it is: nobody sorts one, and sorted it picks others by chance."""
    kind = ast.Attribute(call("np.asarray", node), "dtype", ast.Load())
    is_no_mask = ast.Compare(kind, [ast.NotEq()], [ast.Name("bool", ast.Load())])
    return ast.IfExp(is_no_mask, call("np.sort", node), node)


def sliced(node: ast.expr, start: int | None, stop: int | None) -> ast.expr:
    ends = [None if end is None else ast.Constant(end) for end in (start, stop)]
    return ast.Subscript(node, ast.Slice(*ends), ast.Load())


def call(name: str, *arguments: ast.expr) -> ast.expr:
    function: ast.expr
    first, *rest = name.split(".")
    function = ast.Name(first, ast.Load())
    for each in rest:
        function = ast.Attribute(function, each, ast.Load())
    return ast.Call(function, list(arguments), [])


def called(node: ast.Call) -> str:
    if isinstance(node.func, ast.Attribute):
        return node.func.attr
    return node.func.id if isinstance(node.func, ast.Name) else ""


def turned_blocks(node: ast.expr) -> ast.expr | None:
    """A list (of lists) the other way round at every level; None: it is none of at least two."""
    if not isinstance(node, ast.List | ast.Tuple) or len(node.elts) < 2:
        return None
    return type(node)([turned_blocks(each) or each for each in node.elts[::-1]], ast.Load())


def sign_turned(op: ast.operator) -> ast.operator | None:
    if isinstance(op, ast.Add):
        return ast.Sub()
    return ast.Add() if isinstance(op, ast.Sub) else None
