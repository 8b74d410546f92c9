"""The cost of a measurement stream as a GTSAM graph: what every GTSAM back end shares.

Residuals, noise and tangent are those of the filters: a prior on the first pose, ``log(T_prev_body^-1
T_{k-1}^-1 T_k)`` for odometry, ``h(T, l) - z`` for observations, each with its full covariance.

========  =====================================================================
symbol    meaning
========  =====================================================================
P         covariance of the prior, body tangent, (p, p)
Q         covariance of an odometry increment, body tangent, (p, p)
========  =====================================================================
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import atan2
from typing import Any

import gtsam
import numpy as np
from gtsam import noiseModel

from slamcmp.backends.doubtful import DoubtfulLandmarks
from slamcmp.backends.entries import Entries, entering, placed, places_by_itself
from slamcmp.backends.gtsam_smoothers.factors import NoiseCache, landmark_key, observation_factors, pose_key
from slamcmp.backends.gtsam_smoothers.robust_factors import Believed, Narrowing, believed, robust_noise
from slamcmp.backends.robust import RobustKernel, robust_kernel
from slamcmp.backends.whitening import require_definite
from slamcmp.errors import DivergedError, UsageError
from slamcmp.models.camera import Camera
from slamcmp.models.sensors import entry_sensor
from slamcmp.types import TANGENT_DIM, FloatArray, Frame, IntArray, Landmarks, Problem

RESTARTED = 1 << 51
"""Number of the first variable of a landmark that has started anew: above every id."""
MOST_WITHOUT_IMAGE = 0.01
"""Largest share of observations that may be of landmarks behind the camera; each weighs as thousands."""


class GraphBuilder:
    """Turns frames, one after the other, into factors and initial values.

    Raises:
        UsageError: the prior is singular.
    """

    def __init__(self, problem: Problem, *, robust: RobustKernel, robust_width: float | None) -> None:
        require_definite(problem.P, "the prior covariance Problem.P")
        self.space_dim = problem.sensor.space_dim
        self.known: set[int] = set()
        """Ids of the landmarks that already have a variable; discard one to have it initialised anew."""
        self.next_frame = 0
        planar = self.space_dim == 2
        self.dropped = 0
        """Measurements of the last frame that had no use: their landmarks are unknown and cannot enter."""
        self._sensor, self._entry_sensor = problem.sensor, entry_sensor(problem.sensor)
        # Of cameras only: who was seen in each frame, and by which measurement each landmark entered.
        self._sights: list[IntArray] = []
        self._entered: dict[int, tuple[int, FloatArray]] = {}
        self._prior = to_gtsam(problem.T_world_body)
        self._prior_P = problem.P
        self._prior_factor = gtsam.PriorFactorPose2 if planar else gtsam.PriorFactorPose3
        self._between = gtsam.BetweenFactorPose2 if planar else gtsam.BetweenFactorPose3
        self._odometry_noise = NoiseCache(self._odometry_model)
        self._closure_noise = NoiseCache(noiseModel.Gaussian.Covariance)
        self._kernel = robust_kernel(robust, robust_width)
        self._doubtful = None if self._kernel is None else DoubtfulLandmarks(self._sensor)
        self._variable: dict[int, int] = {}
        """Numbers of the variables of landmarks that have started anew; others have their id's."""
        self.narrowing: Narrowing | None = None
        """Of ``gnc``, whose observations are Gaussian in the graphs of ``extend``."""
        if self._kernel is not None and self._kernel.name == "gnc":
            self.narrowing = Narrowing(self._kernel)
        wrap = robust_noise(None if self.narrowing is not None else self._kernel)
        self._observations = observation_factors(self._sensor, wrap)
        self._entries = None
        if not places_by_itself(self._sensor):
            self._entries = observation_factors(self._entry_sensor, wrap)
        self._rows, self._restarts = 0, 0

    def extend(self, frame: Frame, previous: Any) -> tuple[Any, Any]:
        """The frame's factors, and initial values for its pose and for landmarks seen the first time.

        The pose starts where odometry takes ``previous``, the last pose's estimate (GTSAM; not used at
        frame 0), and a landmark where the pose's start sees it.

        Raises:
            UsageError: Q is singular, or the frame does not follow the last one.
        """
        k = frame.k
        if k != self.next_frame:
            raise UsageError(
                f"frame {k} came where frame {self.next_frame} was due: feed every frame in order"
            )
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        key = pose_key(k)
        if self._doubtful is not None:
            for landmark_id in self._doubtful.contradicted(frame, self.known):
                # What was seen of it so far stays with the old variable, which nothing else is tied to.
                self.known.discard(landmark_id)
                self._variable[landmark_id] = RESTARTED + self._restarts
                self._restarts += 1
        if k == 0:
            predicted = self._prior
            graph.add(self._prior_factor(key, predicted, noiseModel.Gaussian.Covariance(self._prior_P)))
        else:
            increment = to_gtsam(frame.T_prev_body)
            predicted = previous.compose(increment)
            graph.add(self._between(key - 1, key, increment, self._odometry_noise(frame.Q)))
        values.insert(key, predicted)
        self._close_loops(graph, key, frame)
        self._observe(graph, values, predicted, frame)
        self.next_frame = k + 1
        self._rows += TANGENT_DIM[self.space_dim]
        return graph, values

    def key(self, landmark_id: int) -> int:
        """GTSAM's key of the landmark's variable."""
        number = self._variable.get(landmark_id)
        return landmark_key(landmark_id) if number is None else landmark_key(0) + number

    def believed(self, graph: Any, values: Any) -> Believed | None:
        """With a kernel, what the solution ``values`` of the whole graph believes."""
        return None if self._kernel is None else believed(graph, values, self._kernel)

    def landmark_ids(self) -> list[int]:
        """Ids of the landmarks in the graph, sorted."""
        return sorted(self.known)

    def map(self, values: Any, covariance: Callable[[int], FloatArray], ids: list[int]) -> Landmarks:
        """The landmarks ``ids`` from GTSAM values and a function from a key to its marginal covariance."""
        n, how = self.space_dim, self._observations
        covariances = np.array([covariance(self.key(i))[how.position, how.position] for i in ids])
        return Landmarks(
            np.array(ids, dtype=np.int64), self.positions(values, ids), covariances.reshape(-1, n, n)
        )

    def positions(self, values: Any, ids: list[int]) -> FloatArray:
        """Where the landmarks ``ids`` are, (m, n), in GTSAM values."""
        found = [self._observations.position_of(values, self.key(i)) for i in ids]
        return np.array(found).reshape(-1, self.space_dim)

    def landmark_value(self, position: FloatArray) -> Any:
        """The variable of a landmark at ``position`` (n,)."""
        return self._observations.value(position)

    def joint(self, k: int, covariance: Callable[[list[int]], FloatArray], ids: list[int]) -> FloatArray:
        """Joint covariance (p + n L, p + n L) of pose k and the landmarks ``ids``, in that order.

        ``covariance`` maps keys to their joint marginal covariance, blocks in the order of the keys.
        """
        p, how = TANGENT_DIM[self.space_dim], self._observations
        full = covariance([pose_key(k), *(self.key(i) for i in ids)])
        position = np.arange(how.tangent)[how.position]
        starts = p + how.tangent * np.arange(len(ids))
        kept = np.concatenate([np.arange(p), (starts[:, None] + position).ravel()])
        joint: FloatArray = full[np.ix_(kept, kept)]
        return joint

    def goodness(self, chi2: float) -> dict[str, float]:
        """``chi2, dof, chi2_per_dof`` (NaN where dof is 0) of the whole cost so far."""
        landmarks = len(self.known) + self._restarts
        unknowns = TANGENT_DIM[self.space_dim] * self.next_frame + self.space_dim * landmarks
        dof = self._rows - unknowns
        return {"chi2": chi2, "dof": float(dof), "chi2_per_dof": chi2 / dof if dof > 0 else float("nan")}

    def require_images(self, values: Any, poses: FloatArray, back_end: str) -> int:
        """How many observations of the last poses (K, n+1, n+1) are of landmarks behind the camera.

        GTSAM gives each a constant error without a derivative and says nothing.

        Raises:
            DivergedError: more than ``MOST_WITHOUT_IMAGE`` of them.
        """
        hidden, total = self._hidden(values, poses)
        behind = hidden.size
        if behind > MOST_WITHOUT_IMAGE * total:
            raise DivergedError(
                f"{back_end}: {behind} of {total} observations are of landmarks behind the camera, for which "
                "GTSAM has a constant error and no derivative: the solution is lost"
            )
        return behind

    def cost_without_image(self, graph: Any, values: Any, poses: FloatArray) -> tuple[float, int]:
        """What observations of landmarks behind the camera add to chi-square, and their components.

        It is GTSAM's constant and no residual: a fit is judged without it (poses (K, n+1, n+1): all so far).
        """
        if not isinstance(self._sensor, Camera):
            return 0.0, 0
        hidden = np.unique(self._hidden(values, poses)[0]).tolist()
        frames = {pose_key(k): k for k in range(len(poses))}
        chi2, rows = 0.0, 0
        for landmark_id in hidden:
            key, position = self.key(landmark_id), self.positions(values, [landmark_id])
            for factor in (graph.at(index) for index in range(graph.size())):
                keys = factor.keys()
                if key not in keys:
                    continue
                k = next((frames[each] for each in keys if each in frames), None)
                if k is not None and self._sensor.camera_point(poses[k], position)[0, 2] <= 0:
                    chi2 += 2.0 * factor.error(values)
                    rows += self._sensor.dim
        return chi2, rows

    def bring_back(self, values: Any, poses: FloatArray) -> None:
        """Put landmarks that are behind a camera that saw them where they entered, seen from ``poses``.

        There they have no derivative by which a solver could bring them back (K, n+1, n+1: all poses so far).
        """
        for landmark_id in np.unique(self._hidden(values, poses)[0]).tolist():
            k, z = self._entered[landmark_id]
            values.update(self.key(landmark_id), self._entry_sensor.invert(poses[k], z))

    def _hidden(self, values: Any, poses: FloatArray) -> tuple[IntArray, int]:
        """Landmark of each observation from the last poses that has no image, and how many there are."""
        if not isinstance(self._sensor, Camera):
            return np.empty(0, dtype=np.int64), 0
        ids = np.array(self.landmark_ids(), dtype=np.int64)
        positions = self.positions(values, ids.tolist())
        hidden, total = [ids[:0]], 0
        for T, seen in zip(poses, self._sights[-len(poses) :], strict=True):
            rows = np.searchsorted(ids, seen[np.isin(seen, ids)])
            hidden.append(ids[rows][self._sensor.camera_point(T, positions[rows])[:, 2] <= 0])
            total += rows.size
        return np.concatenate(hidden), total

    def _odometry_model(self, Q: FloatArray) -> Any:
        require_definite(Q, f"the odometry covariance Q of frame {self.next_frame}")
        return noiseModel.Gaussian.Covariance(Q)

    def _close_loops(self, graph: Any, key: int, frame: Frame) -> None:
        """Factors of what was measured of the pose relative to earlier ones."""
        related = frame.relative_poses
        if related is None:
            return
        for earlier, T, P in zip(related.frames.tolist(), related.T_earlier_body, related.P, strict=True):
            require_definite(P, f"the covariance of frame {frame.k} relative to frame {earlier}")
            graph.add(self._between(pose_key(earlier), key, to_gtsam(T), self._closure_noise(P)))
        self._rows += TANGENT_DIM[self.space_dim] * related.frames.size

    def _observe(self, graph: Any, values: Any, predicted: Any, frame: Frame) -> None:
        """Factors of the frame's observations and of the landmarks that enter with it."""
        key, sights = pose_key(frame.k), frame
        unknown = np.array([i not in self.known for i in frame.ids.tolist()], dtype=bool)
        if unknown.any() or frame.entries is not None:
            entries = entering(frame, unknown, self._sensor)
            self._start(graph, values, predicted, entries)
            if self._entries is not None:
                for factor in self._entries.factors(key, entries):
                    graph.add(factor)
                self._rows += entries.z.size
                if entries.dropped:
                    sights = replace(frame, ids=frame.ids[~unknown], z=frame.z[~unknown], R=frame.R[~unknown])
            if isinstance(self._sensor, Camera):
                self._entered.update(
                    (i, (frame.k, z)) for i, z in zip(entries.ids.tolist(), entries.z, strict=True)
                )
            self.dropped = entries.dropped
        else:
            self.dropped = 0
        for factor in self._observations.factors(key, self._by_variable(sights)):
            graph.add(factor)
        self._rows += sights.z.size
        if isinstance(self._sensor, Camera):
            self._sights.append(sights.ids)

    def _by_variable(self, sights: Frame) -> Frame:
        """The observations with the numbers of their landmarks' variables for ids."""
        if not self._variable:
            return sights
        numbers = [self._variable.get(landmark_id, landmark_id) for landmark_id in sights.ids.tolist()]
        return replace(sights, ids=np.array(numbers, dtype=np.int64))

    def _start(self, graph: Any, values: Any, predicted: Any, entries: Entries) -> None:
        known, how = self.known, self._observations
        if entries.ids.size == 0:
            return
        positions = placed(self._entry_sensor, predicted.matrix(), entries, self.next_frame)
        for landmark_id, position in zip(entries.ids.tolist(), positions, strict=True):
            key = self.key(landmark_id)
            values.insert(key, how.value(position))
            pin = how.pin(key, position)
            if pin is not None:
                graph.add(pin)
            known.add(landmark_id)


def diverged(back_end: str, k: int, error: Exception) -> DivergedError:
    """A GTSAM failure at frame k as the error that becomes a table row."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    if "ndetermina" in str(error):
        cause = (
            "the linear system is not positive definite: a path within centimetres of a landmark, a landmark "
            "too weakly observed, or noise of very different sizes; try factorization 'qr', a minimum range "
            "in the front end, or a larger prior"
        )
    else:
        cause = lines[0] if lines else type(error).__name__
    return DivergedError(f"{back_end}: GTSAM gave up at frame {k}: {cause}")


def require_finite(array: FloatArray, back_end: str, k: int) -> FloatArray:
    """``array`` itself.

    Raises:
        DivergedError: an entry is not finite; GTSAM returns such results without complaint.
    """
    if not np.isfinite(array).all():
        raise DivergedError(f"{back_end}: the estimate at frame {k} is not finite")
    return array


def poses_in(values: Any, frames: int, space_dim: int) -> FloatArray:
    """The poses X(0) … X(frames - 1) of GTSAM values, (frames, n+1, n+1)."""
    if space_dim == 2:
        # Sorted by key: landmarks held as poses come first.
        x, y, theta = gtsam.utilities.extractPose2(values)[-frames:].T
        T = np.zeros((frames, 3, 3))
        T[:, 0, 0] = T[:, 1, 1] = np.cos(theta)
        T[:, 1, 0] = np.sin(theta)
        T[:, 0, 1] = -T[:, 1, 0]
        T[:, 0, 2], T[:, 1, 2] = x, y
    else:
        rows = gtsam.utilities.extractPose3(values)[-frames:]
        T = np.zeros((frames, 4, 4))
        T[:, :3, :3] = rows[:, :9].reshape(-1, 3, 3)
        T[:, :3, 3] = rows[:, 9:]
    T[:, -1, -1] = 1.0
    return T


def to_gtsam(T: FloatArray) -> Any:
    """A pose (n+1, n+1) as GTSAM has it."""
    if T.shape[0] == 3:
        return gtsam.Pose2(T[0, 2], T[1, 2], atan2(T[1, 0], T[0, 0]))
    return gtsam.Pose3(T)
