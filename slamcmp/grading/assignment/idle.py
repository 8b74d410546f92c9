"""Submissions that do no work, made from an assignment's solution: what they earn is a hole in its tests.

========  =====================================================================================
name      every function and method of the solution …
========  =====================================================================================
echo      gives back its own arguments, as many and of such shapes as are asked for where it can
nan       gives the solution's answer with NaN for every number
zeros     gives the solution's answer with 0 for every number
nothing   returns None
========  =====================================================================================
"""

from __future__ import annotations

import ast

from slamcmp.grading.assignment.description import Assignment

_FILLED = """
import numpy as _np

def _filled(answer, value):
    if isinstance(answer, (list, tuple)):
        return type(answer)(_filled(each, value) for each in answer)
    if isinstance(answer, dict):
        return {{key: _filled(each, value) for key, each in answer.items()}}
    if hasattr(answer, "__dataclass_fields__") or answer is None or isinstance(answer, str):
        return answer
    return _np.full_like(_np.asarray(answer, dtype=float), value)

def _echoed(answer, arguments):
    arguments = [each for each in arguments if not hasattr(each, "__dict__")]
    if isinstance(answer, (list, tuple)):
        return type(answer)(_echoed(each, arguments) for each in answer)
    shape = _np.shape(answer)
    alike = [each for each in arguments if _np.shape(each) == shape]
    wide = [each for each in arguments if _np.ndim(each) == len(shape)]
    nearest = alike or sorted(wide, key=lambda each: -sum(a == b for a, b in zip(_np.shape(each), shape)))
    if not nearest:
        return _np.zeros(shape)
    same = _np.zeros(shape)
    corner = tuple(slice(0, min(a, b)) for a, b in zip(shape, _np.shape(nearest[0])))
    same[corner] = _np.asarray(nearest[0], dtype=float)[corner]
    return same

def _instead(function):
    def idle(*arguments, **named):
        return {instead}
    return idle

for _name in {functions!r}:
    globals()[_name] = _instead(globals()[_name])
for _name in {classes!r}:
    for _method in ("update",):
        setattr(globals()[_name], _method, lambda self, frame: None)
"""


def idle_submissions(assignment: Assignment) -> dict[str, str]:
    """Sources by name; classes keep their start and take in no frame."""
    asked = set(assignment.fields.functions)
    body = ast.parse(assignment.solution_source).body
    functions = [node.name for node in body if isinstance(node, ast.FunctionDef) and node.name in asked]
    classes = [node.name for node in body if isinstance(node, ast.ClassDef) and node.name in asked]
    answers = {
        "echo": "_echoed(function(*arguments, **named), arguments)",
        "nan": "_filled(function(*arguments, **named), _np.nan)",
        "zeros": "_filled(function(*arguments, **named), 0.0)",
        "nothing": "None",
    }
    return {
        name: assignment.solution_source
        + _FILLED.format(instead=instead, functions=functions, classes=classes)
        for name, instead in answers.items()
    }
