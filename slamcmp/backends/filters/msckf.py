"""Multi-state constraint Kalman filter: past poses stay in the state, landmarks never enter it.

The opposite choice to EKF-SLAM: there poses are marginalised and landmarks kept, here a landmark's track is
marginalised the moment it ends. All its observations act at once as constraints between the poses that made
them, after the landmark itself is projected out (Mourikis and Roumeliotis 2007, "A multi-state constraint
Kalman filter for vision-aided inertial navigation", sec. III-D). The cost of a frame does not grow with the
map, but a place seen again is a new landmark: nothing closes a loop longer than the window. Errors of poses
are additive in the world (charts.py). An older pose is to the covariance what a landmark is to EKF-SLAM: it
joins as a copy of the pose and stays where it is while the pose moves on.

========  =====================================================================
symbol    meaning
========  =====================================================================
T         the window's poses (K, n+1, n+1), oldest first
P         their joint covariance (K p, K p): the newest, then oldest to newest
A         a pose's error to its body tangent, (p, p)
z, R      observations of a track and their covariances
H_x, H_f  a track's whitened Jacobians by the poses (m d, K p), the landmark (m d, n)
r         whitened residual, (m d,)
N         basis of the left null space of H_f, N^T H_f = 0
G         (H_f^T H_f)^-1 H_f^T H_x: how the landmark follows the poses
========  =====================================================================
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy, deepcopy
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt

from slamcmp.backends.entries import places_by_itself
from slamcmp.backends.filters.covariances.covariance import JointCovariance
from slamcmp.backends.filters.covariances.error_covariance import ErrorCovariance
from slamcmp.backends.filters.error_state.charts import WorldChart
from slamcmp.backends.filters.map_filter import sandwich
from slamcmp.backends.filters.triangulation import (
    best_supported,
    lengths,
    robust_triangulate,
    triangulate,
)
from slamcmp.backends.robust import DOUBTED, RobustKernel, robust_kernel
from slamcmp.backends.sights import Sights, padded
from slamcmp.backends.whitening import whiteners
from slamcmp.models.sensors import entry_sensor
from slamcmp.registry import back_ends
from slamcmp.types import Detections, Estimate, FloatArray, Frame, IntArray, Landmarks, Problem, Trajectory


@dataclass
class Track:
    """A landmark's observations that no update has used yet."""

    frames: list[int] = field(default_factory=list)
    z: list[FloatArray] = field(default_factory=list)
    W: list[FloatArray] = field(default_factory=list)
    entering: list[bool] = field(default_factory=list)
    """Which the entry sensor made (entries.py)."""


@dataclass(frozen=True)
class Constraint:
    """What a finished track says about the poses, and where that leaves its landmark."""

    landmark: int
    position: FloatArray
    """(n,)."""
    own: FloatArray
    """Covariance of the landmark given the poses, (n, n)."""
    G: FloatArray
    """(n, K p)."""
    H: FloatArray
    """N^T H_x, (m d - n, K p)."""
    r: FloatArray
    """N^T r."""
    weights: FloatArray
    """Of its observations, (m,); 1 without a kernel."""


@back_ends.register("msckf", closes_loops=False)
class Msckf:
    """MSCKF-style filter: a window of poses, landmarks marginalised as their tracks end.

    A track ends when a frame does not see its landmark, or when its first pose leaves the window; a landmark
    that is seen on starts a new track. The online estimate does not know the observations of tracks that
    still run; ``trajectory()`` ends them all, so that it has used every observation once. A single camera's
    first track begins with the landmark's entry, later ones have pixels only and are triangulated from where
    the last one left the landmark; a track that determines no point in front of all its cameras is dropped,
    and counted.

    Args:
        problem: prior and sensor (planar or spatial).
        window: poses kept, the current one included; a track cannot be longer.
        robust: kernel on the observations' whitened residuals, as the track's own point leaves them: where
            the track was triangulated from the window's poses, which know each other well. It starts from
            the sighting with which the others agree best, and what it doubts weighs less as a constraint.
        robust_width: of the kernel; default the width with 95 % efficiency on Gaussian noise.

    Raises:
        DivergedError: an innovation covariance is not positive definite or not finite.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        window: Annotated[int, Ge(2)] = 15,
        robust: RobustKernel = "none",
        robust_width: Annotated[float, Gt(0)] | None = None,
    ) -> None:
        self._kernel = robust_kernel(robust, robust_width)
        self._weights = np.ones(0)
        self._sensor = problem.sensor
        self._sights = Sights(problem.sensor, entry_sensor(problem.sensor))
        self._window = window
        self._n = problem.sensor.space_dim
        self._chart = WorldChart(self._n)
        self._p = self._chart.p
        self._T = problem.T_world_body[None].copy()
        P = sandwich(self._chart.from_body(self._T[0]), problem.P)
        self._P = ErrorCovariance(JointCovariance(P), self._p)
        self._first = 0
        """Number of the window's oldest frame."""
        self._tracks: dict[int, Track] = {}
        self._map: dict[int, tuple[FloatArray, FloatArray]] = {}
        self._used, self._dropped = 0, 0
        self._t: list[float] = []
        self._left: list[tuple[FloatArray, FloatArray]] = []
        self._ended = self
        """This filter, or after ``trajectory()`` a copy of it whose tracks have all ended."""

    def update(self, frame: Frame) -> None:
        """Append the pose, note the observations, use up finished tracks, drop the oldest pose."""
        constraints = self.construct(frame)
        self.solve(constraints)
        self.marginalise(frame)

    def construct(self, frame: Frame) -> list[Constraint]:
        """The frame's cost: a new pose, and what the tracks that end with the frame say about the window."""
        self._P.begin_frame(frame.k)
        self._ended, self._dropped = self, 0
        if frame.k > 0:
            self._append_pose(frame)
        self._t.append(frame.t)
        if frame.entries is not None:
            self._note(frame.k, frame.entries, entering=True)
        self._note(frame.k, frame, entering=False)
        finished = [
            landmark
            for landmark, track in self._tracks.items()
            if track.frames[-1] < frame.k or (self._full and track.frames[0] == self._first)
        ]
        return self._constraints({landmark: self._tracks.pop(landmark) for landmark in finished})

    def solve(self, constraints: list[Constraint]) -> None:
        """One Gauss-Newton step on it, in covariance form; places the tracks' landmarks."""
        self._used = len(constraints)
        self._weights = np.concatenate([np.ones(0), *(constraint.weights for constraint in constraints)])
        if not constraints:
            return
        H = np.concatenate([constraint.H for constraint in constraints])
        r = np.concatenate([constraint.r for constraint in constraints])
        step = self._P.observe(np.arange(self._P.size), H, np.eye(r.size), r)
        P = self._P.dense()
        for constraint in constraints:
            G = constraint.G
            self._map[constraint.landmark] = (constraint.position - G @ step, constraint.own + G @ P @ G.T)
        none = np.empty((0, self._n))
        errors = step.reshape(-1, self._p)[self._slots]
        self._T = np.array([self._chart.retract(T, none, e)[0] for T, e in zip(self._T, errors, strict=True)])

    def marginalise(self, frame: Frame) -> None:
        """The oldest pose leaves a window that is full."""
        if self._full:
            # One place early: the window holds w poses again when the next frame's has been appended.
            self._left.append((self._T[0], self._covariances()[0]))
            self._P.drop(np.arange(self._p, 2 * self._p))
            self._T = self._T[1:]
            self._first += 1
        self._P.end_frame(frame.t, self._T[-1])

    def estimate(self) -> Estimate:
        """The current pose and its covariance."""
        return Estimate(self._T[-1], sandwich(self._chart.to_body(self._T[-1]), self._P.pose_block()))

    def landmarks(self) -> Landmarks:
        """The landmarks of tracks that have ended, each as its latest track left it."""
        ended = self._ended._map
        ids = np.fromiter(ended, dtype=np.int64, count=len(ended))
        positions = np.array([position for position, _ in ended.values()]).reshape(-1, self._n)
        covariances = np.array([P for _, P in ended.values()]).reshape(-1, self._n, self._n)
        return Landmarks(ids, positions, covariances)

    def trajectory(self) -> Trajectory:
        """Each pose as it left the window, or, in it, given every observation so far.

        Tracks that still run are ended for this answer, and for those of ``landmarks`` and ``diagnostics``
        after it; the filter itself goes on with them as if it had not been asked.
        """
        ended = self._ended = copy(self)
        ended._P, ended._map = deepcopy(self._P), dict(self._map)
        ended._P.begin_frame(self._P.frame)
        ended.solve(ended._constraints(self._tracks))
        poses = [T for T, _ in self._left] + list(ended._T)
        covariances = [P for _, P in self._left] + ended._covariances()
        return Trajectory(np.array(self._t), np.array(poses), np.array(covariances))

    def diagnostics(self) -> Mapping[str, float]:
        """NIS of the frame's update with its degrees of freedom, tracks used by it, landmarks of the map, and
        how many observations were dropped with their tracks; with a kernel also the smallest weight of an
        observation that was used, and how many it ``downweighted`` to less than a half."""
        ended = self._ended
        told = {
            "nis": ended._P.nis if ended._P.nis_dof else float("nan"),
            "nis_dof": ended._P.nis_dof,
            "tracks_used": ended._used,
            "landmarks": len(ended._map),
            "dropped": ended._dropped,
        }
        if self._kernel is None:
            return told
        return {
            **told,
            "smallest_weight": ended._weights.min(initial=1.0),
            "downweighted": int((ended._weights < DOUBTED).sum()),
        }

    def _note(self, k: int, sights: Frame | Detections, *, entering: bool) -> None:
        """Observations from the newest pose, each with its track."""
        if sights.ids.size == 0:
            return
        z, W = padded(sights.z, whiteners(sights.R), self._sights.dim)
        for row, landmark in enumerate(sights.ids.tolist()):
            track = self._tracks.setdefault(landmark, Track())
            track.frames.append(k)
            track.z.append(z[row])
            track.W.append(W[row])
            track.entering.append(entering)

    @property
    def _full(self) -> bool:
        return len(self._T) == self._window

    @property
    def _slots(self) -> IntArray:
        """Where each pose of the window stands in P, (K,)."""
        slots: IntArray = np.roll(np.arange(len(self._T)), -1)
        return slots

    def _covariances(self) -> list[FloatArray]:
        """Of each pose of the window, in its body tangent."""
        own = [self._P.pose_block(), *self._P.diagonal_blocks()]
        return [
            sandwich(self._chart.to_body(T), own[slot]) for T, slot in zip(self._T, self._slots, strict=True)
        ]

    def _append_pose(self, frame: Frame) -> None:
        T = self._T[-1] @ frame.T_prev_body
        p = self._p
        self._P.grow(np.eye(p), np.zeros((p, p)))
        F = self._chart.transition(self._T[-1], T)
        self._P.move(F, Q=sandwich(self._chart.from_body(T), frame.Q))
        self._T = np.concatenate([self._T, T[None]])

    def _constraints(self, tracks: Mapping[int, Track]) -> list[Constraint]:
        """What these tracks say about the window, as far as they say anything."""
        made = [self._constraint(landmark, track) for landmark, track in tracks.items()]
        return [constraint for constraint in made if constraint is not None]

    def _constraint(self, landmark: int, track: Track) -> Constraint | None:
        """Triangulate the landmark, then take it out; None where nothing about the poses is left."""
        z, W, entering = np.array(track.z), np.array(track.W), np.array(track.entering)
        sights = self._sights
        if not places_by_itself(self._sensor):
            sights = replace(sights, entering=entering)
        m, d = z.shape
        # Rows that only fill up would count as measurements.
        real = np.arange(d) < np.where(entering, sights.entry_sensor.dim, self._sensor.dim)[:, None]
        if real.sum() <= self._n:
            return None
        numbers = np.array(track.frames) - self._first
        poses = self._T[numbers]
        start = self._start(landmark, track, poses[0])
        position = None if start is None else triangulate(sights, poses, z, W, start)
        weights = np.ones(m)
        if start is not None and self._kernel is not None:
            position, weights = self._doubted(sights, poses, z, W, start, position)
        if position is None:
            self._dropped += m
            return None
        W = np.sqrt(weights)[:, None, None] * W
        points = np.tile(position, (m, 1))
        H_pose, H_land = sights.derivatives(poses, points, poses, points)
        A = np.array([self._chart.to_body(T) for T in poses])
        blocks = np.zeros((m, d, len(self._T), self._p))
        blocks[np.arange(m), :, self._slots[numbers], :] = W @ H_pose @ A
        H_x = blocks.reshape(m, d, -1)[real]
        H_f = (W @ H_land)[real]
        r = -(W @ sights.errors(poses, points, z)[..., None])[..., 0][real]
        basis, triangle = np.linalg.qr(H_f, mode="complete")
        inverse = np.linalg.inv(triangle[: self._n])
        N = basis[:, self._n :]
        return Constraint(
            landmark,
            position,
            inverse @ inverse.T,
            inverse @ basis[:, : self._n].T @ H_x,
            N.T @ H_x,
            N.T @ r,
            weights,
        )

    def _doubted(
        self,
        sights: Sights,
        poses: FloatArray,
        z: FloatArray,
        W: FloatArray,
        start: FloatArray,
        position: FloatArray | None,
    ) -> tuple[FloatArray | None, FloatArray]:
        """The landmark under the kernel and the weights (m,), ``position`` being the one without."""
        kernel, ones = self._kernel, np.ones(len(z))
        assert kernel is not None
        if position is not None:
            r = lengths(sights, poses, z, W, np.tile(position, (len(z), 1)))
            if (kernel.weight(r) == 1.0).all():
                return position, ones
        if places_by_itself(self._sensor):
            start = best_supported(sights, poses, z, W, kernel)
        return robust_triangulate(sights, poses, z, W, start, kernel)

    def _start(self, landmark: int, track: Track, T: FloatArray) -> FloatArray | None:
        """Where triangulation begins: by the first sight from T, or where the last track ended."""
        by = self._sights.entry_sensor
        if track.entering[0] or places_by_itself(self._sensor):
            return by.invert(T, track.z[0][: by.dim])
        return self._map[landmark][0] if landmark in self._map else None
