"""EKF-SLAM in the plane compiled to machine code: the numbers of ``ekf_slam``, for Monte Carlo on small maps.

With a few dozen landmarks the arithmetic of a frame takes microseconds and numpy's calls take all the time.
The kernel (compiled/ekf_kernel.py) does a frame in one call; ``run`` does a whole stream in one. On maps of
more than about 150 landmarks BLAS beats plain loops, and ``ekf_slam`` is the better choice.

Needs numba, which the extra ``fast`` installs. The first use on a machine compiles for some seconds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from slamcmp.errors import DivergedError, UsageError
from slamcmp.registry import back_ends
from slamcmp.types import Estimate, FloatArray, Frame, IntArray, Landmarks, Problem, Trajectory

_SENSORS = ("range_bearing", "relative_position")


@back_ends.register("ekf_compiled")
class CompiledEkf:
    """``ekf_slam`` in the plane as compiled loops: the same numbers, many times faster on small maps.

    Args:
        problem: prior and sensor (planar; range_bearing or relative_position).
        new_landmarks, error_state: as in ``ekf_slam``.

    Raises:
        UsageError: numba is not installed, or the sensor is another one.
        DivergedError: an innovation covariance is not positive definite or not finite.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        new_landmarks: Literal["join_first", "update_first"] = "join_first",
        error_state: Literal["world", "body"] = "world",
    ) -> None:
        sensor = problem.sensor
        if sensor.name not in _SENSORS or sensor.space_dim != 2:
            raise UsageError(
                f"ekf_compiled: sensor {sensor.name!r} in {sensor.space_dim} dimensions; it is compiled for "
                f"{' and '.join(_SENSORS)} in the plane, and ekf_slam takes all others"
            )
        try:
            from slamcmp.backends.filters.compiled import ekf_kernel
        except ImportError as error:
            raise UsageError(
                f"ekf_compiled: needs numba ({error}); pip install 'slamcmp[fast]', or use ekf_slam, which "
                "gives the same numbers"
            ) from error
        self._kernel = ekf_kernel
        self._settings = (
            sensor.name == "range_bearing",
            error_state == "world",
            new_landmarks == "join_first",
        )
        self._T = np.array(problem.T_world_body)
        self._P = np.array(problem.P)
        self._landmarks = np.empty((0, 2))
        self._number: dict[int, int] = {}
        self._nis, self._nis_dof = 0.0, 0

    def update(self, frame: Frame) -> None:
        """Predict to the frame's pose, then take in its observations."""
        known = len(self._number)
        numbers = self._numbers(frame.ids)
        self._nis, self._nis_dof = self._kernel.step(
            self._T,
            self._P,
            self._landmarks,
            known,
            frame.T_prev_body,
            frame.Q,
            numbers,
            frame.z,
            frame.R,
            *self._settings,
        )
        if not math.isfinite(self._nis):
            raise _diverged(frame.k)

    def run(self, frames: Sequence[Frame]) -> Trajectory:
        """Every frame of a stream without Python in between; the online poses with their covariances.

        The map, the joint covariance and the diagnostics are then those after the last frame.

        Raises:
            DivergedError: as ``update``; what came before is lost.
        """
        known = len(self._number)
        starts = np.cumsum([0, *(frame.ids.size for frame in frames)])
        numbers = self._numbers(np.concatenate([frame.ids for frame in frames]))
        poses, covariances = np.empty((len(frames), 3, 3)), np.empty((len(frames), 3, 3))
        nis, dof = np.empty(len(frames)), np.empty(len(frames), dtype=np.int64)
        done = self._kernel.run(
            self._T,
            self._P,
            self._landmarks,
            known,
            np.array([frame.T_prev_body for frame in frames]),
            np.array([frame.Q for frame in frames]),
            starts,
            numbers,
            np.concatenate([frame.z for frame in frames]),
            np.concatenate([frame.R for frame in frames]),
            *self._settings,
            poses,
            covariances,
            nis,
            dof,
        )
        if done < len(frames):
            raise _diverged(frames[done].k)
        self._nis, self._nis_dof = float(nis[-1]), int(dof[-1])
        return Trajectory(np.array([frame.t for frame in frames]), poses, covariances)

    def estimate(self) -> Estimate:
        """The current pose and its covariance."""
        return Estimate(self._T, self._P[:3, :3])

    def landmarks(self) -> Landmarks:
        """Every landmark ever seen, in the order of first sight."""
        count = len(self._number)
        ids = np.fromiter(self._number, dtype=np.int64, count=count)
        blocks = self._P[3:, 3:][: 2 * count, : 2 * count].reshape(count, 2, count, 2)
        own = np.arange(count)
        return Landmarks(ids, self._landmarks[:count], blocks[own, :, own, :])

    def joint_covariance(self) -> FloatArray:
        """P of pose and landmarks, (3 + 2 L, 3 + 2 L)."""
        n = 3 + 2 * len(self._number)
        return self._P[:n, :n].copy()

    def diagnostics(self) -> Mapping[str, float]:
        """NIS of the last frame with its degrees of freedom, landmarks, and measurements dropped (none)."""
        return {
            "nis": self._nis if self._nis_dof else float("nan"),
            "nis_dof": self._nis_dof,
            "landmarks": len(self._number),
            "dropped": 0,
        }

    def _numbers(self, ids: IntArray) -> IntArray:
        """Places of the landmarks in the state, new ones behind the known; makes room for them."""
        number = self._number
        numbers = np.array([number.setdefault(i, len(number)) for i in ids.tolist()], dtype=np.int64)
        if len(number) > len(self._landmarks):
            capacity = 2 * len(number)
            P = np.zeros((3 + 2 * capacity, 3 + 2 * capacity))
            P[: len(self._P), : len(self._P)] = self._P
            landmarks = np.empty((capacity, 2))
            landmarks[: len(self._landmarks)] = self._landmarks
            self._P, self._landmarks = P, landmarks
        return numbers


def _diverged(k: int) -> DivergedError:
    return DivergedError(
        f"frame {k}: the innovation covariance is not positive definite, or the innovation not finite; the "
        "filter has lost its covariance, or a measurement is spoilt"
    )
