"""One back end at a time: run it, score it, check it."""

from __future__ import annotations

from typing import Any

from slamcmp.api.plugins import BackEndLike, bound, find_back_end
from slamcmp.api.streams import SourceStream
from slamcmp.errors import UsageError
from slamcmp.experiment.conformance.check import Finding, check_back_end
from slamcmp.experiment.job import run_back_end as one_run
from slamcmp.metrics import score_run
from slamcmp.protocols import BackEnd
from slamcmp.support.configuration.code_source import plain_data
from slamcmp.support.configuration.plugin_models import check_parameters
from slamcmp.types import GroundTruth, MeasurementStream, Problem, Run
from slamcmp.types.html import rows_html


def run_back_end(back_end: BackEndLike, stream: MeasurementStream, /, **parameters: Any) -> Run:
    """Feed a stream to a new back end, in this process, and keep all it says.

    >>> import slamcmp
    >>> stream = slamcmp.make_stream("circle", 3, landmarks=10, steps=20)
    >>> run = slamcmp.run_back_end("isam2", stream, relinearize_skip=1)
    >>> run.status, run.online.T_world_body.shape, run.final is not None
    ('ok', (20, 3, 3), True)
    >>> class Still:
    ...     def __init__(self, problem):
    ...         self.problem = problem
    ...
    ...     def update(self, frame):
    ...         pass
    ...
    ...     def estimate(self):
    ...         return slamcmp.Estimate(self.problem.T_world_body, self.problem.P)
    >>> slamcmp.run_back_end(Still, stream)
    <Run 'Still': ok, 20 of 20 frames>

    What the back end does wrong is the run's ``status`` and ``message``, never an exception; there is no
    limit of time or memory.

    Args:
        back_end: a class, a registered name, or ``file.py:Class``.
        stream: of :func:`make_stream` or a stored one. One of :func:`make_stream` also has the truth that a
            back end like ``ekf_ideal`` asks for.
        parameters: the back end's own; ``slamcmp list back-ends NAME`` shows them.

    Raises:
        UsageError: there is no such back end, a parameter is wrong, or it needs a truth that is not there.
    """
    if not isinstance(stream, MeasurementStream):
        raise UsageError(f"run_back_end: a measurement stream is needed, not {type(stream).__name__}")
    plugin = find_back_end(back_end)
    arguments = bound(plugin, parameters)
    told: list[GroundTruth] = []
    if plugin.traits.get("needs_truth"):
        truth = stream.truth if isinstance(stream, SourceStream) else None
        if truth is None:
            raise UsageError(f"{plugin.name} needs the truth, and this stream has none")
        told = [truth]

    def make(problem: Problem) -> BackEnd:
        made: BackEnd = plugin.target(problem, *told, **arguments)
        return made

    return one_run.run_back_end(
        make,
        stream,
        label=plugin.name.rpartition(":")[2],
        parameters=check_parameters(plugin, plain_data(parameters)),
        seed=stream.seed if isinstance(stream, SourceStream) else None,
    )


def score(run: Run, truth: GroundTruth | None = None) -> dict[str, float]:
    """Every metric of a run by its column in the trials table; NaN where it does not apply.

    >>> import slamcmp
    >>> stream = slamcmp.make_stream("circle", 3, landmarks=10, steps=20)
    >>> scores = slamcmp.score(slamcmp.run_back_end("ekf_slam", stream), stream.truth)
    >>> 0 < scores["online_ate"] < 1, scores["final_ate"]
    (True, nan)

    Without a truth only costs and the back end's own residuals are known. Units: docs/formats.md.

    Raises:
        UsageError: what is given is not a run, or not a truth.
        DataError: the truth does not belong to the run's stream.
    """
    if not isinstance(run, Run):
        raise UsageError(f"score: a Run is needed, not {type(run).__name__}")
    if truth is not None and not isinstance(truth, GroundTruth):
        hint = "; its truth is stream.truth" if isinstance(truth, MeasurementStream) else ""
        raise UsageError(f"score: truth is a GroundTruth, not {type(truth).__name__}{hint}")
    return score_run(run, truth)


def check(back_end: BackEndLike, /, **parameters: Any) -> Findings:
    """Whether a back end does what every back end must; each finding names the likely cause of its fault.

    >>> import slamcmp
    >>> class Mute:
    ...     def __init__(self, problem):
    ...         pass
    ...
    ...     def update(self, frame):
    ...         pass
    >>> slamcmp.check(Mute)
    FAIL is constructed as Name(problem, **parameters): has no method estimate
    >>> slamcmp.check(Mute).passed
    False

    Args:
        back_end: a class, a registered name, or ``file.py:Class``.
        parameters: the back end's own.

    Raises:
        UsageError: there is no such back end, or a parameter is wrong.
    """
    plugin = find_back_end(back_end)
    return Findings(check_back_end(plugin, bound(plugin, parameters)))


class Findings(list[Finding]):
    """What was looked at, in that order."""

    @property
    def passed(self) -> bool:
        """Whether the back end has every property."""
        return all(finding.passed for finding in self)

    def _repr_html_(self) -> str:
        """For notebooks."""
        return rows_html(
            ["", "property", "found"],
            [("ok" if each.passed else "FAIL", each.check, each.message) for each in self],
        )

    def __repr__(self) -> str:
        return "\n".join(
            f"{'ok  ' if finding.passed else 'FAIL'} {finding.check}: {finding.message}" for finding in self
        )
