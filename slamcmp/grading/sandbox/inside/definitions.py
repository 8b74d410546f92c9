"""What of a notebook without marked cells is run: the functions asked for, and all that they need.

Read inside the sandbox and in the process that looks at a source before it is run, so it imports nothing of
ours.
"""

from __future__ import annotations

import ast
import builtins
import symtable
from collections.abc import Iterator, Sequence

_CHANGING = {
    "append",
    "add",
    "clear",
    "extend",
    "fill",
    "insert",
    "pop",
    "remove",
    "setdefault",
    "sort",
    "update",
}
"""Methods that change the object they are called of."""
_PLAIN = (
    *(ast.Assign, ast.AnnAssign, ast.Name, ast.Store, ast.Load, ast.Constant, ast.Lambda),
    *(ast.Tuple, ast.List, ast.Dict, ast.Set, ast.UnaryOp, ast.USub),
)
_Block = (ast.If, ast.Try, ast.With)
_Definition = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
_Import = (ast.Import, ast.ImportFrom)


def definitions(
    body: Sequence[ast.stmt], wanted: Sequence[str] = ()
) -> tuple[list[ast.stmt], list[ast.stmt]]:
    """The statements to run and those left out, each in their order.

    Run is what binds a name that is wanted, and what binds or changes a name that this uses, and so on
    (``I3 = np.eye(3)``, ``try: import numba``). Other definitions and plain constants are run where all that
    they need is there. Exploration is left out, and so are imports that nothing needs.

    Args:
        body: of the module.
        wanted: functions and classes asked for; where none of them is there, all definitions are wanted.
    """
    binds = [_bound(statement) for statement in body]
    kept = [bool(bound & set(wanted)) for bound in binds]
    if not any(kept):
        kept = [_defines(statement) for statement in body]
    kept = [keep or _always(statement) for keep, statement in zip(kept, body, strict=True)]
    needed: set[str] = set()
    new = [index for index, keep in enumerate(kept) if keep]
    while new:
        for index in new:
            kept[index] = True
            needed |= _reads(body[index])
        new = [index for index, bound in enumerate(binds) if not kept[index] and bound & needed]
    there = set(vars(builtins)) | {"__name__", "__file__", "__doc__"}
    for index, statement in enumerate(body):
        if not kept[index] and _harmless(statement):
            kept[index] = _reads(statement, at_once=True) <= there
        if kept[index]:
            there |= binds[index]
    run = [statement for statement, keep in zip(body, kept, strict=True) if keep]
    return run, [statement for statement, keep in zip(body, kept, strict=True) if not keep]


def _defines(statement: ast.stmt) -> bool:
    """Whether it is a function or a class, or a block with one in it (``try: … except ImportError: …``)."""
    if isinstance(statement, _Block) and not _main_guard(statement):
        return any(isinstance(node, _Definition) for node in _own_scope(statement))
    return isinstance(statement, _Definition)


def _always(statement: ast.stmt) -> bool:
    """A docstring is no exploration, and what a star import binds cannot be known."""
    text = isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)
    future = isinstance(statement, ast.ImportFrom) and statement.module == "__future__"
    star = isinstance(statement, ast.ImportFrom) and any(alias.name == "*" for alias in statement.names)
    return text or future or star


def _harmless(statement: ast.stmt) -> bool:
    """Whether it may run though nothing needs it: it neither takes time nor fails."""
    if isinstance(statement, ast.Assign | ast.AnnAssign):
        return all(isinstance(node, _PLAIN) for node in _own_scope(statement))
    return isinstance(statement, _Definition) or type(statement).__name__ == "TypeAlias"


def _main_guard(statement: ast.stmt) -> bool:
    """``if __name__ == "__main__":`` and the like."""
    return isinstance(statement, ast.If) and any(
        isinstance(node, ast.Name) and node.id == "__name__" for node in ast.walk(statement.test)
    )


def _bound(statement: ast.stmt) -> set[str]:
    """Names that a statement binds in the module, or whose objects it changes."""
    if _main_guard(statement):
        return set()
    names: set[str] = set()
    for node in _own_scope(statement):
        if isinstance(node, _Definition):
            names.add(node.name)
        elif isinstance(node, ast.alias):
            names.add((node.asname or node.name).partition(".")[0])
        elif isinstance(node, ast.Name | ast.Attribute | ast.Subscript) and isinstance(node.ctx, ast.Store):
            names |= _base(node)
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
            called = node.value.func
            if isinstance(called, ast.Attribute) and called.attr in _CHANGING:
                names |= _base(called.value)
    return names


def _base(node: ast.expr) -> set[str]:
    while isinstance(node, ast.Attribute | ast.Subscript):
        node = node.value
    return {node.id} if isinstance(node, ast.Name) else set()


def _own_scope(node: ast.AST) -> Iterator[ast.AST]:
    """The node and what is in it, but not what has names of its own: bodies of functions, comprehensions."""
    yield node
    inner = (*_Definition, ast.Lambda, ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)
    if not isinstance(node, inner):
        for child in ast.iter_child_nodes(node):
            yield from _own_scope(child)


def _reads(statement: ast.stmt, *, at_once: bool = False) -> set[str]:
    """Names of the module that it uses, later calls of its functions included unless ``at_once``.

    A function's parameters and local names are none of the module's, whatever else is called like them.
    """
    try:
        table = symtable.symtable(ast.unparse(statement), "cell", "exec")
    except SyntaxError:
        # It will be told when it is run.
        return {node.id for node in ast.walk(statement) if isinstance(node, ast.Name)}
    used = {symbol.get_name() for symbol in table.get_symbols() if symbol.is_referenced()}
    tables = list(table.get_children())
    while tables:
        inner = tables.pop()
        if at_once and inner.get_type() == "function" and inner.get_name() not in _RUN_AT_ONCE:
            continue
        tables += inner.get_children()
        used |= {
            symbol.get_name()
            for symbol in inner.get_symbols()
            if symbol.is_global() and symbol.is_referenced()
        }
    return used


_RUN_AT_ONCE = ("listcomp", "setcomp", "dictcomp", "genexpr")
