"""What may be done otherwise where a function is called."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from slamcmp.grading.run.slips.kinds import (
    DEGREES,
    DIAGONAL,
    DIAGONAL_INVERTED,
    EXCHANGED,
    FACTOR,
    FRONT,
    INVERSE,
    JOINED,
    LEFT_OUT,
    OFF_BY_ONE,
    REVERSED,
    SHUFFLED,
    SQUARED,
    STEP_LESS,
    Change,
)
from slamcmp.grading.run.slips.nodes import call, called, reversed, transpose, transposed, turned_blocks

_MISSING = {
    "wrap": "an angle were not wrapped",
    "inv": INVERSE,
    "inverse": INVERSE,
    "sqrt": SQUARED,
    "abs": "a magnitude were missing",
    "cholesky": "a Cholesky factor were missing",
    "tan": "a tangent were missing",
    "adjoint": "an adjoint were missing",
    "radians": "degrees stood where radians belong",
    "deg2rad": "degrees stood where radians belong",
}
"""What it is to forget a function, by its name."""
_INSTEAD = {
    "sin": (("cos", "sine and cosine were exchanged"),),
    "cos": (("sin", "sine and cosine were exchanged"),),
    "tan": (("sin", "a sine stood where a tangent belongs"),),
    "argmin": (("argmax", "the largest were taken for the smallest"),),
    "argmax": (("argmin", "the smallest were taken for the largest"),),
    "min": (("max", "the largest were taken for the smallest"),),
    "max": (("min", "the smallest were taken for the largest"),),
    "ceil": (("floor", "a number were rounded down and not up"),),
    "floor": (("ceil", "a number were rounded up and not down"),),
    "log1p": (("log", "a logarithm were of another number"),),
    "sum": (
        ("mean", "a mean stood where a sum belongs"),
        ("max", "a largest stood where a sum belongs"),
    ),
    "mean": (("sum", "a sum stood where a mean belongs"),),
    "exp": (("log", "exponential and logarithm were exchanged"),),
    "log": (("exp", "exponential and logarithm were exchanged"),),
}


def changes_of_call(node: ast.Call) -> Iterator[Change]:
    """Of a call that has no starred arguments."""
    name = called(node)
    arguments = node.args
    owner = node.func.value if isinstance(node.func, ast.Attribute) else None
    of_module = isinstance(owner, ast.Name) and owner.id in ("np", "math")
    if len(arguments) == 1 and not node.keywords:
        yield Change(_MISSING.get(name, LEFT_OUT), arguments[0], (arguments[0],))
    for other, text in _INSTEAD.get(name, ()):
        if isinstance(node.func, ast.Attribute):
            instead = ast.Attribute(node.func.value, other, ast.Load())
            yield Change(text, ast.Call(instead, arguments, node.keywords), tuple(arguments))
    if owner is not None and not of_module and not arguments:
        # x.ravel(), x.sum(axis=0) without it.
        yield Change(LEFT_OUT, owner, (owner,))
    if name == "solve" and len(arguments) == 2:
        yield Change(INVERSE, ast.BinOp(arguments[0], ast.MatMult(), arguments[1]), (arguments[0],))
        yield Change(FACTOR, arguments[1], (arguments[0],))
        diagonal = call("np.diag", call("np.diag", arguments[0]))
        yield Change(
            DIAGONAL_INVERTED,
            ast.Call(node.func, [diagonal, arguments[1]], []),
            (arguments[0],),
        )
        entries = ast.BinOp(
            ast.BinOp(ast.Constant(1.0), ast.Div(), arguments[0]), ast.MatMult(), arguments[1]
        )
        yield Change("a matrix were inverted entry by entry", entries, (arguments[0],))
    if name == "inv" and arguments:
        yield Change("a transpose stood where an inverse belongs", transpose(arguments[0]), (arguments[0],))
        yield Change(
            DIAGONAL_INVERTED,
            call("np.linalg.inv", call("np.diag", call("np.diag", arguments[0]))),
            (arguments[0],),
        )
        yield Change(
            "a matrix were inverted entry by entry",
            ast.BinOp(ast.Constant(1.0), ast.Div(), arguments[0]),
            (arguments[0],),
        )
    if name == "arctan2":
        ratio = ast.BinOp(arguments[0], ast.Div(), arguments[1])
        yield Change(
            "an arctangent of one argument stood for arctan2", call("np.arctan", ratio), (arguments[0],)
        )
    if name == "hypot":
        added = ast.BinOp(call("np.abs", arguments[0]), ast.Add(), call("np.abs", arguments[1]))
        yield Change("a root of squares were missing", added, tuple(arguments))
        square = ast.BinOp(node, ast.Pow(), ast.Constant(2))
        yield Change(SQUARED, square, tuple(arguments))
    if name in ("sin", "cos", "tan") and of_module and len(arguments) == 1:
        for turned_angle in ("np.degrees", "np.radians"):
            angle = call(turned_angle, arguments[0])
            yield Change(DEGREES, ast.Call(node.func, [angle], []), (arguments[0],))
    if name == "copy":
        source = owner if owner is not None and not of_module else arguments[0] if arguments else None
        if source is not None:
            nothing = call("np.zeros_like", source)
            yield Change("all were zero that is not written anew", nothing, (source,))
    if name in ("block", "vstack", "hstack", "concatenate") and len(arguments) == 1:
        turned_round = turned_blocks(arguments[0])
        if turned_round is not None:
            yield Change(JOINED, ast.Call(node.func, [turned_round], node.keywords), (arguments[0],))
    if not of_module:
        for number, argument in enumerate(arguments):
            if isinstance(argument, ast.Name | ast.Attribute) and not transposed(argument):
                turned = list(arguments)
                turned[number] = reversed(argument)
                yield Change(REVERSED, ast.Call(node.func, turned, node.keywords), (argument,))
            elif isinstance(argument, ast.Subscript) and isinstance(argument.slice, ast.Tuple):
                flat = list(arguments)
                flat[number] = call("np.diag", call("np.diag", argument))
                yield Change(DIAGONAL, ast.Call(node.func, flat, node.keywords), (argument,))
            elif isinstance(argument, ast.Subscript) and isinstance(argument.slice, ast.Slice):
                for by in (1, -1):
                    turned = list(arguments)
                    turned[number] = call("np.roll", argument, ast.Constant(by), ast.Constant(0))
                    yield Change(SHUFFLED, ast.Call(node.func, turned, node.keywords), (argument,))
    if name == "reshape" and len(arguments) == 2 and owner is not None:
        in_columns = transpose(ast.Call(node.func, arguments[::-1], []))
        yield Change("numbers were put into rows in another order", in_columns, (owner,))
    if name in ("range", "arange") and arguments:
        last = min(1, len(arguments) - 1)
        for text, by in (("there were one step more", 1), (STEP_LESS, -1)):
            ended = list(arguments)
            ended[last] = ast.BinOp(arguments[last], ast.Add(), ast.Constant(by))
            yield Change(text, ast.Call(node.func, ended, []), (arguments[last],))
        if len(arguments) > 1:
            for by in (1, -1):
                ends = [ast.BinOp(each, ast.Add(), ast.Constant(by)) for each in arguments[:2]]
                shifted = ast.Call(node.func, [*ends, *arguments[2:]], [])
                yield Change(OFF_BY_ONE, shifted, tuple(arguments[:2]))
    if name == "append" and owner is not None and len(arguments) == 1:
        insert = ast.Attribute(owner, "insert", ast.Load())
        yield Change(FRONT, ast.Call(insert, [ast.Constant(0), arguments[0]], []), (owner,))
    for number in range(len(arguments) - 1):
        swapped = list(arguments)
        swapped[number : number + 2] = swapped[number + 1], swapped[number]
        what = f"the arguments of {name} were exchanged" if of_module else EXCHANGED
        yield Change(what, ast.Call(node.func, swapped, node.keywords), tuple(arguments[number : number + 2]))
    for number, keyword in enumerate(node.keywords):
        if (
            keyword.arg == "axis"
            and isinstance(keyword.value, ast.Constant)
            and keyword.value.value in (0, 1)
        ):
            other_axis = list(node.keywords)
            other_axis[number] = ast.keyword("axis", ast.Constant(1 - keyword.value.value))
            yield Change(
                "rows and columns were exchanged",
                ast.Call(node.func, arguments, other_axis),
                tuple(arguments),
            )
