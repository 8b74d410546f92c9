"""What every filter with a map is besides its equations: names, numbers, and answers in the common axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from slamcmp.backends.doubtful import DoubtfulLandmarks
from slamcmp.backends.entries import Entries, entering, has_blind_side, with_image
from slamcmp.backends.filters.covariances.covariance import block_diagonal
from slamcmp.backends.filters.covariances.error_covariance import ErrorCovariance
from slamcmp.backends.filters.error_state.charts import Chart
from slamcmp.backends.filters.error_state.unanchored import UnanchoredFilter
from slamcmp.backends.filters.loops import Loops
from slamcmp.backends.robust import DOUBTED, Kernel
from slamcmp.backends.unanchored import Linearisation
from slamcmp.models.sensors import entry_sensor
from slamcmp.types import (
    BoolArray,
    Estimate,
    FloatArray,
    Frame,
    IntArray,
    Landmarks,
    Problem,
    SensorModel,
    Trajectory,
)


class Observed(NamedTuple):
    """A frame's observations, sorted."""

    numbers: IntArray
    """Places (m,) in the map of the landmarks that were in the state before the frame."""
    z: FloatArray
    """Their measurements, (m, d)."""
    R: FloatArray
    """(m, d, d)."""
    entries: Entries | None
    """The landmarks that enter; None where none do."""


class MapFilter:
    """A filter of a pose and a map of numbered landmarks.

    Args:
        problem: prior and sensor.
        chart: what the errors mean whose covariance is kept.
        P: that covariance; at the start the pose's.
        kernel: of the observations; None: they are quadratic.
    """

    def __init__(
        self, problem: Problem, chart: Chart, P: ErrorCovariance, kernel: Kernel | None = None
    ) -> None:
        self._sensor: SensorModel = problem.sensor
        self._entry_sensor: SensorModel = entry_sensor(problem.sensor)
        self._has_blind_side = has_blind_side(problem.sensor)
        self._chart = chart
        self._P = P
        self._T = np.array(problem.T_world_body)
        self._landmarks: FloatArray = np.empty((0, problem.sensor.space_dim))
        """Means (L, n)."""
        self._number: dict[int, int] = {}
        """A landmark's place in the map, by its name, in the order in which they entered."""
        self._dropped = 0
        self._points: tuple[FloatArray, FloatArray, IntArray] | None = None
        """Where the frame's observations were linearised: pose, landmarks (m, n), and their numbers (m,)."""
        self._doubtful: DoubtfulLandmarks | None = None
        self._restarted = 0
        if kernel is not None:
            P.make_robust(kernel, problem.sensor.dim)
            self._doubtful = DoubtfulLandmarks(problem.sensor)
        self._loops = Loops(self)

    def update(self, frame: Frame) -> None:
        """Take in the next frame."""
        raise NotImplementedError

    def run(self, frames: Sequence[Frame]) -> Trajectory:
        """Every frame of a stream: the online poses with their covariances.

        Those of ``update`` and ``estimate`` frame by frame; where loops are compiled (loops.py) there is
        no Python in between. Map, joint covariance and diagnostics are those after the last.

        Raises:
            SlamcmpError: as ``update``; what came before is lost.
        """
        online = self._loops.run(frames)
        if online is not None:
            return online
        answers = []
        for frame in frames:
            self.update(frame)
            answers.append(self.estimate())
        size = self._chart.n + 1
        T = np.array([answer.T_world_body for answer in answers]).reshape(-1, size, size)
        P = np.array([answer.P for answer in answers]).reshape(-1, self._chart.p, self._chart.p)
        return Trajectory(np.array([frame.t for frame in frames]), T, P)

    def estimate(self) -> Estimate:
        """The current pose and its covariance."""
        if self._loops.answer is not None:
            return Estimate(*self._loops.answer)
        return Estimate(self._T, sandwich(self._chart.to_body(self._T), self._P.pose_block()))

    def landmarks(self) -> Landmarks:
        """The landmarks in the state, in the order in which they entered."""
        self._P.settle(self._landmarks)
        ids = np.fromiter(self._number, dtype=np.int64, count=len(self._number))
        C, B = self._chart.axes(self._T), self._chart.offsets(self._T, self._landmarks)
        blocks = sandwich(C, self._P.diagonal_blocks())
        if B is not None:
            cross = self._P.pose_rows()[:, self._chart.p :].T.reshape(ids.size, self._chart.n, -1)
            across = (cross if C is None else C @ cross) @ np.swapaxes(B, 1, 2)
            blocks = blocks + across + np.swapaxes(across, 1, 2)
            blocks += B @ self._P.pose_block() @ np.swapaxes(B, 1, 2)
        return Landmarks(ids, self._landmarks, blocks)

    def joint_covariance(self) -> FloatArray:
        """P of pose (body tangent) and landmarks (world axes), (p + n L, p + n L)."""
        P, p = self._P.dense(), self._chart.p
        A, C = self._chart.to_body(self._T), self._chart.axes(self._T)
        B = self._chart.offsets(self._T, self._landmarks)
        if A is None and B is None and C is None:
            return P
        to_border = np.eye(len(P))
        if A is not None:
            to_border[:p, :p] = A
        if C is not None:
            to_border[p:, p:] = block_diagonal(np.broadcast_to(C, (len(self._landmarks), *C.shape)))
        if B is not None:
            to_border[p:, :p] = B.reshape(-1, p)
        return sandwich(to_border, P)

    def diagnostics(self) -> Mapping[str, float]:
        """NIS of the last frame with its degrees of freedom, landmarks in the state, and how many of the
        frame's measurements were dropped (entries.py).

        With a kernel also the smallest weight of an observation, how many it ``downweighted`` to less than a
        half, and how many landmarks were ``restarted`` (doubtful.py)."""
        told = {
            "nis": self._P.nis if self._P.nis_dof else float("nan"),
            "nis_dof": self._P.nis_dof,
            "landmarks": len(self._number),
            "dropped": self._dropped,
        }
        if self._doubtful is None:
            return told
        weights = np.ones(0) if self._P.weights is None else self._P.weights
        return {
            **told,
            "smallest_weight": weights.min(initial=1.0),
            "downweighted": int((weights < DOUBTED).sum()),
            "restarted": self._restarted,
        }

    @property
    def covariance(self) -> ErrorCovariance:
        """P, for compiled loops."""
        return self._P

    @property
    def sensor(self) -> SensorModel:
        """The problem's."""
        return self._sensor

    @property
    def mean_pose(self) -> FloatArray:
        """The mean of the pose, (n+1, n+1)."""
        return self._T

    @property
    def mean_landmarks(self) -> FloatArray:
        """The means of the landmarks, (L, n)."""
        return self._landmarks

    @property
    def places(self) -> dict[int, int]:
        """A landmark's place in the map by its name, for compiled loops to add to."""
        return self._number

    def show(self, T: FloatArray, landmarks: FloatArray) -> None:
        """Take the means that compiled loops have come to, pose and landmarks (L, n), for one's own."""
        self._T, self._landmarks = T, landmarks

    def _begin(self, frame: Frame) -> None:
        """What diagnostics tell is from now on about this frame; landmarks that it contradicts leave."""
        self._P.begin_frame(frame.k)
        self._dropped, self._points = 0, None
        if self._doubtful is not None:
            again = self._doubtful.contradicted(frame, self._number)
            self._restarted = len(again)
            if again:
                stays = np.ones(len(self._number), dtype=bool)
                stays[[self._number[landmark] for landmark in again]] = False
                self._keep(stays)

    def _keep(self, stays: BoolArray) -> None:
        """Marginalise the landmarks that are not marked (L,); the others close ranks."""
        p, n = self._chart.p, self._chart.n
        self._P.drop((p + n * np.flatnonzero(~stays)[:, None] + np.arange(n)).ravel())
        self._landmarks = self._landmarks[stays]
        kept = [landmark for landmark, stay in zip(self._number, stays, strict=True) if stay]
        self._number = {landmark: number for number, landmark in enumerate(kept)}

    def _sorted(self, frame: Frame) -> Observed:
        """The frame's observations of landmarks in the state, and the landmarks that enter."""
        numbers = [self._number.get(name, -1) for name in frame.ids.tolist()]
        if -1 not in numbers and frame.entries is None:
            return Observed(np.array(numbers, dtype=np.int64), frame.z, frame.R, None)
        places = np.array(numbers, dtype=np.int64)
        known = places >= 0
        entries = entering(frame, ~known, self._sensor)
        self._dropped = entries.dropped
        some = entries if entries.ids.size else None
        return Observed(places[known], frame.z[known], frame.R[known], some)

    def _with_image(self, seen: Observed, z_predicted: FloatArray) -> Observed:
        """The observations without those that a camera cannot have made if the estimate is right.

        Raises:
            DivergedError: they are most.
        """
        exists = with_image(z_predicted, self._P.frame)
        self._dropped += exists.size - int(exists.sum())
        return Observed(seen.numbers[exists], seen.z[exists], seen.R[exists], seen.entries)

    def _enter(self, entries: Entries, positions: FloatArray, G: FloatArray, N: FloatArray) -> None:
        """Let landmarks join at ``positions`` (m, n), with errors G times the pose's plus noise N."""
        self._P.grow(G, N)
        self._name(entries, positions)

    def _name(self, entries: Entries, positions: FloatArray) -> None:
        """Number landmarks that have joined the state."""
        self._landmarks = np.concatenate([self._landmarks, positions])
        for name in entries.ids.tolist():
            self._number[name] = len(self._number)


class LinearisingFilter(MapFilter):
    """A map filter that can tell what its own linear system claims."""

    _unanchored: UnanchoredFilter

    def record_linearisation(self) -> None:
        """Keep what :meth:`linearisation` needs, from the first frame on."""
        self._unanchored = self._P.add_listener(UnanchoredFilter(self._chart.p))

    def linearisation(self) -> Linearisation:
        """What the filter's own matrices claim about its pose, and where its last Jacobians were taken.

        Needs :meth:`record_linearisation` before the first frame.
        """
        root, scale = self._unanchored.told()
        to_chart = self._chart.from_body(self._T)
        if to_chart is not None:
            root = root @ to_chart
            scale = np.linalg.norm(scale[:, None] * to_chart, axis=0)
        if self._points is None:
            return Linearisation(root, scale)
        T_at, landmarks_at, numbers = self._points
        return Linearisation(root, scale, T_at, landmarks_at, self._landmarks[numbers])


def sandwich(A: FloatArray | None, P: FloatArray) -> FloatArray:
    """A P A^T, exactly symmetric; None is the identity."""
    if A is None:
        return P
    product = A @ P @ A.T
    return 0.5 * (product + np.swapaxes(product, -1, -2))
