"""What a landmark sensor must offer."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from slamcmp.types.arrays import FloatArray


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
