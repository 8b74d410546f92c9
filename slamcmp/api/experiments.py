"""Whole experiments from a program: the same files, the same checks, the same results folder."""

from __future__ import annotations

import hashlib
import json
import os
import sys
import uuid
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from slamcmp.api.plugins import find_back_end, known_elsewhere
from slamcmp.errors import UsageError
from slamcmp.experiment.config.experiment import Experiment, load_experiment, parse_experiment
from slamcmp.experiment.config.shipped import find_experiment
from slamcmp.experiment.gathering.manifest import folder_for_seeds
from slamcmp.experiment.runner import run_experiment
from slamcmp.registry import SESSION, Plugin, back_ends, in_session
from slamcmp.results.store import Results, find_results
from slamcmp.results.store import load_results as read_results
from slamcmp.support.configuration.code_source import CodeSource, plain_data

ExperimentLike = str | os.PathLike[str] | Mapping[str, Any] | Experiment


def run(
    experiment: ExperimentLike,
    *,
    folder: str | os.PathLike[str] | None = None,
    jobs: int | None = None,
    seeds: int | Sequence[int] | None = None,
    rerun_failed: bool = False,
    executor: str | None = None,
    progress: bool | None = None,
    cache: bool = True,
    scheduler: str | None = None,
    times: bool = False,
) -> Results:
    """Run an experiment, or what is left of it.

    >>> import slamcmp
    >>> results = slamcmp.run(
    ...     {
    ...         "source": {"name": "circle", "landmarks": 10, "steps": 20},
    ...         "back_ends": ["ekf_slam", "isam2"],
    ...         "seeds": 2,
    ...     },
    ...     progress=False,
    ... )
    >>> results.trials[["label", "seed", "status"]]
          label  seed status
    0  ekf_slam     0     ok
    1     isam2     0     ok
    2  ekf_slam     1     ok
    3     isam2     1     ok

    Args:
        experiment: path of a YAML file, name of a shipped experiment, a checked experiment, or a mapping with
            the keys of a YAML file. In a mapping a back end may also be its mere name or a class, and its
            ``name`` may be a class. A class that only this process has, from a notebook's cell say, runs in
            this process: it has no memory limit, its time limit is only looked at between frames, and it is
            run anew each time. The others run in worker processes and are reused, as ever.
        folder: where results go; default ``results/NAME``, for a mapping without a name one for its content;
            where that has a table of other seeds than ``seeds``, one beside it.
        jobs: how many jobs run at a time; default: one for each core.
        seeds: how many (0, 1, …), or exactly these, in place of the experiment's own.
        rerun_failed: also run again what did not end well.
        executor: where jobs run; default ``processes``, with a class of this process ``session``.
        scheduler: address of the scheduler for executor ``dask``; default: workers on this machine.
        times: when all else is done, run each back end once more, alone, for its times.
        progress: show a line or a bar for each job; default: on a terminal and in a notebook.
        cache: take results of equal key from the cache that all experiments share (``slamcmp cache info``),
            with the times that they took then, and keep new ones there.

    Raises:
        UsageError: the experiment cannot be used; every mistake is told with its place.
        MissingDataError: a file it needs is not there.
        Interrupted: Ctrl-C, or a notebook's stop button: what finished is in the exception's ``results`` and
            in the folder, and the same call goes on from there.
    """
    chosen = None if seeds is None else _checked_seeds(seeds)
    if jobs is not None and (not _is_whole(jobs) or jobs < 1):
        raise UsageError(f"run: jobs is how many run at a time, 1 or more, not {jobs!r}")
    shown = is_watched() if progress is None else progress
    own: dict[str, Plugin] = {}
    if isinstance(experiment, Mapping):
        given, own = _without_objects(experiment)
    with in_session(own):
        if isinstance(experiment, Mapping):
            experiment = parse_experiment(CodeSource("experiment", given), None)
        elif isinstance(experiment, str | os.PathLike):
            experiment = load_experiment(find_experiment(os.fspath(experiment)))
        elif not isinstance(experiment, Experiment):
            raise UsageError(
                "run: an experiment is a file, a shipped name, a mapping or an Experiment, not "
                f"{type(experiment).__name__}"
            )
        if own and executor == "processes":
            raise UsageError(
                f"executor 'processes': {_names(own)} is known to this process only; leave it out"
            )
        if own and shown:
            print(
                f"{_names(own)}: in this process, without a memory limit, and anew each time "
                "(no worker process can import what a notebook's cell or a running program defined)",
                file=sys.stderr,
            )
        default = folder_for_seeds(Path("results") / experiment.name, chosen)
        place = default if folder is None else Path(folder)
        try:
            return run_experiment(
                experiment,
                folder=place,
                jobs=jobs,
                rerun_failed=rerun_failed,
                seeds=chosen,
                executor=executor or (SESSION if own else "processes"),
                progress=shown,
                command="slamcmp.run",
                cache=cache,
                scheduler=scheduler,
                times=times,
            )
        finally:
            # Nobody can ever ask for these again: their keys belong to this call.
            for plugin in own.values():
                for file in place.glob(f"*/*{plugin.traits[SESSION]}*"):
                    file.unlink(missing_ok=True)


def load_results(folder: str | os.PathLike[str]) -> Results:
    """The results of an experiment that has run: its folder, or its name below ``results/``.

    Raises:
        MissingDataError: there are none.
        DataError: they are damaged.
    """
    return read_results(find_results(os.fspath(folder)))


def _checked_seeds(seeds: Any) -> list[int]:
    """What a file's ``seeds:`` allows."""
    given = plain_data(seeds)
    found = list(range(given)) if _is_whole(given) else given
    well = isinstance(found, list) and found and all(_is_whole(seed) and seed >= 0 for seed in found)
    if not well or len(set(found)) < len(found):
        raise UsageError(
            f"run: seeds is a number from 1 on or a list of different seeds from 0 on, not {seeds!r}"
        )
    return [int(seed) for seed in found]


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _without_objects(given: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Plugin]]:
    """The mapping with names in place of classes, and by these names what only this process has."""
    data = dict(given)
    own: dict[str, Plugin] = {}
    entries = data.get("back_ends")
    if isinstance(entries, Sequence) and not isinstance(entries, str):
        sections = []
        for entry in entries:
            section = dict(entry) if isinstance(entry, Mapping) else {"name": entry}
            plugin = _only_here(section.get("name"))
            if plugin is not None:
                section["name"] = f"{SESSION}:{plugin.name}:{len(own)}:{plugin.traits[SESSION]}"
                own[section["name"]] = plugin
            elif callable(section.get("name")):
                section["name"] = find_back_end(section["name"]).name
            sections.append(section)
        data["back_ends"] = sections
    if data.get("name") is None:
        # One folder for one content: what was asked before is found again, what is new disturbs nothing.
        text = json.dumps(plain_data(given), sort_keys=True, default=_name_of)
        data["name"] = f"unnamed-{hashlib.sha256(text.encode()).hexdigest()[:8]}"
    return data, own


def _only_here(name: Any) -> Plugin | None:
    """The plug-in with a mark of its own, where no other process could find it."""
    if isinstance(name, str):
        if name not in back_ends or known_elsewhere(back_ends.get(name)):
            return None
        plugin = back_ends.get(name)
    elif callable(name):
        plugin = find_back_end(name)
        if known_elsewhere(plugin):
            return None
    else:
        return None
    return Plugin(plugin.name, plugin.target, {**plugin.traits, SESSION: uuid.uuid4().hex[:12]})


def _name_of(value: Any) -> str:
    return str(getattr(value, "__qualname__", value))


def _names(own: Mapping[str, Plugin]) -> str:
    return ", ".join(dict.fromkeys(plugin.name for plugin in own.values()))


def is_watched() -> bool:
    """Whether somebody looks: a terminal, or a notebook (whose output is none)."""
    return sys.stderr.isatty() or "ipykernel" in sys.modules
