"""What each kind of plug-in must offer. A student's back end implements :class:`BackEnd`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from numpy.typing import NDArray

if TYPE_CHECKING:
    import numpy as np

    from slamcmp.types import Estimate, Frame, Landmarks, Trajectory

    FloatArray = NDArray[np.float64]
    IntArray = NDArray[np.int64]
    BoolArray = NDArray[np.bool_]


class SensorModel(Protocol):
    """A landmark sensor; n = 2 or 3 space, p = 3 or 6 pose tangent, d measurement dimension.

    Every method takes one landmark ``(n,)`` or a batch ``(m, n)`` and answers with the same batch axis; the
    pose is one ``(n+1, n+1)`` for all, or one for each ``(m, n+1, n+1)``.
    """

    name: str
    """The registered name, with which a stored stream finds its sensor again."""
    space_dim: int
    """n, the dimension of the space that landmarks live in."""
    dim: int
    """d, the dimension of one measurement."""
    components: tuple[str, ...]
    """Names of the d components with their units, e.g. ``("range_m", "bearing_rad")``."""

    def parameters(self) -> Mapping[str, float]:
        """The constructor's arguments, so that a stored stream can rebuild the sensor."""

    def predict(self, T_world_body: FloatArray, landmark: FloatArray) -> FloatArray:
        """The measurement h(T, l) without noise, ``(..., d)``."""

    def invert(self, T_world_body: FloatArray, z: FloatArray) -> FloatArray:
        """The landmark ``(..., n)`` in the world that would give exactly ``z``."""

    def jacobians(self, T_world_body: FloatArray, landmark: FloatArray) -> tuple[FloatArray, FloatArray]:
        """``(H_pose (..., d, p), H_landmark (..., d, n))``; the pose's in the body tangent."""

    def linearise(
        self, T_world_body: FloatArray, landmark: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """``predict`` and both ``jacobians`` in one go: filters need all three, every frame."""

    def residual(self, z: FloatArray, z_predicted: FloatArray) -> FloatArray:
        """``z - z_predicted`` with angles wrapped to [-pi, pi], ``(..., d)``."""


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
class Diagnosed(Protocol):
    """A back end that tells scalars about its last step: ``nis``, ``nis_dof``, ``chi2``, ``dof``, …"""

    def diagnostics(self) -> Mapping[str, float]:
        """Scalars about the last ``update`` (after ``trajectory()``: about the final solution)."""
