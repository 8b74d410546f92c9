"""Advice from a program: which back end for this robot?"""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from slamcmp.api.experiments import is_watched
from slamcmp.errors import UsageError
from slamcmp.experiment.config.experiment import Experiment, parse_experiment
from slamcmp.support.configuration.code_source import CodeSource

if TYPE_CHECKING:
    from slamcmp.advice.advice import Advice


def advise(
    problem: str | os.PathLike[str] | Mapping[str, Any] | Experiment,
    *,
    hindsight: bool = False,
    budget_ms: float | None = None,
    memory_mb: float | None = None,
    seeds: int = 20,
    time_limit_s: float = 300.0,
    folder: str | os.PathLike[str] | None = None,
    jobs: int | None = None,
    executor: str = "processes",
    progress: bool | None = None,
) -> Advice:
    """Run a short ladder of back ends on one's own problem and say which to take.

    ``print(advice)`` shows the sentences, a notebook the table as well; ``advice.recommendation`` holds the
    evidence, ``advice.results`` the tables, ``advice.as_dict()`` what ``slamcmp advise --json`` prints.

    >>> import slamcmp
    >>> slamcmp.advise("quickstart", budget_ms=-1)
    Traceback (most recent call last):
    slamcmp.errors.UsageError: advise: budget_ms is a number above 0, not -1

    Args:
        problem: an experiment (file, shipped name, mapping, checked experiment), of which source, front end
            and the settings of back ends are used; or a recording's folder or odometry file.
        hindsight: judge the trajectory afterwards in place of what is known at the time.
        budget_ms: time there is for a frame [ms].
        memory_mb: memory that a run may add [MB].
        seeds: paired trials at most, where the source is seeded.
        time_limit_s: for everything; at least one trial is made.
        folder: where results go; default ``results/NAME-advice``.
        jobs: how many jobs run at a time; default: one for each core. Times are truest with 1.
        executor: where jobs run.
        progress: show progress; default: on a terminal and in a notebook.

    Raises:
        UsageError: the problem or an option cannot be used.
        MissingDataError: a file it needs is not there.
        Interrupted: Ctrl-C, or a notebook's stop button: the same call goes on from there.
    """
    from slamcmp.advice.advise import advise as make_advice

    if isinstance(problem, Mapping):
        # The back ends are the ladder's: a mapping need not name any.
        named = {"name": "advice", "back_ends": ["ekf_slam"], **problem}
        entries = [each if isinstance(each, Mapping) else {"name": each} for each in named["back_ends"]]
        problem = parse_experiment(CodeSource("problem", {**named, "back_ends": entries}), None)
    elif not isinstance(problem, str | os.PathLike | Experiment):
        raise UsageError(
            "advise: a problem is a file, a folder, a shipped name, a mapping or an Experiment, not "
            f"{type(problem).__name__}"
        )
    return make_advice(
        problem if isinstance(problem, Experiment) else os.fspath(problem),
        hindsight=hindsight,
        budget_ms=budget_ms,
        memory_mb=memory_mb,
        seeds=seeds,
        time_limit_s=time_limit_s,
        folder=None if folder is None else os.fspath(folder),
        jobs=jobs,
        executor=executor,
        progress=is_watched() if progress is None else progress,
    )
