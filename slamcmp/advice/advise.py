"""From a problem to advice: a first trial, as many more as the time allows, then the same a little otherwise.

Underneath are ordinary experiments: the ladder in the results folder, each variation in a folder of its own
below it, with the runner's keys. What is there is reused, Ctrl-C keeps what is done, and the same command
goes on from there. The first trial says what a trial costs; a back end that does not finish it in its share
of the time is named, and not tried again.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from slamcmp.advice.advice import Advice, Asked, WhatIf
from slamcmp.advice.ladder import LONG, ODOMETRY, Rung, ladder, rungs, window
from slamcmp.advice.problem import load_problem
from slamcmp.advice.sentences import write_sentences
from slamcmp.advice.variations import Variation, variations
from slamcmp.errors import SlamcmpError, UsageError
from slamcmp.experiment.config.experiment import Experiment
from slamcmp.experiment.config.stop_rule import SEEDS_MAX
from slamcmp.experiment.runner import run_experiment
from slamcmp.results.answers.candidates import FEWEST_RUNS
from slamcmp.results.answers.recommendation import Recommendation, recommend
from slamcmp.results.store import Results, finite
from slamcmp.support.cores import available_cores
from slamcmp.support.files.atomic import write_atomically

SEEDS = 20
TIME_LIMIT_S = 300.0
SHARE_OF_ONE = 8
"""One back end on one trial may take the whole time divided by this."""
LEFT_FOR_WINDOWS = 0.5
"""Of the time: with one trial only, for which each may take all of it, windows begin with so much left."""
FOR_WINDOWS = 0.25
"""Share of the time that windows of other lengths than 10 may need."""
FOR_LADDER = 0.6
"""Share of the time that the ladder may use; the rest is for variations."""
VARIED_SEEDS = 8
"""Of a variation, at most: it asks only whether the answer changes."""
WINDOWS = (5, 10, 20)
FILE = "advice.json"


class Stopped(SlamcmpError):
    """Ctrl-C between two of the experiments: what finished is kept."""

    exit_code = 130


@dataclass
class _Clock:
    """What is left of the time for all."""

    limit_s: float
    begin: float = field(default_factory=time.monotonic)

    def left(self, share: float = 1.0) -> float:
        return self.limit_s * share - (time.monotonic() - self.begin)


@dataclass(frozen=True)
class _Running:
    """How experiments are run."""

    folder: Path
    jobs: int | None
    executor: str
    progress: bool
    command: str

    def run(self, experiment: Experiment, below: str = "") -> Results:
        try:
            return run_experiment(
                experiment,
                folder=self.folder / below,
                jobs=self.jobs,
                executor=self.executor,
                progress=self.progress,
                command=self.command,
            )
        except KeyboardInterrupt as error:
            raise Stopped(
                f"interrupted: what finished is in {self.folder}; the same command goes on from there"
            ) from error


def advise(
    config: str | Path | Experiment,
    *,
    hindsight: bool = False,
    budget_ms: float | None = None,
    memory_mb: float | None = None,
    seeds: int = SEEDS,
    time_limit_s: float = TIME_LIMIT_S,
    settings: Sequence[str] = (),
    folder: Path | str | None = None,
    jobs: int | None = None,
    executor: str = "processes",
    progress: bool = False,
    command: str = "slamcmp.advise",
) -> Advice:
    """Run the ladder on a problem and say which back end to take, and what would change that.

    Args:
        config: as in :func:`slamcmp.advice.problem.load_problem`, or a checked experiment.
        hindsight: judge the final trajectories in place of what is known at the time.
        budget_ms: time a frame [ms] that there is.
        memory_mb: that a run may add.
        seeds: paired trials at most, where the source is seeded.
        time_limit_s: for everything; at least one trial is made.
        settings: ``source.range_sigma_m=0.1``, in place of what the file says.
        folder: where results go; default ``results/NAME-advice``.
        jobs: how many jobs run at a time; default: one for each core. Times are truest with 1.
        executor: where jobs run.
        progress: show progress on standard error.
        command: for the manifests.

    Raises:
        UsageError: the configuration or an option cannot be used.
        MissingDataError: a file is not there.
        Interrupted: Ctrl-C; the same call goes on from there.
    """
    _check(budget_ms, memory_mb, seeds, time_limit_s)
    problem = config if isinstance(config, Experiment) else load_problem(config, settings)
    place = Path("results") / f"{problem.name}-advice" if folder is None else Path(folder)
    running = _Running(place, jobs, executor, progress, command)
    asked = Asked("final" if hindsight else "online", budget_ms, memory_mb, seeds, time_limit_s)
    clock = _Clock(time_limit_s)
    wanted = _samples(problem, seeds)
    results, chosen, dropped, cost_s = _climb(wanted, running, clock)
    found = _recommend(results, asked)
    what_ifs, untried = _vary(problem, chosen, results, running, clock, asked, cost_s)
    advice = Advice(
        name=problem.name,
        folder=place.resolve(),
        asked=asked,
        jobs=jobs or available_cores(),
        results=results,
        recommendation=found,
        dropped=dropped,
        what_ifs=tuple(what_ifs),
        untried=tuple(untried),
        varied=bool(variations(problem)),
        notes=tuple(_notes(problem)),
    )
    advice = replace(advice, sentences=tuple(write_sentences(advice)))
    text = json.dumps(finite(advice.as_dict()), indent=2, default=str)
    write_atomically(advice.folder / FILE, lambda file: file.write(text.encode("utf-8", "replace")))
    return advice


def _check(budget_ms: float | None, memory_mb: float | None, seeds: int, time_limit_s: float) -> None:
    for name, value in (("budget_ms", budget_ms), ("memory_mb", memory_mb), ("time_limit_s", time_limit_s)):
        if value is not None and not 0.0 < value < math.inf:
            raise UsageError(f"advise: {name} is a number above 0, not {value!r}")
    if type(seeds) is not int or not 1 <= seeds <= SEEDS_MAX:
        raise UsageError(f"advise: seeds is a whole number from 1 to {SEEDS_MAX}, not {seeds!r}")


def _samples(problem: Experiment, seeds: int) -> list[Experiment]:
    """The problem with 1, 2, … of its paired samples: seeds, or recordings."""
    if problem.recordings:
        return [
            replace(problem, recordings=problem.recordings[:n]) for n in range(1, len(problem.recordings) + 1)
        ]
    if problem.seeds == (None,):
        return [replace(problem, seeds=(None,))]
    first = list(dict.fromkeys(seed for seed in problem.seeds if seed is not None))[:seeds]
    more = iter(range(max(first) + 1, max(first) + 1 + seeds))
    every = [*first, *(next(more) for _ in range(seeds - len(first)))]
    return [replace(problem, seeds=tuple(every[:n])) for n in range(1, seeds + 1)]


def _climb(
    samples: Sequence[Experiment], running: _Running, clock: _Clock
) -> tuple[Results, list[Rung], dict[str, str], float]:
    """The ladder on as many samples as the time allows.

    Returns:
        The results, the rungs in them, why others are not, and what one sample costs [s].
    """
    total = len(samples)
    limit_s = _limit_s(clock.limit_s, total)

    def run(n: int, chosen: Sequence[Rung]) -> Results:
        return running.run(ladder(samples[n - 1], chosen, time_limit_s=limit_s))

    frames = run(1, rungs()[:1]).trials["frames"]
    long = bool((frames > LONG).any())
    begin = time.monotonic()
    first: Sequence[int] = (10,)
    if total == 1:
        # Smoothers first: without truth all are held against them.
        results = run(1, rungs(windows=(), long=long))
        first = (10,) if clock.left() > LEFT_FOR_WINDOWS * clock.limit_s else ()
    results = run(1, rungs(windows=first, long=long))
    cost_s = time.monotonic() - begin
    dropped = {
        str(row["label"]): f"timed out on the first trial ({row['message']})"
        for row in results.trials.to_dict("records")
        if row["status"] == "timed_out"
    }
    if not first:
        dropped[window(10)] = "was not tried: there was no time left (--time-limit-s)"
    affordable = 3 * total * _run_s(results, window(10)) < FOR_WINDOWS * clock.limit_s
    lengths = WINDOWS if affordable else first
    chosen = [rung for rung in rungs(windows=lengths, long=long) if rung.label not in dropped]
    done = 1
    while (more := _next_count(done, total, clock, cost_s)) > done:
        begin = time.monotonic()
        results = run(more, chosen)
        cost_s = (time.monotonic() - begin) / (more - done)
        done = more
    if {str(label) for label in results.trials["label"]} != {rung.label for rung in chosen}:
        results = run(done, chosen)
    return results, chosen, dropped, cost_s


def _limit_s(time_limit_s: float, samples: int) -> float:
    """Of one back end on one trial."""
    return max(1.0, time_limit_s / (SHARE_OF_ONE if samples > 1 else 1))


def _next_count(done: int, total: int, clock: _Clock, cost_s: float) -> int:
    """How many samples the next round shall have in all; ``done`` where the time is up."""
    each = max(cost_s, 1e-3)
    count = min(total, 3 * done, done + int(clock.left(FOR_LADDER) / each))
    if count < FEWEST_RUNS:
        # With fewer there is nothing to say at all: for them the variations' time is taken too.
        count = max(count, min(total, FEWEST_RUNS, done + int(clock.left() / each)))
    return max(count, done)


def _run_s(results: Results, label: str) -> float:
    """How long the runs of a back end took [s]; infinite where one did not end well."""
    own = results.trials[results.trials["label"] == label]
    if own.empty or (own["status"] != "ok").any():
        return math.inf
    return float(own[["update_s", "estimate_s", "final_s"]].sum(axis=1).max())


def _recommend(results: Results, asked: Asked) -> Recommendation:
    names = None if asked.which == "final" else [rung.label for rung in rungs(windows=WINDOWS) if rung.online]
    return recommend(
        results, which=asked.which, names=names, budget_ms=asked.budget_ms, memory_mb=asked.memory_mb
    )


def _vary(
    problem: Experiment,
    chosen: Sequence[Rung],
    results: Results,
    running: _Running,
    clock: _Clock,
    asked: Asked,
    cost_s: float,
) -> tuple[list[WhatIf], list[str]]:
    """The answer under each variation that there is time for, and the names of those there is none for."""
    found: list[WhatIf] = []
    untried: list[str] = []
    used = results.trials["trial"].nunique()
    if used < FEWEST_RUNS:
        return [], [each.name for each in variations(problem)]
    taken = [rung for rung in chosen if (asked.which == "final" or rung.online) and rung.label != ODOMETRY]
    for each in variations(problem):
        count = min(used, VARIED_SEEDS, int(clock.left() / max(cost_s, 1e-3)))
        if count < FEWEST_RUNS:
            untried.append(each.name)
            continue
        begin = time.monotonic()
        found.append(_tried(each, problem, taken, running, asked, count))
        # The next one costs about as much.
        cost_s = max(cost_s, (time.monotonic() - begin) / count)
    return found, untried


def _tried(
    variation: Variation,
    problem: Experiment,
    taken: Sequence[Rung],
    running: _Running,
    asked: Asked,
    count: int,
) -> WhatIf:
    limit_s = _limit_s(asked.time_limit_s, asked.seeds)
    varied = variation.of(_samples(problem, count)[-1])
    varied = replace(
        ladder(varied, taken, time_limit_s=limit_s), name=f"{problem.name} with {variation.name}"[:128]
    )
    other = running.run(varied, f"what_if/{variation.slug}")
    return WhatIf(variation.name, dict(variation.parameters), other, _recommend(other, asked))


def _notes(problem: Experiment) -> list[str]:
    notes = []
    if problem.sweep:
        notes.append(
            f"The file's sweep ({', '.join(problem.sweep)}) is left out: the advice is for the values that "
            "stand in its sections."
        )
    return notes
