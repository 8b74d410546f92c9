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
from slamcmp.experiment.config.checks import Checker
from slamcmp.experiment.config.component import OWN_GATE, Component
from slamcmp.experiment.config.record import Record
from slamcmp.experiment.config.stop_rule import SEEDS_MAX, StopRule
from slamcmp.registry import did_you_mean
from slamcmp.results.judgements.published import Published, check_published, published_keys
from slamcmp.support.configuration.bounds import INTEGER_MAX, unusable_values
from slamcmp.support.configuration.config_errors import ConfigErrors, ConfigSource
from slamcmp.support.configuration.extended_yaml import load_extended
from slamcmp.support.configuration.yaml_source import KeyPath

Seed = Annotated[int, Field(ge=0, le=INTEGER_MAX)]
NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9_.\- ]{0,127}$"
"""A folder is called like it; its files have names as well."""


class ExperimentFields(BaseModel):
    """The keys of an experiment file, before the plug-ins' own parameters are looked at."""

    model_config = ConfigDict(extra="forbid")

    name: str | None = Field(None, pattern=NAME_PATTERN, description="Default: the file's stem")
    question: str = Field("", description="What the experiment answers, in one sentence")
    description: str = ""
    source: dict[str, Any] = Field(
        description="Where the log comes from: name and parameters; a list in place of a file or folder "
        "names recordings, which are then the paired samples"
    )
    front_end: dict[str, Any] = Field(
        default={"name": "labelled"}, description="What turns the log into the stream every back end gets"
    )
    back_ends: list[dict[str, Any]] = Field(
        min_length=1, description="The estimators: name, optional label and own_gate, parameters"
    )
    reference: str | None = Field(
        None, description="Label whose final solution plays truth where the log has none"
    )
    seeds: Annotated[int, Field(ge=1, le=SEEDS_MAX)] | Annotated[list[Seed], Field(min_length=1)] = Field(
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
        None, gt=0, le=1e9, description="Memory one job may take; default: its share of the machine's"
    )
    record: Record | None = Field(None, description="What to record besides; runs that record tell no times")
    figures: list[str] | None = Field(None, description="Names of figures; default: all that apply")
    columns: list[str] | None = Field(
        None, min_length=1, description="Metric columns of the tables, in this order; default: the usual ones"
    )
    published: Published | None = Field(
        None, description="Numbers from a publication; the results are shown beside them, with a verdict"
    )


@dataclass(frozen=True)
class Experiment:
    """A checked experiment."""

    name: str
    source: Component
    front_end: Component
    back_ends: tuple[Component, ...]
    seeds: tuple[int | None, ...] = (0,)
    """(None,) for a source that takes no seed; with ``until`` only the first batch."""
    recordings: tuple[Mapping[str, str], ...] = ()
    """Of several recordings, which are the paired samples, the source's parameters that name each one."""
    until: StopRule | None = None
    sweep: Mapping[str, tuple[Any, ...]] = field(default_factory=dict)
    reference: str | None = None
    time_limit_s: float = 600.0
    stream_time_limit_s: float = 3600.0
    memory_limit_mb: float | None = None
    record: Record | None = None
    figures: tuple[str, ...] | None = None
    columns: tuple[str, ...] | None = None
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
        if self.recordings:
            raise UsageError("the samples are the source's recordings: there are no seeds to choose")
        if self.seeds == (None,):
            raise UsageError(f"source {self.source.name!r} is recorded data: it takes no seed")
        if len(seeds) > SEEDS_MAX or any(not 0 <= seed <= INTEGER_MAX for seed in seeds):
            raise UsageError(f"seeds: at most {SEEDS_MAX}, each from 0 to {INTEGER_MAX}")
        return replace(self, seeds=tuple(seeds), until=None)

    def with_more_seeds(self) -> Experiment:
        """The same with the next batch of seeds, up to the most that ``until`` allows."""
        assert self.until is not None
        count = min(self.until.batch, self.until.max_seeds - len(self.seeds))
        first = 1 + max(seed for seed in self.seeds if seed is not None)
        return replace(self, seeds=(*self.seeds, *range(first, first + count)))

    def as_dict(self) -> dict[str, Any]:
        """Everything as plain JSON values, with the defaults filled in, for the manifest."""

        def choice(chosen: Component) -> dict[str, Any]:
            gate = {} if chosen.own_gate is None else {OWN_GATE: chosen.own_gate}
            return {"name": chosen.name, **dict(chosen.parameters), **gate}

        return {
            "name": self.name,
            "question": self.question,
            "description": self.description,
            "source": choice(self.source)
            | {name: [each[name] for each in self.recordings] for name in next(iter(self.recordings), ())},
            "front_end": choice(self.front_end),
            "back_ends": [{**choice(each), "label": each.label} for each in self.back_ends],
            "reference": self.reference,
            "seeds": list(self.seeds),
            "until": None if self.until is None else self.until.model_dump(),
            "sweep": {path: list(values) for path, values in self.sweep.items()},
            "time_limit_s": self.time_limit_s,
            "stream_time_limit_s": self.stream_time_limit_s,
            "memory_limit_mb": self.memory_limit_mb,
            "record": None if self.record is None else self.record.model_dump(),
            "figures": None if self.figures is None else list(self.figures),
            "columns": None if self.columns is None else list(self.columns),
            "published": None if self.published is None else self.published.model_dump(),
        }


def load_experiment(path: Path | str) -> Experiment:
    """Read and check one experiment file, and those that it extends.

    Raises:
        MissingDataError: there is no such file.
        ConfigError: it has mistakes; the message lists all of them with line and column.
    """
    path = Path(path)
    return parse_experiment(load_extended(path), path)


def parse_experiment(source: ConfigSource, path: Path | None) -> Experiment:
    """Check the content of an experiment file that lies at ``path``, or (None) a program's mapping.

    Relative paths in it start in the file's folder, or in the working directory.

    Raises:
        ConfigError: it has mistakes; the message lists all of them with their places.
    """
    errors = ConfigErrors(source)
    for place, what in unusable_values(source.data):
        errors.add(place, what)
    errors.raise_if_any()
    unseeded = source.data.get("seeds") == [None]
    data = {key: value for key, value in source.data.items() if not (unseeded and key == "seeds")}
    try:
        fields = ExperimentFields.model_validate_json(json.dumps(data, default=str), strict=True)
    except ValidationError as error:
        known: dict[KeyPath, Any] = {
            (): ExperimentFields.model_fields,
            ("until",): StopRule.model_fields,
            ("record",): Record.model_fields,
        }
        errors.add_pydantic(error.errors(), (), known | published_keys(error.errors()))
        # The sections that have the right shape are checked all the same: every mistake at once.
        wrong = {details["loc"][0] for details in error.errors()}
        good = {
            key: value
            for key, value in data.items()
            if key in ExperimentFields.model_fields and key not in wrong
        }
        fields = ExperimentFields.model_construct(
            **{
                "source": None,
                "back_ends": [],
                "sweep": {},
                "seeds": 1,
                "until": None,
                "published": None,
                "record": None,
                **good,
            }
        )
    checker = Checker(errors, Path.cwd() if path is None else path.parent)
    chosen_source = checker.choice("source", fields.source, ("source",))
    front_end = checker.choice("front end", fields.front_end, ("front_end",))
    chosen = [
        checker.choice("back end", section, ("back_ends", index))
        for index, section in enumerate(fields.back_ends)
    ]
    checker.labels(chosen)
    checker.sweep(fields.sweep, chosen_source, front_end, chosen)
    checker.fit(chosen_source, front_end)
    until = None if fields.until is None else StopRule.model_validate(fields.until)
    first = fields.seeds if until is None or "seeds" in source.data else until.batch
    seeds = checker.seeds(first, chosen_source)
    if unseeded:
        checker.no_seed(chosen_source)
    checker.require_recordings_alone(seeds, until, fields.sweep)
    checker.trials(fields.sweep, len(seeds), len(chosen))
    if until is not None:
        checker.until(until, seeds, len(chosen))
    labels = [choice.label for choice in chosen if choice is not None]
    if fields.reference is not None and fields.reference not in labels and None not in chosen:
        errors.add(
            ("reference",),
            f"no back end has the label {fields.reference!r}{did_you_mean(fields.reference, labels)}",
        )
    record = None if fields.record is None else Record.model_validate(fields.record)
    if record is not None and None not in chosen:
        checker.record(record, labels)
    if fields.figures is not None:
        checker.figures(fields.figures)
    if fields.columns is not None:
        checker.columns(fields.columns)
    published = None if fields.published is None else Published.model_validate(fields.published)
    if published is not None:
        check_published(errors, published, None if None in chosen else labels, fields.sweep)
    errors.raise_if_any()
    assert chosen_source is not None
    assert front_end is not None
    return Experiment(
        name=fields.name or ("unnamed" if path is None else path.stem),
        source=chosen_source,
        front_end=front_end,
        back_ends=tuple(choice for choice in chosen if choice is not None),
        seeds=seeds,
        recordings=checker.recordings,
        until=until,
        sweep={key: tuple(values) for key, values in fields.sweep.items()},
        reference=fields.reference,
        time_limit_s=fields.time_limit_s,
        stream_time_limit_s=fields.stream_time_limit_s,
        memory_limit_mb=fields.memory_limit_mb,
        record=record,
        figures=None if fields.figures is None else tuple(fields.figures),
        columns=None if fields.columns is None else tuple(fields.columns),
        published=published,
        question=fields.question,
        description=fields.description,
        path=None if path is None else path.resolve(),
    )


def grid(experiment: Experiment) -> list[dict[str, Any]]:
    """Every combination of swept values, the last path changing fastest; [{}] without a sweep."""
    paths = list(experiment.sweep)
    return [dict(zip(paths, values, strict=True)) for values in itertools.product(*experiment.sweep.values())]
