"""The back ends that are tried, from odometry alone up to full smoothing.

What the user has set for a back end of the same name (a kernel, ``forget_after``) stays set, and a gate of
their own that all of the user's back ends have, all of these have too.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from slamcmp.experiment.config.component import Component
from slamcmp.experiment.config.experiment import Experiment, parse_experiment
from slamcmp.support.configuration.code_source import CodeSource

ODOMETRY = "dead reckoning"
EKF = "EKF"
INVARIANT = "right-invariant EKF"
ITERATED = "iterated EKF"
INCREMENTAL = "iSAM2"
BATCH = "batch"
SMOOTHED = {EKF: "EKF + RTS", INVARIANT: "right-invariant EKF + RTS"}
"""Filters by the label of the same filter with its smoother."""
LONG = 1500
"""Frames from where on iSAM2 looks for variables to relinearise every tenth frame only."""
_STEPS = {"iterations": 5, "tolerance": 1e-4}
_SHARED = ("robust", "robust_width")
"""What is the problem's, not the back end's: set for one, it is set for all that know it."""


def window(poses: int) -> str:
    """The label of a sliding window."""
    return f"window of {poses}"


@dataclass(frozen=True)
class Rung:
    """One back end of the ladder."""

    label: str
    name: str
    parameters: Mapping[str, Any]
    online: bool = True
    """Whether its online estimate is its own, and no other rung's."""


def rungs(*, windows: Sequence[int] = (10,), long: bool = False) -> list[Rung]:
    """In the order in which they run.

    Args:
        windows: lengths of the sliding windows.
        long: the log has more than :data:`LONG` frames.
    """
    converged: dict[str, Any] = {"relinearize_skip": 10}
    if not long:
        converged = {"relinearize_skip": 1, "relinearize_threshold": 0.01, "extra_updates": 1}
    return [
        Rung(ODOMETRY, "dead_reckoning", {}),
        Rung(EKF, "ekf_slam", {}),
        Rung(INVARIANT, "ekf_right_invariant", {"smooth": False}),
        Rung(ITERATED, "iterated_ekf", {**_STEPS, "smooth": False}),
        Rung(SMOOTHED[EKF], "ekf_world", {"smooth": True}, online=False),
        Rung(SMOOTHED[INVARIANT], "ekf_right_invariant", {"smooth": True}, online=False),
        Rung(INCREMENTAL, "isam2", converged),
        # Before the windows: where there is no truth, all are held against it.
        Rung(BATCH, "batch", {}, online=False),
        *(
            Rung(window(w), "sliding_window", {"window": w, "linearisation": "latest", **_STEPS})
            for w in windows
        ),
    ]


def ladder(problem: Experiment, chosen: Iterable[Rung], *, time_limit_s: float) -> Experiment:
    """The user's problem with these back ends in place of his own.

    The batch solution plays truth where the log has none. Everything that asks for another experiment (a
    sweep, a stop rule, records, published numbers) is left out.
    """
    taken = list(chosen)
    return replace(
        problem,
        back_ends=tuple(_component(rung, problem.back_ends) for rung in taken),
        reference=BATCH if any(rung.label == BATCH for rung in taken) else None,
        time_limit_s=min(problem.time_limit_s, time_limit_s),
        sweep={},
        until=None,
        record=None,
        published=None,
        figures=None,
    )


def _component(rung: Rung, own: Sequence[Component]) -> Component:
    """A rung with the user's settings of it."""
    checked = parse_experiment(
        CodeSource(
            "ladder",
            {
                "source": {"name": "circle"},
                "back_ends": [{"name": rung.name, "label": rung.label, **rung.parameters}],
            },
        ),
        None,
    ).back_ends[0]
    same = next((each for each in own if each.name == rung.name), None)
    known = dict(checked.parameters)
    kept = {} if same is None else {name: same.parameters[name] for name in known if name in same.parameters}
    for each in own:
        shared = {
            name: each.parameters[name] for name in _SHARED if name in each.parameters and name in known
        }
        if each.parameters.get("robust", "none") != "none":
            kept |= shared
    gates = {each.own_gate for each in own}
    gate = next(iter(gates)) if len(gates) == 1 else None
    return replace(checked, parameters={**known, **kept, **rung.parameters}, own_gate=gate)
