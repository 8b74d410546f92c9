"""Looks at a back end while it runs, for what the experiment's ``record:`` asks for.

Every ``every``-th frame each back end is asked what its own linear system claims (where it can tell), and for
its whole posterior of pose and map, which is later compared with a batch solution's at the same frame.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

import numpy as np

from slamcmp.backends.unanchored import Linearisation
from slamcmp.errors import DivergedError
from slamcmp.experiment.config.record import Record
from slamcmp.metrics.information import landmark_drift, pose_drift
from slamcmp.metrics.observability import DRIFTS, NULLITY, SHIFT, TURN, nullity, unanchored_information
from slamcmp.protocols import BackEnd, JointEstimator
from slamcmp.results.runs.posteriors import Posterior
from slamcmp.types import Estimate, FloatArray

JOINT_DIM_MAX = 1500
"""States above which no posterior is kept: 18 MB each."""


@runtime_checkable
class SelfLinearising(Protocol):
    """A back end that can tell what its own linear system claims."""

    def record_linearisation(self) -> None:
        """Begin, before the first frame."""

    def linearisation(self) -> Linearisation:
        """About the last frame."""


class Recorder:
    """Looks at one back end while it runs.

    Args:
        record: what to record.
        frames: of the stream.
    """

    def __init__(self, record: Record, frames: int) -> None:
        self._record, self._last = record, frames - 1
        self.posteriors: list[Posterior] = []

    def begin(self, back_end: BackEnd) -> BackEnd:
        """The back end, recording if it can."""
        if self._record.observability and isinstance(back_end, SelfLinearising):
            back_end.record_linearisation()
        return back_end

    def after_frame(self, k: int, back_end: BackEnd, answer: Estimate) -> Mapping[str, float]:
        """Series of frame k; keeps the posterior if it will be compared."""
        if (k + 1) % self._record.every and k != self._last:
            return {}
        if self._record.divergence_from is not None and isinstance(back_end, JointEstimator):
            self._keep(k, back_end, answer)
        if self._record.observability and isinstance(back_end, SelfLinearising):
            return series_of(back_end.linearisation(), answer.T_world_body)
        return {}

    def _keep(self, k: int, back_end: Any, answer: Estimate) -> None:
        try:
            landmarks = back_end.landmarks()
            if answer.P.shape[0] + landmarks.positions.size > JOINT_DIM_MAX:
                return
            joint = np.array(back_end.joint_covariance())
        except DivergedError:
            # A batch solver that finds nothing at this frame may find the solution at a later one.
            return
        # A smoother that solves when asked stands elsewhere now than when it answered.
        T = np.array(back_end.estimate().T_world_body)
        self.posteriors.append(Posterior(k, T, landmarks, joint))


def series_of(linearisation: Linearisation, T_world_body: FloatArray) -> dict[str, float]:
    """The series of a frame whose estimate is the pose (n+1, n+1)."""
    turn, shift = unanchored_information(linearisation.root)
    values = {NULLITY: float(nullity(linearisation.root, linearisation.scale)), TURN: turn, SHIFT: shift}
    T_at, at, now = linearisation.T_world_body, linearisation.landmarks_at, linearisation.landmarks
    if T_at is None or at is None or now is None:
        return values
    metres, radians = pose_drift(T_at, T_world_body)
    landmarks = math.sqrt(float(np.mean(landmark_drift(at, now) ** 2)))
    return values | dict(zip(DRIFTS, (float(metres), math.degrees(float(radians)), landmarks), strict=True))
