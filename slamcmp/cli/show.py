"""``slamcmp list``, ``slamcmp schema`` and ``slamcmp doctor``."""

from __future__ import annotations

import inspect
import json
from typing import TYPE_CHECKING, Annotated, Any

import typer

from slamcmp.cli import completion
from slamcmp.cli.kinds import FILES, KINDS
from slamcmp.cli.output import answer
from slamcmp.errors import UsageError
from slamcmp.registry import did_you_mean

if TYPE_CHECKING:
    from slamcmp.registry import Plugin


def add_commands(app: typer.Typer) -> None:
    """Put this file's commands into the application."""
    app.command("list", epilog="Example: slamcmp list back-ends isam2")(list_plugins)
    app.command(epilog="Example: slamcmp schema > experiment.schema.json")(schema)
    app.command(epilog="Example: slamcmp doctor")(doctor)


def list_plugins(
    kind: Annotated[
        str | None,
        typer.Argument(
            help=f"One of {', '.join((*KINDS, *FILES))}; default: all.", autocompletion=completion.kinds
        ),
    ] = None,
    name: Annotated[
        str | None,
        typer.Argument(
            help="A plug-in, to see its parameters; an experiment or assignment, to read it.",
            autocompletion=completion.plugins,
        ),
    ] = None,
) -> None:
    """List what experiments can be made of, or the parameters of one plug-in."""
    if kind is not None and kind not in (*KINDS, *FILES):
        raise UsageError(f"unknown kind {kind!r}{did_you_mean(kind, [*KINDS, *FILES])}")
    if name is not None and kind in KINDS:
        _print_parameters(KINDS[kind].get(name))
        answer(kind=kind, name=name, schema=parameter_schema(KINDS[kind].get(name)))
        return
    if name is not None:
        (_print_assignment if kind == "assignments" else _print_experiment)(name)
        return
    shipped = {"experiments": _experiments, "assignments": _assignments}
    asked = (*KINDS, *FILES) if kind is None else (kind,)
    found = {each: shipped[each]() if each in shipped else _summaries(each) for each in asked}
    answer(**{each: [{"name": name, "summary": text} for name, text in found[each]] for each in asked})
    for each in asked:
        if kind is None:
            print(f"{each}:")
        _print_pairs(found[each], "  " if kind is None else "")


def schema() -> None:
    """Print the JSON Schema of experiment files, with every plug-in's parameters, for editors."""
    from slamcmp.experiment.config.schema import experiment_schema

    schema = experiment_schema()
    answer(schema=schema)
    print(json.dumps(schema, indent=2))


def doctor() -> None:
    """Check that this machine and installation can run experiments."""
    from slamcmp.cli.doctor import examine

    well, findings = True, list(examine())
    answer(findings=[{"what": each.what, "ok": each.ok, "detail": each.detail} for each in findings])
    for finding in findings:
        well = well and finding.ok
        print(f"{'ok  ' if finding.ok else 'FAIL'} {finding.what}: {finding.detail}")
    if not well:
        raise typer.Exit(1)


def parameter_schema(plugin: Plugin) -> dict[str, Any]:
    """JSON Schema of a plug-in's parameters."""
    from slamcmp.support.configuration.plugin_models import parameter_model

    return parameter_model(plugin).model_json_schema()


def _summaries(kind: str) -> list[tuple[str, str]]:
    return [(plugin.name, plugin.summary) for plugin in KINDS[kind]]


def _experiments() -> list[tuple[str, str]]:
    from slamcmp.experiment.config.shipped import shipped_experiments
    from slamcmp.support.configuration.extended_yaml import load_extended

    return [
        (name, str(load_extended(path).data.get("question", "")))
        for name, path in shipped_experiments().items()
    ]


def _assignments() -> list[tuple[str, str]]:
    from slamcmp.grading.assignment.handout import handouts

    return [(name, each.title) for name, each in handouts().items()]


def _print_assignment(name: str) -> None:
    """Its handout.

    Raises:
        MissingDataError: there is no assignment of that name.
    """
    from slamcmp.grading.assignment.handout import find_handout

    print((find_handout(name).folder / "README.md").read_text(encoding="utf-8"), end="")


def _print_experiment(name: str) -> None:
    """Its file as it is: the comments say what the keys mean.

    Raises:
        MissingDataError: there is no experiment of that name.
    """
    from slamcmp.experiment.config.shipped import find_experiment

    path = find_experiment(name)
    print(f"# {path}\n{path.read_text(encoding='utf-8')}", end="")


def _print_pairs(pairs: list[tuple[str, str]], indent: str) -> None:
    width = max((len(name) for name, _ in pairs), default=0)
    for name, text in pairs:
        print(f"{indent}{name:{width}}  {text}".rstrip())


def _print_parameters(plugin: Plugin) -> None:
    print(inspect.getdoc(plugin.target) or plugin.name)
    traits = {
        key: value for key, value in plugin.traits.items() if isinstance(value, str | bool | int | float)
    }
    for key, value in traits.items():
        print(f"{key}: {value}")
    parameters = plugin.parameters()
    if parameters:
        print("\nParameters:")
        docs = plugin.traits.get("parameter_docs", dict)()
        _print_pairs(
            [
                (name, _described(parameter) + (f". {docs[name]}" if name in docs else ""))
                for name, parameter in parameters.items()
            ],
            "  ",
        )


def _described(parameter: inspect.Parameter) -> str:
    """``float, greater than 0, default 8.0``, from the schema that configurations are checked with."""
    from pydantic import TypeAdapter

    empty = inspect.Parameter.empty
    about: dict[str, Any] = {}
    if parameter.annotation is not empty:
        about = TypeAdapter(parameter.annotation).json_schema()
    text = _type_text(about)
    return text + (", required" if parameter.default is empty else f", default {parameter.default!r}")


def _type_text(about: dict[str, Any]) -> str:
    if "anyOf" in about:
        return " or ".join(_type_text(each) for each in about["anyOf"])
    if "enum" in about:
        return "one of " + ", ".join(map(str, about["enum"]))
    bounds = {"exclusiveMinimum": ">", "minimum": ">=", "exclusiveMaximum": "<", "maximum": "<="}
    limits = [f"{sign} {about[key]:g}" for key, sign in bounds.items() if key in about]
    return " ".join([str(about.get("type", "any")), *limits])
