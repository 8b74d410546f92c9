"""What every command has: ``--quiet``, ``--json``, and no escape codes where ``NO_COLOR`` is set.

A command that has a ``--json`` of its own prints its own object. Any other gets one here: ``command``,
``exit_code``, and what it told by :func:`answer`, or else the lines that it would have printed (``output``).
The keys are identifiers that stay.
"""

from __future__ import annotations

import contextlib
import functools
import inspect
import io
import json
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Annotated, Any

import typer

TELLING = frozenset(
    {
        "assignment reference",
        "check",
        "compare",
        "data check",
        "data info",
        "data list",
        "data verify",
        "doctor",
        "list",
        "schema",
        "seeds",
        "stream info",
        "table",
    }
)
"""Commands whose output is what they are asked for: ``--quiet`` leaves it, and takes the notes beside it."""
Quiet = Annotated[bool, typer.Option("--quiet", help="Print nothing but the answer and errors.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print machine-readable results only.")]


@dataclass
class _Asked:
    """How the command that runs is to talk, and what it told."""

    quiet: bool = False
    answer: dict[str, Any] | None = None


_asked = _Asked()


def equip(app: typer.Typer, prefix: str = "") -> None:
    """Give every command of the application, also those in groups, what every command has."""
    for command in app.registered_commands:
        assert command.callback is not None
        own = command.name or command.callback.__name__.replace("_", "-")
        command.callback = _with_habits(command.callback, f"{prefix}{own}")
    for group in app.registered_groups:
        if group.typer_instance is not None:
            names = (group.name, group.typer_instance.info.name)
            own = next(each for each in names if isinstance(each, str))
            equip(group.typer_instance, f"{prefix}{own} ")


def answer(**told: Any) -> None:
    """What ``--json`` prints for the command that runs, by keys that stay."""
    _asked.answer = told


def is_quiet() -> bool:
    """Whether the command that runs was asked to be."""
    return _asked.quiet


def respect_no_color() -> None:
    """Without colours there is no use for any escape code: rich takes the terminal for one that knows none.

    https://no-color.org: whatever the value, unless it is empty.
    """
    if os.environ.get("NO_COLOR"):
        os.environ["TERM"] = "dumb"


def _with_habits(callback: Callable[..., Any], name: str) -> Callable[..., Any]:
    """The command with two more options; Typer reads them from its signature."""
    signature = inspect.signature(callback, eval_str=True)
    of_its_own = any(_is_json(each.annotation) for each in signature.parameters.values())
    keyword = inspect.Parameter.KEYWORD_ONLY
    more = [inspect.Parameter("quiet_", keyword, default=False, annotation=Quiet)]
    if not of_its_own:
        more.append(inspect.Parameter("json_", keyword, default=False, annotation=AsJson))

    @functools.wraps(callback)
    def command(*arguments: Any, quiet_: bool = False, json_: bool = False, **options: Any) -> Any:
        with _asking(quiet=quiet_):
            if json_:
                return _print_json(name, functools.partial(callback, *arguments, **options))
            shown = not quiet_ or name in TELLING or bool(options.get("as_json"))
            with contextlib.nullcontext() if shown else contextlib.redirect_stdout(io.StringIO()):
                return callback(*arguments, **options)

    known = [each.replace(kind=keyword) for each in signature.parameters.values()]
    command.__signature__ = signature.replace(parameters=[*known, *more])  # type: ignore[attr-defined]
    command.__annotations__ = {each.name: each.annotation for each in [*known, *more]}
    return command


def _is_json(annotation: Any) -> bool:
    """Typer keeps an option's first name where a default would stand."""
    about = getattr(annotation, "__metadata__", ())
    return any(
        "--json" in (getattr(each, "default", None), *(getattr(each, "param_decls", None) or ()))
        for each in about
    )


@contextlib.contextmanager
def _asking(*, quiet: bool) -> Iterator[None]:
    _asked.quiet, _asked.answer = quiet, None
    try:
        yield
    finally:
        _asked.quiet, _asked.answer = False, None


def _print_json(name: str, run: Callable[[], Any]) -> None:
    code, said = 0, io.StringIO()
    with contextlib.redirect_stdout(said):
        try:
            run()
        except typer.Exit as ended:
            code = ended.exit_code
    told = {"output": said.getvalue().splitlines()} if _asked.answer is None else _asked.answer
    print(json.dumps({"command": name, "exit_code": code, **told}, default=str))
    if code:
        raise typer.Exit(code)
