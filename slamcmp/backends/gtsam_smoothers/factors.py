"""A landmark observation as a GTSAM factor, one way for each kind of sensor.

========  =====================================================================
symbol    meaning
========  =====================================================================
R         covariance of one observation, (d, d)
S         its whitener, S^T S = R^-1
z         one observation, (d,)
q         landmark in the body frame, R_x^T (l - p), (n,)
H         Jacobians that a custom factor fills in for GTSAM
========  =====================================================================
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Protocol

import gtsam
import numpy as np
from gtsam import noiseModel

from slamcmp.backends.entries import Entries, derivatives, errors
from slamcmp.errors import UsageError
from slamcmp.models.camera import Camera, MonoCamera, StereoCamera
from slamcmp.models.sensors import BearingOnly, RangeBearing, RangeOnly, RelativePosition
from slamcmp.types import TANGENT_DIM, FloatArray, Frame, SensorModel

_POSE_KEYS = gtsam.symbol("x", 0)
_LANDMARK_KEYS = gtsam.symbol("l", 0)
_LARGEST_ID = 1 << 50
_CACHED_NOISE_MODELS = 4096

PIN_SIGMA_M = 1e5
"""Of the prior that keeps a landmark determined which has come behind its cameras."""


def pose_key(k: int) -> int:
    """GTSAM's key X(k)."""
    return int(_POSE_KEYS + k)


def landmark_key(landmark_id: int) -> int:
    """GTSAM's key L(id).

    Raises:
        UsageError: the id does not fit into a key.
    """
    if not 0 <= landmark_id <= _LARGEST_ID:
        raise UsageError(f"landmark id {landmark_id}: graph back ends need ids from 0 to 2^50")
    return int(_LANDMARK_KEYS + landmark_id)


class NoiseCache:
    """Noise models by the bytes of their covariance: streams repeat a few, and making one takes time."""

    def __init__(self, make: Callable[[FloatArray], Any]) -> None:
        self._make = make
        self._models: dict[bytes, Any] = {}

    def __call__(self, covariance: FloatArray) -> Any:
        content = covariance.tobytes()
        model = self._models.get(content)
        if model is None:
            if len(self._models) >= _CACHED_NOISE_MODELS:
                self._models.clear()
            model = self._models[content] = self._make(covariance)
        return model


Sights = Frame | Entries
"""What has ids, z and R: a frame's measurements, or the landmarks that enter with it."""


class ObservationFactors(Protocol):
    """How landmarks of one sensor enter the graph."""

    tangent: int
    """Dimension of a landmark variable."""
    position: slice
    """Where in its tangent the position stands."""

    def value(self, position: FloatArray) -> Any:
        """A landmark variable at ``position``."""

    def position_of(self, values: Any, key: int) -> FloatArray:
        """A landmark's position in GTSAM values."""

    def pin(self, key: int, position: FloatArray) -> Any | None:
        """A factor that a landmark variable that starts at ``position`` needs to be determined, or None."""

    def factors(self, key: int, sights: Sights) -> Iterator[Any]:
        """One factor for each observation from the pose ``key``."""


def observation_factors(sensor: SensorModel, wrap: Callable[[Any], Any]) -> ObservationFactors:
    """The fastest exact factors for the sensor; ``wrap`` makes a Gaussian noise model robust."""
    if isinstance(sensor, RangeBearing):
        return _RangeBearingFactors(wrap)
    if isinstance(sensor, RangeOnly):
        return _RangeFactors(wrap)
    if isinstance(sensor, BearingOnly):
        return _BearingFactors(wrap)
    if isinstance(sensor, RelativePosition):
        return _RelativePositionFactors(sensor, wrap)
    if isinstance(sensor, MonoCamera):
        return _PixelFactors(sensor, wrap)
    if isinstance(sensor, StereoCamera):
        return _StereoFactors(sensor, wrap)
    return _AnySensorFactors(sensor, wrap)


class _PointLandmarks:
    def __init__(self, space_dim: int) -> None:
        self._space_dim = space_dim
        self.tangent = space_dim
        self.position = slice(0, space_dim)

    def value(self, position: FloatArray) -> Any:
        return position

    def position_of(self, values: Any, key: int) -> FloatArray:
        point: FloatArray = values.atPoint2(key) if self._space_dim == 2 else values.atPoint3(key)
        return point

    def pin(self, key: int, position: FloatArray) -> Any | None:  # noqa: ARG002
        return None


class _RangeBearingFactors(_PointLandmarks):
    """The built-in planar factor, whose rows are bearing, then range."""

    def __init__(self, wrap: Callable[[Any], Any]) -> None:
        super().__init__(2)
        self._noise = NoiseCache(lambda R: wrap(noiseModel.Gaussian.Covariance(R[::-1, ::-1])))

    def factors(self, key: int, sights: Sights) -> Iterator[Any]:
        noise = self._noise
        for landmark_id, (r, bearing), R in zip(
            sights.ids.tolist(), sights.z.tolist(), sights.R, strict=True
        ):
            yield gtsam.BearingRangeFactor2D(
                key, _LANDMARK_KEYS + landmark_id, gtsam.Rot2(bearing), r, noise(R)
            )


class _RangeFactors(_PointLandmarks):
    """The built-in planar factor of a range."""

    def __init__(self, wrap: Callable[[Any], Any]) -> None:
        super().__init__(2)
        self._noise = NoiseCache(lambda R: wrap(noiseModel.Gaussian.Covariance(R)))

    def factors(self, key: int, sights: Sights) -> Iterator[Any]:
        for landmark_id, (r,), R in zip(sights.ids.tolist(), sights.z.tolist(), sights.R, strict=True):
            yield gtsam.RangeFactor2D(key, _LANDMARK_KEYS + landmark_id, r, self._noise(R))


class _BearingFactors(_PointLandmarks):
    """The built-in planar factor of a bearing."""

    def __init__(self, wrap: Callable[[Any], Any]) -> None:
        super().__init__(2)
        self._noise = NoiseCache(lambda R: wrap(noiseModel.Gaussian.Covariance(R)))

    def factors(self, key: int, sights: Sights) -> Iterator[Any]:
        for landmark_id, (bearing,), R in zip(sights.ids.tolist(), sights.z.tolist(), sights.R, strict=True):
            rotation = gtsam.Rot2(bearing)
            yield gtsam.BearingFactor2D(key, _LANDMARK_KEYS + landmark_id, rotation, self._noise(R))


class _RelativePositionFactors:
    """Whitened q - z from a built-in factor that was made for rotation averaging.

    GTSAM 4.3 has no built-in factor with this residual, and a factor written in Python is far slower.
    ``FrobeniusBetweenFactorNL(L, X, T)`` stacks the columns of ``X^-1 L T - I``. With a landmark variable L
    that is a pose (rotation R_l, position l) and T = (I, -z), the last column is ``q - R_x^T R_l z`` and the
    first n are those of ``R_x^T R_l - I``; hence

        last column + sum_j z_j (column j) = q - z,

    whatever R_l. This sum, whitened, is linear in the stack, so a square-root information matrix with
    further rows of zero makes it the factor's error, to rounding. R_l has no part in it: a prior pins it.
    """

    def __init__(self, sensor: SensorModel, wrap: Callable[[Any], Any]) -> None:
        n = sensor.space_dim
        self.tangent = p = TANGENT_DIM[n]
        self.position = slice(0, 2) if n == 2 else slice(3, 6)
        self._n = n
        self._wrap = wrap
        turns = np.ones(p)
        turns[self.position] = 0.0
        self._pin_noise = noiseModel.Gaussian.SqrtInformation(np.diag(turns), False)
        self._factor = gtsam.FrobeniusBetweenFactorNLPose2 if n == 2 else gtsam.FrobeniusBetweenFactorNLPose3
        self._prior = gtsam.PriorFactorPose2 if n == 2 else gtsam.PriorFactorPose3

    def value(self, position: FloatArray) -> Any:
        if self._n == 2:
            return gtsam.Pose2(position[0], position[1], 0.0)
        return gtsam.Pose3(gtsam.Rot3(), position)

    def position_of(self, values: Any, key: int) -> FloatArray:
        pose = values.atPose2(key) if self._n == 2 else values.atPose3(key)
        position: FloatArray = pose.translation()
        return position

    def pin(self, key: int, position: FloatArray) -> Any | None:  # noqa: ARG002
        return self._prior(key, self.value(np.zeros(self._n)), self._pin_noise)

    def factors(self, key: int, sights: Sights) -> Iterator[Any]:
        n, size = self._n, self._n + 1
        S = np.linalg.inv(np.linalg.cholesky(sights.R))
        whitener = np.zeros((len(S), size * size, size * size))
        for j in range(n):
            whitener[:, :n, size * j : size * j + n] = S * sights.z[:, j, None, None]
        whitener[:, :n, size * n : size * n + n] = S
        for landmark_id, z, rows in zip(sights.ids.tolist(), sights.z, whitener, strict=True):
            model = self._wrap(noiseModel.Gaussian.SqrtInformation(rows, False))
            yield self._factor(_LANDMARK_KEYS + landmark_id, key, self.value(-z), model)


class _CameraFactors(_PointLandmarks):
    """GTSAM's own; a landmark behind the camera gets an error of 2 fx and no Jacobian, not an exception.

    A step may send a landmark of small disparity behind all cameras that saw it, where without a derivative
    the system would be singular. A prior of 100 km, too wide to be told from none, keeps it determined and
    brings it back to where it started.
    """

    def __init__(self, sensor: Camera, wrap: Callable[[Any], Any]) -> None:
        super().__init__(3)
        self._mounting = gtsam.Pose3(sensor.T_body_camera)
        self._pin_noise = noiseModel.Isotropic.Sigma(3, PIN_SIGMA_M)
        self._noise = NoiseCache(lambda R: wrap(noiseModel.Gaussian.Covariance(R)))

    def pin(self, key: int, position: FloatArray) -> Any:
        return gtsam.PriorFactorPoint3(key, position, self._pin_noise)


class _PixelFactors(_CameraFactors):
    def __init__(self, sensor: MonoCamera, wrap: Callable[[Any], Any]) -> None:
        super().__init__(sensor, wrap)
        self._K = gtsam.Cal3_S2(sensor.fx_px, sensor.fy_px, 0.0, sensor.cx_px, sensor.cy_px)

    def factors(self, key: int, sights: Sights) -> Iterator[Any]:
        make, noise, K, mounting = gtsam.GenericProjectionFactorCal3_S2, self._noise, self._K, self._mounting
        for landmark_id, z, R in zip(sights.ids.tolist(), sights.z, sights.R, strict=True):
            yield make(z, noise(R), key, _LANDMARK_KEYS + landmark_id, K, False, False, mounting)


class _StereoFactors(_CameraFactors):
    def __init__(self, sensor: StereoCamera, wrap: Callable[[Any], Any]) -> None:
        super().__init__(sensor, wrap)
        self._K = gtsam.Cal3_S2Stereo(
            sensor.fx_px, sensor.fy_px, 0.0, sensor.cx_px, sensor.cy_px, sensor.baseline_m
        )

    def factors(self, key: int, sights: Sights) -> Iterator[Any]:
        make, noise, K, mounting = gtsam.GenericStereoFactor3D, self._noise, self._K, self._mounting
        for landmark_id, z, R in zip(sights.ids.tolist(), sights.z.tolist(), sights.R, strict=True):
            point = gtsam.StereoPoint2(*z)
            yield make(point, noise(R), key, _LANDMARK_KEYS + landmark_id, K, False, False, mounting)


class _AnySensorFactors(_PointLandmarks):
    """-residual(z, h(T, l)) and its Jacobians from the sensor model itself: slow, for sensors to come."""

    def __init__(self, sensor: SensorModel, wrap: Callable[[Any], Any]) -> None:
        super().__init__(sensor.space_dim)
        self._sensor = sensor
        self._noise = NoiseCache(lambda R: wrap(noiseModel.Gaussian.Covariance(R)))

    def factors(self, key: int, sights: Sights) -> Iterator[Any]:
        for landmark_id, z, R in zip(sights.ids.tolist(), sights.z, sights.R, strict=True):
            keys = [key, _LANDMARK_KEYS + landmark_id]
            yield gtsam.CustomFactor(self._noise(R), keys, self._error(keys[0], keys[1], z))

    def _error(self, key: int, landmark: int, z: FloatArray) -> Callable[[Any, Any, Any], FloatArray]:
        sensor, n = self._sensor, self._space_dim
        shapes = ((sensor.dim, TANGENT_DIM[n]), (sensor.dim, n))

        def error(_factor: Any, values: Any, H: Any) -> FloatArray:
            T = (values.atPose2(key) if n == 2 else values.atPose3(key)).matrix()
            point = self.position_of(values, landmark)
            if H is not None:
                for i, (jacobian, shape) in enumerate(
                    zip(derivatives(sensor, T, point), shapes, strict=True)
                ):
                    # A wrong shape would crash the process inside GTSAM.
                    if jacobian.shape != shape:
                        raise UsageError(
                            f"sensor {sensor.name!r}: Jacobian {i} has shape {jacobian.shape}, not {shape}"
                        )
                    H[i] = jacobian
            return errors(sensor, T, point, z)

        return error
