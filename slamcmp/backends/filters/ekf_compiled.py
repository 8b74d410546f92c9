"""EKF-SLAM in the plane compiled to machine code: the numbers of ``ekf_slam``, for Monte Carlo on small maps.

With a few dozen landmarks the arithmetic of a frame takes microseconds and numpy's calls take all the time.
The kernel (compiled/ekf_kernel.py) does a frame in one call; ``run`` does a whole stream in one. On maps of
more than about 150 landmarks BLAS beats plain loops, and ``ekf_slam`` is the better choice.

Needs numba, which the extra ``fast`` installs. The first use on a machine compiles for some seconds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from slamcmp.backends.filters.charts import Chart
from slamcmp.backends.filters.covariance import JointCovariance
from slamcmp.backends.filters.error_covariance import ErrorCovariance, lost_covariance
from slamcmp.backends.filters.map_filter import MapFilter
from slamcmp.errors import UsageError
from slamcmp.registry import back_ends
from slamcmp.types import FloatArray, Frame, IntArray, Problem, Trajectory

_SENSORS = ("range_bearing", "relative_position")


@back_ends.register("ekf_compiled")
class CompiledEkf(MapFilter):
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
        self._buffer = KernelCovariance(problem.P)
        super().__init__(problem, Chart(2), ErrorCovariance(self._buffer, 2))
        self._room = self._landmarks

    def update(self, frame: Frame) -> None:
        """Predict to the frame's pose, then take in its observations."""
        self._begin(frame)
        known = len(self._number)
        numbers = self._numbers(frame.ids)
        self._P.nis, self._P.nis_dof = self._kernel.step(
            self._T,
            self._buffer.P,
            self._room,
            known,
            frame.T_prev_body,
            frame.Q,
            numbers,
            frame.z,
            frame.R,
            *self._settings,
        )
        if not math.isfinite(self._P.nis):
            raise lost_covariance(frame.k)

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
            self._buffer.P,
            self._room,
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
            raise lost_covariance(frames[done].k)
        self._P.nis, self._P.nis_dof = float(nis[-1]), int(dof[-1])
        return Trajectory(np.array([frame.t for frame in frames]), poses, covariances)

    def _numbers(self, ids: IntArray) -> IntArray:
        """Places of the landmarks in the state, new ones behind the known; makes room for them."""
        number = self._number
        numbers = np.array([number.setdefault(i, len(number)) for i in ids.tolist()], dtype=np.int64)
        count = len(number)
        if count > len(self._room):
            room = np.empty((2 * count, 2))
            room[: len(self._room)] = self._room
            self._room = room
        self._landmarks = self._room[:count]
        self._buffer.make_room(3 + 2 * count, 3 + 4 * count)
        return numbers


class KernelCovariance(JointCovariance):
    """P for plain loops, which write to it: both triangles, with room for more states."""

    @property
    def P(self) -> FloatArray:
        """The buffer (capacity, capacity), whose first rows and columns count."""
        return self._buffer

    def make_room(self, size: int, capacity: int) -> None:
        """Let ``size`` states count; the buffer grows to ``capacity`` if they do not fit."""
        if size > len(self._buffer):
            P = np.zeros((capacity, capacity))
            P[: len(self._buffer), : len(self._buffer)] = self._buffer
            self._buffer = P
        self._n = size
