"""What each kind of plug-in must offer. A student's back end implements :class:`BackEnd`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, Protocol, runtime_checkable

from slamcmp.types import BoolArray, Estimate, FloatArray, Frame, IntArray, Landmarks, Trajectory


@runtime_checkable
class BackEnd(Protocol):
    """An estimator, constructed as ``Name(problem, **parameters)`` and fed one frame at a time."""

    def update(self, frame: Frame) -> None:
        """Take in the next frame: its odometry, then its observations."""

    def estimate(self) -> Estimate:
        """The current pose and covariance, from the frames seen up to now only."""


@runtime_checkable
class Mapper(Protocol):
    """A back end that can also tell where the landmarks are."""

    def landmarks(self) -> Landmarks:
        """Every landmark's current position and covariance block."""


@runtime_checkable
class JointEstimator(Mapper, Protocol):
    """A mapper that can also tell the joint covariance of the current pose and its map."""

    def joint_covariance(self) -> FloatArray:
        """``(p + n L, p + n L)``: pose tangent first, then landmarks in the order of ``landmarks()``."""


@runtime_checkable
class LocalEstimator(JointEstimator, Protocol):
    """A joint estimator that can tell a part of its map sooner than the whole."""

    def local_map(self, ids: IntArray) -> tuple[IntArray, FloatArray, FloatArray]:
        """Of these landmarks the ids in the map (m,), their positions (m, n), and the joint covariance.

        The covariance ``(p + n m, p + n m)`` is that of the current pose and of them, in that order.
        """


@runtime_checkable
class Selective(Protocol):
    """A back end that leaves out some of the observations it is given."""

    def kept_observations(self) -> BoolArray:
        """Which observations of the last frame it used, (m,)."""


@runtime_checkable
class Smoother(Protocol):
    """A back end that can revise the past."""

    def trajectory(self) -> Trajectory:
        """Every pose up to now with hindsight."""


@runtime_checkable
class UsesRelativePoses(Protocol):
    """A back end for streams with loop closures between poses; any other refuses such a stream."""

    relative_poses: Literal["used", "ignored"]
    """What becomes of :attr:`Frame.relative_poses <slamcmp.types.Frame.relative_poses>`."""


@runtime_checkable
class Diagnosed(Protocol):
    """A back end that tells scalars about its last step: ``nis``, ``nis_dof``, ``chi2``, ``dof``, …"""

    def diagnostics(self) -> Mapping[str, float]:
        """Scalars about the last ``update`` (after ``trajectory()``: about the final solution)."""
