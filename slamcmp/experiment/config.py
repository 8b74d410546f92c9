"""An experiment's YAML file, checked as a whole: every mistake at once, each with its place."""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from slamcmp.errors import UsageError
from slamcmp.experiment.config_errors import ConfigErrors
from slamcmp.experiment.plugin_models import check_parameters, parameter_model
from slamcmp.experiment.published import Published, check_published, published_keys
from slamcmp.experiment.stop_rule import StopRule
from slamcmp.experiment.yaml_source import KeyPath, YamlSource, load_yaml
from slamcmp.registry import Plugin, Registry, back_ends, did_you_mean, figures, front_ends, sources

Seed = Annotated[int, Field(ge=0)]
NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9_.\- ]*$"


class ExperimentFields(BaseModel):
    """The keys of an experiment file, before the plug-ins' own parameters are looked at."""

    model_config = ConfigDict(extra="forbid")

    name: str | None = Field(None, pattern=NAME_PATTERN, description="Default: the file's stem")
    question: str = Field("", description="What the experiment answers, in one sentence")
    description: str = ""
    source: dict[str, Any] = Field(description="Where the log comes from: name and parameters")
    front_end: dict[str, Any] = Field(
        default={"name": "labelled"}, description="What turns the log into the stream every back end gets"
    )
    back_ends: list[dict[str, Any]] = Field(
        min_length=1, description="The estimators: name, optional label, parameters"
    )
    reference: str | None = Field(
        None, description="Label whose final solution plays truth where the log has none"
    )
    seeds: Annotated[int, Field(ge=1)] | Annotated[list[Seed], Field(min_length=1)] = Field(
        1, description="How many seeds (0, 1, …), or a list of seeds"
    )
    until: StopRule | None = Field(
        None, description="Add seeds in batches until the intervals of a metric are narrow enough"
    )
    sweep: dict[str, Annotated[list[Any], Field(min_length=1)]] = Field(
        default_factory=dict, description="Dotted path of a parameter: list of its values; a grid"
    )
    time_limit_s: float = Field(600.0, gt=0, description="Wall time of one back end on one trial")
    stream_time_limit_s: float = Field(
        3600.0, gt=0, description="Wall time of the source and the front end on one trial"
    )
    memory_limit_mb: float | None = Field(
        None, gt=0, description="Memory one job may take; default: its share of the machine's"
    )
    figures: list[str] | None = Field(None, description="Names of figures; default: all that apply")
    published: Published | None = Field(
        None, description="Numbers from a publication; the results are shown beside them, with a verdict"
    )


@dataclass(frozen=True)
class Choice:
    """A plug-in with all its parameters."""

    kind: str
    """``source``, ``front end`` or ``back end``."""
    name: str
    """As the tables show it: the registered name or ``file.py:Name``."""
    spec: str
    """As the registry finds it: the registered name or ``/absolute/file.py:Name``."""
    parameters: Mapping[str, Any]
    """Every parameter, defaults filled in, as plain JSON values."""
    label: str = ""
    """Of a back end, unique within its experiment."""
    folder: Path | None = None
    """Of the experiment file: its relative paths start there."""

    def plugin(self) -> Plugin:
        """The registered class or function."""
        return REGISTRIES[self.kind].get(self.spec)

    def arguments(self) -> dict[str, Any]:
        """The parameters, with the path of each data file that lies beside the experiment file made absolute.

        :attr:`parameters` keep it as it was written: results say what the user said.
        """
        values = dict(self.parameters)
        for name in self.plugin().traits.get("paths", ()):
            if self.folder is not None and isinstance(values.get(name), str):
                beside = self.folder / Path(values[name]).expanduser()
                if beside.is_file():
                    values[name] = str(beside.resolve())
        return values

    def with_parameter(self, name: str, value: Any) -> Choice:
        """The same with one parameter changed."""
        return replace(self, parameters={**self.parameters, name: value})


REGISTRIES: dict[str, Registry] = {registry.kind: registry for registry in (sources, front_ends, back_ends)}


@dataclass(frozen=True)
class Experiment:
    """A checked experiment."""

    name: str
    source: Choice
    front_end: Choice
    back_ends: tuple[Choice, ...]
    seeds: tuple[int | None, ...] = (0,)
    """(None,) for a source that takes no seed; with ``until`` only the first batch."""
    until: StopRule | None = None
    sweep: Mapping[str, tuple[Any, ...]] = field(default_factory=dict)
    reference: str | None = None
    time_limit_s: float = 600.0
    stream_time_limit_s: float = 3600.0
    memory_limit_mb: float | None = None
    figures: tuple[str, ...] | None = None
    published: Published | None = None
    question: str = ""
    description: str = ""
    path: Path | None = None
    """Of the file, absolute; None for one made in a program."""

    def with_seeds(self, seeds: Sequence[int]) -> Experiment:
        """The same on exactly these seeds.

        Raises:
            UsageError: the source takes no seed.
        """
        if self.seeds == (None,):
            raise UsageError(f"source {self.source.name!r} is recorded data: it takes no seed")
        return replace(self, seeds=tuple(seeds), until=None)

    def with_more_seeds(self) -> Experiment:
        """The same with the next batch of seeds, up to the most that ``until`` allows."""
        assert self.until is not None
        count = min(self.until.batch, self.until.max_seeds - len(self.seeds))
        first = 1 + max(seed for seed in self.seeds if seed is not None)
        return replace(self, seeds=(*self.seeds, *range(first, first + count)))

    def as_dict(self) -> dict[str, Any]:
        """Everything as plain JSON values, with the defaults filled in, for the manifest."""

        def choice(chosen: Choice) -> dict[str, Any]:
            return {"name": chosen.name, **dict(chosen.parameters)}

        return {
            "name": self.name,
            "question": self.question,
            "description": self.description,
            "source": choice(self.source),
            "front_end": choice(self.front_end),
            "back_ends": [{**choice(each), "label": each.label} for each in self.back_ends],
            "reference": self.reference,
            "seeds": list(self.seeds),
            "until": None if self.until is None else self.until.model_dump(),
            "sweep": {path: list(values) for path, values in self.sweep.items()},
            "time_limit_s": self.time_limit_s,
            "stream_time_limit_s": self.stream_time_limit_s,
            "memory_limit_mb": self.memory_limit_mb,
            "figures": None if self.figures is None else list(self.figures),
            "published": None if self.published is None else self.published.model_dump(),
        }


def load_experiment(path: Path | str) -> Experiment:
    """Read and check one experiment file.

    Raises:
        MissingDataError: there is no such file.
        ConfigError: it has mistakes; the message lists all of them with line and column.
    """
    path = Path(path)
    return parse_experiment(load_yaml(path), path)


def parse_experiment(source: YamlSource, path: Path) -> Experiment:
    """Check the content of an experiment file that lies at ``path``."""
    errors = ConfigErrors(source)
    try:
        fields = ExperimentFields.model_validate_json(json.dumps(source.data, default=str), strict=True)
    except ValidationError as error:
        known: dict[KeyPath, Any] = {(): ExperimentFields.model_fields, ("until",): StopRule.model_fields}
        errors.add_pydantic(error.errors(), (), known | published_keys(error.errors()))
        # The sections that have the right shape are checked all the same: every mistake at once.
        wrong = {details["loc"][0] for details in error.errors()}
        good = {
            key: value
            for key, value in source.data.items()
            if key in ExperimentFields.model_fields and key not in wrong
        }
        fields = ExperimentFields.model_construct(
            **{
                "source": {},
                "back_ends": [],
                "sweep": {},
                "seeds": 1,
                "until": None,
                "published": None,
                **good,
            }
        )
    checker = _Checker(errors, path.parent)
    chosen_source = checker.choice("source", fields.source, ("source",))
    front_end = checker.choice("front end", fields.front_end, ("front_end",))
    chosen = [
        checker.choice("back end", section, ("back_ends", index))
        for index, section in enumerate(fields.back_ends)
    ]
    checker.labels(chosen)
    checker.sweep(fields.sweep, chosen_source, front_end, chosen)
    until = None if fields.until is None else StopRule.model_validate(fields.until)
    first = fields.seeds if until is None or "seeds" in source.data else until.batch
    seeds = checker.seeds(first, chosen_source)
    if until is not None:
        checker.until(until, seeds, len(chosen))
    labels = [choice.label for choice in chosen if choice is not None]
    if fields.reference is not None and fields.reference not in labels and None not in chosen:
        errors.add(
            ("reference",),
            f"no back end has the label {fields.reference!r}{did_you_mean(fields.reference, labels)}",
        )
    if fields.figures is not None:
        checker.figures(fields.figures)
    published = None if fields.published is None else Published.model_validate(fields.published)
    if published is not None:
        check_published(errors, published, None if None in chosen else labels, fields.sweep)
    errors.raise_if_any()
    assert chosen_source is not None
    assert front_end is not None
    return Experiment(
        name=fields.name or path.stem,
        source=chosen_source,
        front_end=front_end,
        back_ends=tuple(choice for choice in chosen if choice is not None),
        seeds=seeds,
        until=until,
        sweep={key: tuple(values) for key, values in fields.sweep.items()},
        reference=fields.reference,
        time_limit_s=fields.time_limit_s,
        stream_time_limit_s=fields.stream_time_limit_s,
        memory_limit_mb=fields.memory_limit_mb,
        figures=None if fields.figures is None else tuple(fields.figures),
        published=published,
        question=fields.question,
        description=fields.description,
        path=path.resolve(),
    )


def swept_target(path: str) -> tuple[str, str, str]:
    """``source.x`` → (source, "", x); ``back_ends.LABEL.x`` → (back_ends, LABEL, x)."""
    section, _, rest = path.partition(".")
    label, _, parameter = rest.rpartition(".")
    return section, label, parameter


class _Checker:
    """The checks that need the plug-ins' signatures."""

    def __init__(self, errors: ConfigErrors, folder: Path) -> None:
        self._errors = errors
        self._folder = folder

    def choice(self, kind: str, section: Mapping[str, Any], path: KeyPath) -> Choice | None:
        if not section:
            return None
        given = dict(section)
        name = given.pop("name", None)
        label = given.pop("label", None) if kind == "back end" else None
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
            spec = f"{(self._folder / Path(file).expanduser()).resolve()}:{attribute}"
        try:
            plugin = REGISTRIES[kind].get(spec)
            model = parameter_model(plugin)
        except UsageError as error:
            self._errors.add((*path, "name"), str(error))
            return None
        default_label = name.rpartition(":")[2] if ".py:" in name else name
        try:
            parameters = check_parameters(plugin, given)
        except ValidationError as error:
            reserved = ["name", "label"] if kind == "back end" else ["name"]
            known: dict[KeyPath, Any] = {path: [*model.model_fields, *reserved]}
            self._errors.add_pydantic(error.errors(), path, known)
            parameters = {}
        return Choice(kind, plugin.name, spec, parameters, label or default_label, self._folder)

    def labels(self, chosen: Sequence[Choice | None]) -> None:
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
        source: Choice | None,
        front_end: Choice | None,
        chosen: Sequence[Choice | None],
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
                self._swept_values(path, parameter, values, target)

    def _swept_values(self, path: str, parameter: str, values: Any, target: Choice) -> None:
        plugin = target.plugin()
        names = list(parameter_model(plugin).model_fields)
        if parameter not in names:
            what = f"sweep: {target.kind} {target.name!r} has no parameter {parameter!r}"
            self._errors.add(("sweep", path), what + did_you_mean(parameter, names), key=True)
            return
        for index, value in enumerate(values):
            try:
                check_parameters(plugin, {**target.parameters, parameter: value})
            except ValidationError as error:
                for details in error.errors():
                    if details["loc"][:1] == (parameter,):
                        renamed = {**details, "loc": ()}
                        self._errors.add_pydantic([renamed], ("sweep", path, index), {})  # type: ignore[list-item]
        texts = [json.dumps(value, default=str) for value in values]
        for index, text in enumerate(texts):
            if text in texts[:index]:
                self._errors.add(("sweep", path, index), f"sweep: {text} stands twice")

    def seeds(self, given: int | list[int], source: Choice | None) -> tuple[int | None, ...]:
        seeds = tuple(range(given)) if isinstance(given, int) else tuple(given)
        for index, seed in enumerate(seeds):
            if seed in seeds[:index]:
                self._errors.add(("seeds", index), f"seeds: {seed} stands twice")
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

        known = metric_columns()
        if rule.metric not in known:
            what = f"until: there is no metric {rule.metric!r}{did_you_mean(rule.metric, known)}"
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

    def figures(self, names: Sequence[str]) -> None:
        for index, name in enumerate(names):
            if name not in figures:
                known = did_you_mean(name, figures.names())
                self._errors.add(("figures", index), f"unknown figure {name!r}{known}")


def grid(experiment: Experiment) -> list[dict[str, Any]]:
    """Every combination of swept values, the last path changing fastest; [{}] without a sweep."""
    paths = list(experiment.sweep)
    return [dict(zip(paths, values, strict=True)) for values in itertools.product(*experiment.sweep.values())]
