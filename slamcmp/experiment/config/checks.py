"""The checks of an experiment file that need the plug-ins' signatures."""

from __future__ import annotations

import inspect
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Gt, Lt
from pydantic import TypeAdapter, ValidationError

from slamcmp.errors import UsageError
from slamcmp.experiment.config import fit
from slamcmp.experiment.config.component import OWN_GATE, REGISTRIES, Component, swept_target
from slamcmp.experiment.config.record import Record
from slamcmp.experiment.config.stop_rule import StopRule
from slamcmp.registry import Plugin, back_ends, did_you_mean, figures
from slamcmp.support.configuration.config_errors import ConfigErrors
from slamcmp.support.configuration.plugin_models import check_parameters, parameter_model
from slamcmp.support.configuration.yaml_source import KeyPath

RUNS_MAX = 1_000_000
"""More than anybody waits for: a grid that was meant otherwise."""
Probability = Annotated[float, Gt(0), Lt(1)]
_PROBABILITY: TypeAdapter[float | None] = TypeAdapter(Probability | None)


class Checker:
    """Collects the mistakes of one file."""

    def __init__(self, errors: ConfigErrors, folder: Path) -> None:
        self._errors = errors
        self._folder = folder
        self.recordings: tuple[Mapping[str, str], ...] = ()
        """Where the source names several, its parameters that name each one."""

    def choice(self, kind: str, section: Mapping[str, Any] | None, path: KeyPath) -> Component | None:
        if section is None:
            # It was no section at all, and is told of.
            return None
        given = dict(section)
        name = given.pop("name", None)
        is_back_end = kind == "back end"
        label = given.pop("label", None) if is_back_end else None
        own_gate = given.pop(OWN_GATE, None) if is_back_end else None
        if not isinstance(name, str):
            what = "key 'name' is missing" if name is None else f"name: a {kind}'s name, not {name!r}"
            self._errors.add(path if name is None else (*path, "name"), what)
            return None
        if label is not None and (not isinstance(label, str) or not label):
            self._errors.add((*path, "label"), f"label: a text that is not empty, not {label!r}")
            return None
        spec = name
        if ".py:" in name:
            file, _, attribute = name.rpartition(":")
            try:
                spec = f"{(self._folder / Path(file).expanduser()).resolve()}:{attribute}"
            except (OSError, ValueError, RuntimeError) as error:
                self._errors.add((*path, "name"), f"name: {file!r} is no path: {error}")
                return None
        try:
            plugin = REGISTRIES[kind].get(spec)
            model = parameter_model(plugin)
        except UsageError as error:
            self._errors.add((*path, "name"), str(error))
            return None
        default_label = plugin.name.rpartition(":")[2]
        if kind == "source":
            self.recordings, given = self._several_recordings(plugin, given, path)
        try:
            parameters = check_parameters(plugin, given)
        except UsageError as error:
            self._errors.add((*path, "name"), str(error))
            return None
        except ValidationError as error:
            reserved = ["name", "label", OWN_GATE] if is_back_end else ["name"]
            known: dict[KeyPath, Any] = {path: [*model.model_fields, *reserved]}
            self._errors.add_pydantic(error.errors(), path, known)
            parameters = {}
        else:
            fit.check_values(self._errors, plugin, parameters, given, path)
        if not self._gate(plugin, own_gate, (*path, OWN_GATE)):
            own_gate = None
        if own_gate is not None:
            default_label += ", own gate"
        return Component(kind, plugin.name, spec, parameters, label or default_label, self._folder, own_gate)

    def _several_recordings(
        self, plugin: Plugin, given: dict[str, Any], path: KeyPath
    ) -> tuple[tuple[Mapping[str, str], ...], dict[str, Any]]:
        """The recordings that lists of files or folders name, and the parameters with the first of them."""
        lists = {
            name: given[name]
            for name in plugin.traits.get("paths", ())
            if isinstance(given.get(name), list) and given[name]
        }
        if not lists:
            return (), given
        first = next(iter(lists))
        for name, values in lists.items():
            for index, value in enumerate(values):
                if not isinstance(value, str):
                    what = f"{name}: the name of a file or folder, not {value!r}"
                    self._errors.add((*path, name, index), what)
                    return (), {**given, **dict.fromkeys(lists, "")}
            if len(values) != len(lists[first]):
                what = (
                    f"{name}: {len(values)} recordings where {first} names {len(lists[first])}; one for each"
                )
                self._errors.add((*path, name), what)
        count = min(len(values) for values in lists.values())
        found = tuple({name: values[index] for name, values in lists.items()} for index in range(count))
        for index, each in enumerate(found):
            if each in found[:index]:
                what = f"{first}: {each[first]} stands twice; a recording is one sample"
                self._errors.add((*path, first, index), what)
        return found, {**given, **found[0]}

    def require_recordings_alone(
        self, seeds: Sequence[int | None], until: StopRule | None, swept: Mapping[str, Any]
    ) -> None:
        """Recordings are the samples: nothing else may be."""
        if not self.recordings:
            return
        if len(seeds) > 1:
            what = "seeds: the source's recordings are the samples; leave seeds out, or name one recording"
            self._errors.add(("seeds",), what)
        if until is not None:
            self._errors.add(
                ("until",), "until: the source's recordings are the samples: there are no more to add"
            )
        for name in self.recordings[0]:
            if f"source.{name}" in swept:
                what = (
                    f"sweep: source.{name} names recordings already; a sweep would make grid points of them"
                )
                self._errors.add(("sweep", f"source.{name}"), what, key=True)

    def _gate(self, plugin: Plugin, value: Any, path: KeyPath) -> bool:
        """Whether the back end can have a gate of its own of this probability."""
        try:
            _PROBABILITY.validate_python(value, strict=True)
        except ValidationError as error:
            self._errors.add_pydantic(error.errors(), path, {})
            return False
        if value is None or _tells_its_covariance(plugin):
            return True
        able = ", ".join(each.name for each in back_ends if _tells_its_covariance(each))
        self._errors.add(
            path,
            f"{OWN_GATE}: back end {plugin.name!r} has no joint_covariance(), which its own gate needs to "
            f"predict innovations; leave {OWN_GATE} out and gate in the front end, or take one of: {able}",
        )
        return False

    def labels(self, chosen: Sequence[Component | None]) -> None:
        first: dict[str, int] = {}
        for index, choice in enumerate(chosen):
            if choice is None:
                continue
            if choice.label in first:
                self._errors.add(
                    ("back_ends", index),
                    f"label {choice.label!r} is taken by back end {first[choice.label] + 1}; "
                    "give one of them another 'label:'",
                )
            first.setdefault(choice.label, index)

    def sweep(
        self,
        swept: Mapping[str, Any],
        source: Component | None,
        front_end: Component | None,
        chosen: Sequence[Component | None],
    ) -> None:
        by_label = {choice.label: choice for choice in chosen if choice is not None}
        sections = {"source": source, "front_end": front_end}
        for path, values in swept.items():
            section, label, parameter = swept_target(path)
            if section == "back_ends":
                target = by_label.get(label)
                if target is None:
                    if None not in chosen:
                        what = f"sweep: no back end has the label {label!r}{did_you_mean(label, by_label)}"
                        self._errors.add(("sweep", path), what, key=True)
                    continue
            elif section in sections and not label:
                target = sections[section]
            else:
                self._errors.add(
                    ("sweep", path),
                    f"sweep: {path!r} is not a path: source.PARAMETER, front_end.PARAMETER or "
                    "back_ends.LABEL.PARAMETER is needed",
                    key=True,
                )
                continue
            if target is not None:
                beside = [other for other in swept if swept_target(other)[:2] == (section, label)]
                self._swept_values(path, parameter, values, target, alone=len(beside) == 1)

    def _swept_values(
        self, path: str, parameter: str, values: Any, target: Component, *, alone: bool
    ) -> None:
        plugin = target.plugin()
        if parameter == OWN_GATE and target.kind == "back end":
            for index, value in enumerate(values):
                self._gate(plugin, value, ("sweep", path, index))
            self._no_value_twice(path, values)
            return
        names = list(parameter_model(plugin).model_fields)
        if parameter not in names:
            what = f"sweep: {target.kind} {target.name!r} has no parameter {parameter!r}"
            self._errors.add(("sweep", path), what + did_you_mean(parameter, names), key=True)
            return
        for index, value in enumerate(values):
            try:
                known = check_parameters(plugin, {**target.parameters, parameter: value})
            except ValidationError as error:
                for details in error.errors():
                    if details["loc"][:1] == (parameter,):
                        renamed = {**details, "loc": ()}
                        self._errors.add_pydantic([renamed], ("sweep", path, index), {})  # type: ignore[list-item]
            else:
                if isinstance(value, str) and isinstance(known[parameter], float):
                    values[index] = value = known[parameter]
                fit.check_swept_value(
                    self._errors, plugin, target.parameters, parameter, value, path, index, alone=alone
                )
        self._no_value_twice(path, values)

    def fit(self, source: Component | None, front_end: Component | None) -> None:
        """Whether the front end can use what the source gives."""
        if source is not None and front_end is not None:
            fit.check_source_and_front_end(self._errors, source, front_end)

    def trials(self, swept: Mapping[str, Sequence[Any]], samples: int, back_ends: int) -> None:
        """Whether the grid can be run at all."""
        runs = math.prod([samples, back_ends, *map(len, swept.values())])
        if runs > RUNS_MAX:
            what = f"sweep: {runs:.3g} runs in all; at most {RUNS_MAX} are allowed"
            self._errors.add(("sweep",) if swept else ("seeds",), what)

    def _no_value_twice(self, path: str, values: Any) -> None:
        seen: set[str] = set()
        for index, value in enumerate(values):
            text = json.dumps(value, default=str)
            if text in seen:
                self._errors.add(("sweep", path, index), f"sweep: {text} stands twice")
            seen.add(text)

    def no_seed(self, source: Component | None) -> None:
        """``seeds: [null]``, as the configuration of recorded data is printed."""
        if source is not None and source.plugin().traits.get("seeded", True):
            self._errors.add(("seeds", 0), f"seeds: source {source.name!r} needs numbers, not null")

    def seeds(self, given: int | list[int], source: Component | None) -> tuple[int | None, ...]:
        seeds = tuple(range(given)) if isinstance(given, int) else tuple(given)
        seen: set[int] = set()
        for index, seed in enumerate(seeds):
            if seed in seen:
                self._errors.add(("seeds", index), f"seeds: {seed} stands twice")
            seen.add(seed)
        if source is not None and not source.plugin().traits.get("seeded", True):
            if len(seeds) > 1:
                self._errors.add(
                    ("seeds",),
                    f"seeds: source {source.name!r} is recorded data: it takes no seed; leave it out",
                )
            return (None,)
        return seeds

    def until(self, rule: StopRule, seeds: Sequence[int | None], back_ends: int) -> None:
        # It loads every metric; most experiments do not need it.
        from slamcmp.metrics import metric_columns
        from slamcmp.metrics.information import KL

        known = metric_columns()
        if rule.metric not in known:
            what = f"until: there is no metric {rule.metric!r}{did_you_mean(rule.metric, known)}"
            self._errors.add(("until", "metric"), what)
        elif rule.metric.startswith(KL):
            what = f"until: {rule.metric!r} is only known when all runs are compared; choose another metric"
            self._errors.add(("until", "metric"), what)
        if seeds == (None,):
            self._errors.add(("until",), "until: the source is recorded data: it has no seeds to add")
        elif rule.max_seeds < len(seeds):
            self._errors.add(
                ("until", "max_seeds"),
                f"until: max_seeds is {rule.max_seeds}, fewer than the {len(seeds)} seeds to begin with",
            )
        if rule.of == "difference" and back_ends < 2:
            self._errors.add(("until", "of"), "until: a difference needs at least two back ends")

    def record(self, record: Record, labels: Sequence[str]) -> None:
        label = record.divergence_from
        if label is not None and label not in labels:
            what = f"record: no back end has the label {label!r}{did_you_mean(label, labels)}"
            self._errors.add(("record", "divergence_from"), what)

    def figures(self, names: Sequence[str]) -> None:
        for index, name in enumerate(names):
            if name not in figures:
                known = did_you_mean(name, figures.names())
                self._errors.add(("figures", index), f"unknown figure {name!r}{known}")

    def columns(self, names: Sequence[str]) -> None:
        from slamcmp.metrics import metric_columns

        known = metric_columns()
        for index, name in enumerate(names):
            if name not in known:
                self._errors.add(("columns", index), f"no metric column {name!r}{did_you_mean(name, known)}")
            elif name in names[:index]:
                self._errors.add(("columns", index), f"{name!r} stands twice")


def _tells_its_covariance(plugin: Plugin) -> bool:
    """What is no class may make anything: it is asked when it has."""
    methods = ("landmarks", "joint_covariance")
    return not inspect.isclass(plugin.target) or all(hasattr(plugin.target, name) for name in methods)
