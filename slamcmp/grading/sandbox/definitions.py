"""What of a notebook without marked cells is run: its definitions, and the values they need.

Read inside the sandbox and in the process that looks at a source before it is run, so it imports nothing of
ours.
"""

from __future__ import annotations

import ast


def definitions(body: list[ast.stmt]) -> tuple[list[ast.stmt], list[ast.stmt]]:
    """The statements to run and those left out, each in their order.

    Run are imports, functions, classes and assignments without a call; then, as long as there are more,
    assignments that bind a name which what is run uses (``I3 = np.eye(3)``). Exploration is left out.
    """
    kept = [_defines(statement) for statement in body]
    while True:
        needed = {
            node.id
            for statement, keep in zip(body, kept, strict=True)
            if keep
            for node in ast.walk(statement)
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load)
        }
        more = [
            index for index, statement in enumerate(body) if not kept[index] and _bound(statement) & needed
        ]
        if not more:
            break
        for index in more:
            kept[index] = True
    run = [statement for statement, keep in zip(body, kept, strict=True) if keep]
    return run, [statement for statement, keep in zip(body, kept, strict=True) if not keep]


def _defines(statement: ast.stmt) -> bool:
    if isinstance(statement, (ast.Assign, ast.AnnAssign)):
        return not any(isinstance(node, (ast.Call, ast.Await)) for node in ast.walk(statement))
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.Import, ast.ImportFrom)
    # A docstring is no exploration.
    text = isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)
    return text or isinstance(statement, kinds)


def _bound(statement: ast.stmt) -> set[str]:
    """Names that an assignment binds; nothing for other statements."""
    if not isinstance(statement, (ast.Assign, ast.AnnAssign, ast.AugAssign)):
        return set()
    return {
        node.id
        for node in ast.walk(statement)
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
    }
