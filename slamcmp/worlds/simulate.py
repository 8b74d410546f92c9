"""One simulator for every planar world: true controls and landmarks in, a log with its truth out.

Noise is drawn for every frame and every landmark, seen or not, and scaled afterwards: changing a sigma, a
range or one kind of noise leaves every other draw as it was.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from slamcmp.errors import UsageError
from slamcmp.geometry import adjoint_of_inverse, dead_reckoning, exp, se2_coordinates, wrap
from slamcmp.models.motion import Bicycle, MotionModel, StraightThenTurn, Unicycle, WheelEncoders
from slamcmp.models.sensors import make_sensor
from slamcmp.randomness import RandomStreams
from slamcmp.types import BoolArray, Detections, FloatArray, GroundTruth, IntArray, Log, Problem
from slamcmp.types.columns import parts
from slamcmp.types.log import detections_of
from slamcmp.worlds.outliers import OutlierDraws
from slamcmp.worlds.settings import Settings

_POLAR_COLUMNS = {"range_bearing": [0, 1], "range_only": [0], "bearing_only": [1]}
"""Which of range and bearing a sensor reports; the noise that is drawn is the same."""


@dataclass(frozen=True)
class World:
    """What a planar world decides: the true motion and where the landmarks stand."""

    controls: FloatArray
    """(K-1, 2): speed [m/s] and turn rate [rad/s] of each step."""
    landmarks: FloatArray
    """(L, 2) [m]; the robot starts at the origin, looking along x."""


def simulate(name: str, world: World, settings: Settings, streams: RandomStreams) -> Log:
    """Drive through ``world`` and record noisy odometry and detections, with the truth beside them.

    Detections of a frame are sorted by landmark id. ``truth.outliers`` marks the replaced detections.

    Raises:
        UsageError: the controls are not possible for the chosen vehicle.
    """
    prior_noise, step_noise = streams.odometry.spawn(2)
    vehicle = _Vehicle(settings)
    truth_controls = vehicle.controls(world.controls)
    dt = settings.time_step_s
    part = vehicle.model.increment(vehicle.part_of(truth_controls), dt / settings.process_substeps)
    step = part
    for _ in range(settings.process_substeps - 1):
        step = step @ part
    true_increments = np.concatenate([np.eye(3)[None], step])
    poses = dead_reckoning(np.eye(3), true_increments)

    draws = OutlierDraws(settings.outlier_rates(), streams.outliers)
    wheels = truth_controls.copy()
    wheels[:, 0] *= draws.slips(len(wheels))
    increments, covariances = _odometry(vehicle, wheels, settings, step_noise)
    sensor = make_sensor(settings.sensor, {"space_dim": 2} if settings.sensor == "relative_position" else {})
    t: FloatArray = np.arange(settings.steps, dtype=np.float64) * dt
    detections, outliers = _detect(poses, world.landmarks, settings, streams, draws)

    sigmas = settings.noise_scale * np.array(
        [settings.prior_position_sigma_m] * 2 + [settings.prior_heading_sigma_rad]
    )
    prior = exp(-sigmas * prior_noise.standard_normal(3))
    return Log(
        name=name,
        problem=Problem(prior, np.diag(sigmas**2), sensor),
        t=t,
        T_prev_body=increments,
        Q=covariances,
        detections=tuple(detections),
        truth=GroundTruth(t, poses, np.arange(len(world.landmarks)), world.landmarks, tuple(outliers)),
    )


class _Vehicle:
    """The chosen motion model, with its controls and their standard deviations."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        turn = math.radians(settings.turn_sigma_deg_s)
        self.model: MotionModel
        if settings.odometry == "bicycle":
            self.model = Bicycle(wheelbase_m=settings.wheelbase_m)
            sigmas = settings.speed_sigma_m_s, math.radians(settings.steering_sigma_deg)
        elif settings.odometry == "encoders":
            self.model = WheelEncoders(track_width_m=settings.track_width_m)
            sigmas = settings.wheel_sigma_m, settings.wheel_sigma_m
        elif settings.odometry == "unicycle":
            self.model = Unicycle()
            sigmas = settings.speed_sigma_m_s, turn
        elif settings.odometry == "straight_then_turn":
            self.model = StraightThenTurn()
            sigmas = settings.speed_sigma_m_s, turn
        else:
            raise UsageError(
                f"odometry is {settings.odometry!r}; "
                "unicycle, straight_then_turn, bicycle or encoders is needed"
            )
        parts = settings.process_substeps
        # A rate's noise acts for dt / parts, a distance's as it is: both sum to the variance of a whole step.
        share = 1 / math.sqrt(parts) if settings.odometry == "encoders" else math.sqrt(parts)
        self.sigmas = settings.noise_scale * settings.odometry_scale * share * np.array(sigmas)
        """Of the controls of one part of a step."""

    def controls(self, speed_and_turn: FloatArray) -> FloatArray:
        """The model's own controls (K-1, 2) for speed [m/s] and turn rate [rad/s]."""
        speed, turn = speed_and_turn[:, 0], speed_and_turn[:, 1]
        if self._settings.odometry == "bicycle":
            return np.stack([speed, np.arctan(turn * self._settings.wheelbase_m / speed)], axis=-1)
        if self._settings.odometry == "encoders":
            dt, half = self._settings.time_step_s, 0.5 * self._settings.track_width_m
            return np.stack([(speed - turn * half) * dt, (speed + turn * half) * dt], axis=-1)
        return speed_and_turn

    def part_of(self, controls: FloatArray) -> FloatArray:
        """The controls of one of a step's equal parts; rates stay, wheels roll a share of the way."""
        return (
            controls / self._settings.process_substeps if self._settings.odometry == "encoders" else controls
        )


def _odometry(
    vehicle: _Vehicle, controls: FloatArray, settings: Settings, generator: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Noisy increments (K, 3, 3) and their covariances (K, 3, 3) in the body tangent, of what wheels do."""
    steps, parts = len(controls), settings.process_substeps
    part_s = settings.time_step_s / parts
    draws = generator.standard_normal((steps, 3))
    # Drawn last, so that parts leave the other numbers as they are.
    part_draws = [draws[:, :2], *generator.standard_normal((parts - 1, steps, 2))]
    lateral = settings.noise_scale * settings.odometry_scale * settings.lateral_sigma_m
    slip = np.zeros((steps, 3))
    slip[:, 1] = lateral * draws[:, 2]
    increments, covariances = np.tile(np.eye(3), (steps + 1, 1, 1)), np.zeros((steps + 1, 3, 3))
    noisy = np.tile(np.eye(3), (steps, 1, 1))
    for part_draw in reversed(part_draws):
        measured = vehicle.part_of(controls) + vehicle.sigmas * part_draw
        # In the tangent at the end of the step, which the later parts have moved.
        jacobian = adjoint_of_inverse(noisy) @ vehicle.model.jacobian(measured, part_s)
        jacobian = _rounded(jacobian, settings.resolution)
        # Sums of products, one by one, give the same bits on every machine; a matrix product does not.
        for sigma, column in zip(vehicle.sigmas, np.moveaxis(jacobian, -1, 0), strict=True):
            covariances[1:] += sigma**2 * (column[:, :, None] * column[:, None, :])
        noisy = vehicle.model.increment(measured, part_s) @ noisy
    noisy = noisy @ exp(slip)
    covariances[1:, 1, 1] += lateral**2
    for k, (x, y, theta) in enumerate(_rounded(se2_coordinates(noisy), settings.resolution), start=1):
        # math.cos comes from the platform's libm; numpy's own depends on the processor's vector width.
        cos, sin = math.cos(theta), math.sin(theta)
        increments[k] = [[cos, -sin, x], [sin, cos, y], [0.0, 0.0, 1.0]]
    return increments, covariances


def _detect(
    poses: FloatArray,
    landmarks: FloatArray,
    settings: Settings,
    streams: RandomStreams,
    draws: OutlierDraws,
) -> tuple[list[Detections], list[BoolArray]]:
    """Detections of every frame, and which of them are outliers."""
    polar = make_sensor("range_bearing", {})
    is_polar = settings.sensor in _POLAR_COLUMNS
    half_view = math.radians(settings.field_of_view_deg) / 2
    if is_polar:
        sigmas = np.array([settings.range_sigma_m, math.radians(settings.bearing_sigma_deg)])
    else:
        sigmas = np.array([settings.position_sigma_m] * 2)
    sigmas = settings.noise_scale * sigmas
    columns = _POLAR_COLUMNS.get(settings.sensor, [0, 1])
    covariance = np.diag(sigmas[columns] ** 2)
    low = np.array([settings.range_min_m, -half_view])
    high = np.array([settings.range_max_m, half_view])
    of_all = (len(poses), len(landmarks))
    noise = streams.sensor.standard_normal((*of_all, 2))
    luck = streams.outliers.random((*of_all, 3))
    # The same products as pose by pose, to the last bit; what follows looks at points of the body.
    bodies = (landmarks - poses[:, None, :2, 2]) @ poses[:, :2, :2]
    geometry = polar.predict(np.eye(3), bodies)
    seen = np.asarray((geometry >= low).all(axis=-1) & (geometry <= high).all(axis=-1))
    seen[: settings.first_look] = False
    readings = geometry if is_polar else bodies
    wild = luck[..., 0] < settings.outlier_fraction
    spoilt = wild
    if not draws.only_slips:
        of, ghosts, burst = _misfortunes(draws, seen, settings.first_look)
        readings = np.take_along_axis(readings, of[..., None], axis=1)
        seen |= ghosts
        wild |= ghosts | burst[:, None]
        spoilt = wild | (of != np.arange(len(landmarks)))
    readings = readings + sigmas * noise
    if wild.any():
        false = (low + (high - low) * luck[..., 1:])[wild]
        readings[wild] = false if is_polar else polar.invert(np.eye(3), false)
    readings = _rounded(readings, settings.resolution)
    if is_polar:
        readings[..., 1] = wrap(readings[..., 1])
        # A sensor cannot report a range below zero; noise may ask for one very close by.
        seen &= (readings[..., 0] > 0) | (0 not in columns)
    frames, ids = np.nonzero(seen)
    sizes = np.bincount(frames, minlength=len(poses))
    R = np.tile(covariance, (ids.size, 1, 1))
    return detections_of(sizes, readings[seen][:, columns], R, ids), list(parts(spoilt[seen], sizes))


def _misfortunes(
    draws: OutlierDraws, seen: BoolArray, first_look: int
) -> tuple[IntArray, BoolArray, BoolArray]:
    """Which landmark each label's detection is of, (K, L), the ghosts, (K, L), and the bursts, (K,)."""
    of = np.empty(seen.shape, dtype=np.int64)
    ghosts = np.zeros_like(seen)
    burst = np.zeros(len(seen), dtype=bool)
    for k, visible in enumerate(seen):
        of[k] = draws.measured_instead(visible)
        ghosts[k] = draws.ghosts(visible) & (k >= first_look)
        burst[k] = draws.in_burst()
    return of, ghosts, burst


def _rounded(values: FloatArray, resolution: float) -> FloatArray:
    return values if resolution == 0 else np.round(values / resolution) * resolution
