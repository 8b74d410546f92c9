"""Slips: the solution with one thing done otherwise, made by rule, for mistakes that nobody has foreseen.

Mutation operators in the manner of King and Offutt (1991, *A Fortran language system for mutation-based
software testing*), chosen by what students do to formulas: a transpose, an inverse, a sign, a term or a
factor missing or too much, arguments or entries exchanged, an index off by one, a square or a root, one
quantity taken for another. Where a function's answers are those of such a slip, everywhere, that is what the
student is told. The text names no more of the solution than what the function is given, which stands in the
starter.
"""

from __future__ import annotations

import ast
import copy
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from types import CodeType

from slamcmp.grading.run.slips.alike import changes_of_alike
from slamcmp.grading.run.slips.blocks import changes_of_local, changes_of_order
from slamcmp.grading.run.slips.kinds import Change
from slamcmp.grading.run.slips.rules import (
    changes_of_entry,
    changes_of_expression,
    changes_of_pairs,
    changes_of_statement,
)

TICK = "_slamcmp_tick"
"""Called once in every step of a loop."""
_NESTED = (ast.FunctionDef, ast.Lambda)
_Definition = ast.FunctionDef | ast.ClassDef
_SIMPLE = (ast.Assign, ast.AugAssign, ast.Return, ast.Expr)
"""Statements without others in them."""


@dataclass(frozen=True)
class Slip:
    """One function or class of the solution, changed in one place."""

    kind: str
    """What was done otherwise, as the end of "Your f answers as if …"."""
    part: tuple[str, ...]
    """What the function is given of which the changed part speaks."""
    named: str
    """What was done to one thing that the function is given; empty: it was none as a whole."""
    changed: str
    """The function that it replaces, or the class whose method it replaces."""
    method: str
    """Of a class, which of its methods; empty: it is a function."""
    code: CodeType
    """The definition of the function or of the method, to be executed in the solution's module."""


def counted(solution: str) -> ast.Module:
    """The solution with a call of ``TICK`` in every loop: what is changed in it may never end."""
    module = ast.parse(solution)
    for node in ast.walk(module):
        if isinstance(node, ast.For | ast.While):
            node.body.insert(0, ast.Expr(ast.Call(ast.Name(TICK, ast.Load()), [], [])))
    return ast.fix_missing_locations(module)


def functions_called(solution: str, function: str) -> frozenset[str]:
    """Other functions of the solution that a function calls, directly or not."""
    defined = {node.name: node for node in ast.parse(solution).body if isinstance(node, ast.FunctionDef)}
    found, waiting = {function}, [function] if function in defined else []
    while waiting:
        more = {name for name in _mentioned(defined[waiting.pop()]) if name in defined} - found
        found |= more
        waiting += more
    return frozenset(found - {function})


def slips(solution: str, function: str, asked: Set[str]) -> Iterator[Slip]:
    """All slips that can show in a function's answers and are its own.

    Args:
        solution: the whole solution.
        function: whose answers are looked at; or the class.
        asked: functions that students write themselves; what is wrong in another of them is no slip of this.
    """
    defined = {node.name: node for node in counted(solution).body if isinstance(node, _Definition)}
    if function not in defined:
        return
    for name in _own(defined, function, asked):
        node = defined[name]
        given = _given_to(node) if name == function else []
        for change, module in _changed_definition(node, given):
            yield Slip(
                change.kind,
                _given_in(change.about, given),
                change.text,
                name,
                module.body[0].name if isinstance(node, ast.ClassDef) else "",  # type: ignore[attr-defined]
                compile(module, f"slip of {name}", "exec"),
            )


def _given_to(node: _Definition) -> list[str]:
    """What a function, or the methods of a class that others call, are given."""
    if isinstance(node, ast.FunctionDef):
        return [each.arg for each in node.args.args]
    called = [each for each in _methods(node) if each.name == "__init__" or not each.name.startswith("_")]
    return list(dict.fromkeys(each.arg for method in called for each in method.args.args[1:]))


def _methods(node: ast.ClassDef) -> list[ast.FunctionDef]:
    return [each for each in node.body if isinstance(each, ast.FunctionDef)]


def _own(defined: Mapping[str, _Definition], function: str, asked: Set[str]) -> list[str]:
    """The function and the helpers that it calls, directly or not; the solution's alone."""
    found, waiting = [function], [function]
    while waiting:
        for each in ast.walk(defined[waiting.pop()]):
            name = each.id if isinstance(each, ast.Name) else ""
            if name in defined and name not in asked and name not in found:
                found.append(name)
                waiting.append(name)
    return found


def _changed_definition(node: _Definition, given: Sequence[str]) -> Iterator[tuple[Change, ast.Module]]:
    """Every change of a function or a method, with a module of that alone; it holds until the next."""
    node = copy.deepcopy(node)
    for function in [node] if isinstance(node, ast.FunctionDef) else _methods(node):
        own = [each.arg for each in function.args.args if each.arg in given]
        # What a method is given as a whole has been told apart by the tests of the functions.
        for change in _changed(function, own, as_given=function is node):
            yield change, ast.Module([function], [])


def _changed(node: ast.FunctionDef, given: Sequence[str], *, as_given: bool = True) -> Iterator[Change]:
    """Every change of a function, which stands in it until the next one is asked for."""
    if ast.get_docstring(node) is not None:
        del node.body[0]
    names = {each.arg for each in node.args.args} | {
        each.id for each in ast.walk(node) if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store)
    }
    names -= {"self"}
    for place, change in _places(node, names, frozenset(given), _siblings(node)):
        before = place.get()
        place.put(ast.fix_missing_locations(change.new))
        yield change
        place.put(before)
    yield from _changed_blocks(node)
    for name in given if as_given else ():
        for change in changes_of_entry(name):
            node.body.insert(0, ast.fix_missing_locations(change.new))  # type: ignore[arg-type]
            yield change
            del node.body[0]


def _changed_blocks(node: ast.FunctionDef) -> Iterator[Change]:
    """Every change of a block of statements: their order, and what was assigned, taken for something else."""
    for holder in ast.walk(node):
        body = getattr(holder, "body", None)
        if not isinstance(body, list):
            continue
        blocks = [Change(kind, ast.Module(new, [])) for kind, new in changes_of_order(body)]
        for number, statement in enumerate(body):
            if isinstance(statement, ast.Assign) and isinstance(statement.targets[0], ast.Tuple):
                targets = statement.targets[0].elts
                assigned = [each.id for each in targets if isinstance(each, ast.Name) and each.id != "_"]
                for change in changes_of_local(assigned, statement.value):
                    behind = [*body[: number + 1], change.new, *body[number + 1 :]]
                    blocks.append(Change(change.kind, ast.Module(behind, []), change.about))
        for block in blocks:
            holder.body = ast.fix_missing_locations(block.new).body  # type: ignore[attr-defined]
            yield block
            holder.body = body  # type: ignore[attr-defined]


def _siblings(node: ast.FunctionDef) -> Mapping[str, frozenset[str]]:
    """Variables that are assigned together, of each of them."""
    found: dict[str, frozenset[str]] = {}
    for statement in ast.walk(node):
        if isinstance(statement, ast.Assign):
            together = frozenset(
                each.id
                for target in statement.targets
                for each in ast.walk(target)
                if isinstance(each, ast.Name)
            )
            for name in together:
                found[name] = found.get(name, frozenset()) | together
    return found


def _given_in(about: Sequence[ast.AST], given: Sequence[str]) -> tuple[str, ...]:
    found = frozenset[str]().union(*(_mentioned(node) for node in about))
    return tuple(name for name in given if name in found)


@dataclass(frozen=True)
class _Place:
    """Where a node hangs in the tree."""

    get: Callable[[], ast.AST]
    put: Callable[[ast.AST], None]


def _places(
    node: ast.AST,
    names: Set[str],
    near: Set[str],
    siblings: Mapping[str, frozenset[str]],
    index: bool = False,
) -> Iterator[tuple[_Place, Change]]:
    """Every place of the tree with what may stand there instead.

    Args:
        node: the tree.
        names: variables of the function.
        near: those among them that may be taken for one another: what the function is given, and what the
            same statement speaks of.
        siblings: variables that were assigned together with a variable.
        index: whether the tree stands between square brackets.
    """
    for field, value in ast.iter_fields(node):
        if field in ("args", "decorator_list", "returns", "annotation") and isinstance(node, _NESTED):
            continue
        holders = value if isinstance(value, list) else [value]
        for number, child in enumerate(holders):
            if not isinstance(child, ast.AST):
                continue
            place = _item(value, number) if isinstance(value, list) else _field(node, field, child)
            inside = index or field == "slice"
            if isinstance(child, ast.expr):
                store = isinstance(getattr(child, "ctx", None), ast.Store)
                if (
                    not store
                    and not isinstance(child, ast.Slice | ast.Starred)
                    and not (isinstance(node, ast.Call) and field == "func")
                ):
                    for change in changes_of_expression(child, node, sorted(names & near), inside):
                        yield place, change
            elif isinstance(child, ast.stmt):
                if _is_tick(child):
                    continue
                for change in changes_of_statement(child):
                    yield place, change
            beside = _mentioned(child) & names if isinstance(child, _SIMPLE) else frozenset()
            if isinstance(child, ast.stmt):
                for change in changes_of_pairs(child, sorted(beside)):
                    yield place, change
            besides = beside.union(*(siblings.get(name, frozenset()) for name in beside))
            if isinstance(child, _SIMPLE):
                for change in changes_of_alike(child):
                    yield place, change
            yield from _places(child, names, near | besides, siblings, inside)


def _is_tick(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Call) and _mentioned(node) == {TICK}


def _mentioned(node: ast.AST) -> frozenset[str]:
    return frozenset(each.id for each in ast.walk(node) if isinstance(each, ast.Name))


def _item(items: list[ast.AST], number: int) -> _Place:
    def put(new: ast.AST) -> None:
        items[number] = new

    return _Place(lambda: items[number], put)


def _field(node: ast.AST, field: str, child: ast.AST) -> _Place:
    return _Place(lambda: child, lambda new: setattr(node, field, new))
