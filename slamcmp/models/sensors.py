"""Landmark sensors: h, its inverse, its Jacobians and its residual.

========  ======================================================================
symbol    meaning
========  ======================================================================
q         landmark in the body frame, R^T (l - p), (..., n) [m]
z         measurement, (..., d)
H_pose    derivative of h by the body tangent of the pose, (..., d, p)
H_land    derivative of h by the landmark in the world, (..., d, n)
========  ======================================================================

With ``T exp(xi)``, dq = -v + q x omega (SE(3)) and dq = -v - theta J q, J = [[0, -1], [1, 0]] (SE(2));
Solà 2018, eq. 168 and 183, for the action of the inverse.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import numpy as np

from slamcmp.errors import DataError, UsageError
from slamcmp.geometry import hat, transform
from slamcmp.registry import sensors
from slamcmp.types import FloatArray, SensorModel

_TURN = 2.0 * np.pi


def body_point(T_world_body: FloatArray, p_world: FloatArray) -> FloatArray:
    """World points (..., n) in the body frame."""
    R, t = T_world_body[..., :-1, :-1], T_world_body[..., :-1, -1]
    # Row vectors times R are R^T times column vectors; one pose for all points is one plain product.
    if T_world_body.ndim == 2:
        return (p_world - t) @ R
    return ((p_world - t)[..., None, :] @ R)[..., 0, :]


def body_point_jacobians(T_world_body: FloatArray, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Derivatives of the body point q (..., n) by the pose (..., n, p) and the world point (..., n, n)."""
    n = q.shape[-1]
    R_t = np.swapaxes(T_world_body[..., :-1, :-1], -1, -2)
    H_point = np.broadcast_to(R_t, (*q.shape[:-1], n, n))
    if n == 2:
        H_pose = np.zeros((*q.shape[:-1], 2, 3))
        H_pose[..., 0, 0] = H_pose[..., 1, 1] = -1.0
        H_pose[..., 0, 2], H_pose[..., 1, 2] = q[..., 1], -q[..., 0]
    else:
        H_pose = np.zeros((*q.shape[:-1], 3, 6))
        H_pose[..., :3] = hat(q)
        H_pose[..., 0, 3] = H_pose[..., 1, 4] = H_pose[..., 2, 5] = -1.0
    return H_pose, H_point


@sensors.register("relative_position")
class RelativePosition:
    """Position of the landmark in the body frame, z = R^T (l - p), in metres; planar or in space."""

    name = "relative_position"

    def __init__(self, *, space_dim: int = 2) -> None:
        if space_dim not in (2, 3):
            raise DataError(f"relative_position: space_dim is {space_dim}; 2 or 3 is needed")
        self.space_dim = space_dim
        self.dim = space_dim
        self.components = ("x_m", "y_m", "z_m")[:space_dim]

    def parameters(self) -> Mapping[str, float]:
        return {"space_dim": self.space_dim}

    def predict(self, T_world_body: FloatArray, landmark: FloatArray) -> FloatArray:
        return body_point(T_world_body, landmark)

    def invert(self, T_world_body: FloatArray, z: FloatArray) -> FloatArray:
        return transform(T_world_body, z)

    def jacobians(self, T_world_body: FloatArray, landmark: FloatArray) -> tuple[FloatArray, FloatArray]:
        return body_point_jacobians(T_world_body, body_point(T_world_body, landmark))

    def linearise(
        self, T_world_body: FloatArray, landmark: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        q = body_point(T_world_body, landmark)
        return q, *body_point_jacobians(T_world_body, q)

    def residual(self, z: FloatArray, z_predicted: FloatArray) -> FloatArray:
        return z - z_predicted


@sensors.register("range_bearing")
class RangeBearing:
    """Range [m] and bearing [rad, from the body's x axis, counter-clockwise] of a landmark in the plane.

    The bearing has no derivative at range 0; the results there are not finite.
    """

    name = "range_bearing"
    space_dim = 2
    dim = 2
    components = ("range_m", "bearing_rad")

    def parameters(self) -> Mapping[str, float]:
        return {}

    def predict(self, T_world_body: FloatArray, landmark: FloatArray) -> FloatArray:
        q = body_point(T_world_body, landmark)
        z = np.empty_like(q)
        z[..., 0] = np.hypot(q[..., 0], q[..., 1])
        z[..., 1] = np.arctan2(q[..., 1], q[..., 0])
        return z

    def invert(self, T_world_body: FloatArray, z: FloatArray) -> FloatArray:
        q = np.empty_like(z)
        q[..., 0] = z[..., 0] * np.cos(z[..., 1])
        q[..., 1] = z[..., 0] * np.sin(z[..., 1])
        return transform(T_world_body, q)

    def jacobians(self, T_world_body: FloatArray, landmark: FloatArray) -> tuple[FloatArray, FloatArray]:
        return self.linearise(T_world_body, landmark)[1:]

    def linearise(
        self, T_world_body: FloatArray, landmark: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        q = body_point(T_world_body, landmark)
        x, y = q[..., 0], q[..., 1]
        r2 = x * x + y * y
        r = np.sqrt(r2)
        z = np.empty_like(q)
        z[..., 0] = r
        np.arctan2(y, x, out=z[..., 1])
        D = np.empty((*q.shape, 2))
        np.divide(x, r, out=D[..., 0, 0])
        np.divide(y, r, out=D[..., 0, 1])
        np.divide(-y, r2, out=D[..., 1, 0])
        np.divide(x, r2, out=D[..., 1, 1])
        H_pose = np.zeros((*q.shape[:-1], 2, 3))
        np.negative(D, out=H_pose[..., :2])
        # Turning on the spot changes no range and turns every bearing back by the same angle.
        H_pose[..., 1, 2] = -1.0
        if T_world_body.ndim == 2:
            return z, H_pose, (D.reshape(-1, 2) @ T_world_body[:-1, :-1].T).reshape(D.shape)
        return z, H_pose, D @ np.swapaxes(T_world_body[..., :-1, :-1], -1, -2)

    def residual(self, z: FloatArray, z_predicted: FloatArray) -> FloatArray:
        y = z - z_predicted
        # Exact for an innovation that needs no wrapping, and a third of the time of the modulo.
        y[..., 1] -= _TURN * np.rint(y[..., 1] * (1.0 / _TURN))
        return y


class _PartOfRangeBearing:
    """One of the two components of :class:`RangeBearing`: a single sighting leaves the landmark on a line."""

    name: str
    space_dim = 2
    dim = 1
    components: tuple[str, ...]
    component: int
    """Which one it measures: 0 the range, 1 the bearing."""
    invertible = False
    _whole = RangeBearing()

    @property
    def entry_sensor(self) -> RangeBearing:
        """Range and bearing: what several sightings have settled on together."""
        return self._whole

    def parameters(self) -> Mapping[str, float]:
        return {}

    def predict(self, T_world_body: FloatArray, landmark: FloatArray) -> FloatArray:
        return self._whole.predict(T_world_body, landmark)[..., self._rows]

    def invert(self, T_world_body: FloatArray, z: FloatArray) -> FloatArray:  # noqa: ARG002
        """Not possible.

        Raises:
            UsageError: always.
        """
        raise UsageError(
            f"{self.name}: one measurement does not place a landmark; it has to be seen from several places: "
            "front end 'delayed_start' waits for that"
        )

    def jacobians(self, T_world_body: FloatArray, landmark: FloatArray) -> tuple[FloatArray, FloatArray]:
        return self.linearise(T_world_body, landmark)[1:]

    def linearise(
        self, T_world_body: FloatArray, landmark: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        z, H_pose, H_land = self._whole.linearise(T_world_body, landmark)
        return z[..., self._rows], H_pose[..., self._rows, :], H_land[..., self._rows, :]

    @property
    def _rows(self) -> slice:
        return slice(self.component, self.component + 1)


@sensors.register("range_only")
class RangeOnly(_PartOfRangeBearing):
    """Range [m] of a landmark in the plane, as of a radio beacon: a sighting leaves a ring.

    It has no derivative at range 0; the results there are not finite.
    """

    name = "range_only"
    components = ("range_m",)
    component = 0

    def residual(self, z: FloatArray, z_predicted: FloatArray) -> FloatArray:
        return z - z_predicted


@sensors.register("bearing_only")
class BearingOnly(_PartOfRangeBearing):
    """Bearing [rad, from the body's x axis, counter-clockwise] of a landmark in the plane: a ray.

    It has no derivative at range 0; the results there are not finite.
    """

    name = "bearing_only"
    components = ("bearing_rad",)
    component = 1

    def residual(self, z: FloatArray, z_predicted: FloatArray) -> FloatArray:
        y = z - z_predicted
        return y - _TURN * np.rint(y * (1.0 / _TURN))


def cartesian_to_polar(z: FloatArray, R: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Relative positions (m, 2) with R (m, 2, 2) as range-bearing with first-order covariances."""
    x, y = z[..., 0], z[..., 1]
    r2 = x * x + y * y
    r = np.sqrt(r2)
    D = np.stack([np.stack([x / r, y / r], -1), np.stack([-y / r2, x / r2], -1)], -2)
    covariance = D @ R @ np.swapaxes(D, -1, -2)
    return np.stack([r, np.arctan2(y, x)], -1), 0.5 * (covariance + np.swapaxes(covariance, -1, -2))


def entry_sensor(sensor: SensorModel) -> SensorModel:
    """The sensor by whose measurement a new landmark joins the map.

    It is the sensor itself unless one of its measurements leaves a landmark undetermined; such a sensor has
    an attribute ``entry_sensor``, and its streams bring new landmarks as ``Frame.entries``.
    """
    other: SensorModel | None = getattr(sensor, "entry_sensor", None)
    return sensor if other is None else other


def make_sensor(name: str, parameters: Mapping[str, float]) -> SensorModel:
    """The sensor a stored stream names."""
    return cast(SensorModel, sensors.get(name).target(**parameters))
