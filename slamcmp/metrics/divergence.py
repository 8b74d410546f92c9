"""When a run left what its own covariances allow, and which landmark stood behind it.

NIS and NEES of a consistent run are chi-square distributed (Bar-Shalom, Li and Kirubarajan 2001, sec. 5.4).
NIS is summed over a window of frames, because innovations of different frames are independent; NEES is taken
frame by frame, because errors are not. Each limit is set so that a consistent run passes it *anywhere* with
at most :data:`FALSE_ALARM` probability: the chance is divided by the number of frames (Bonferroni), which
holds however the frames depend on each other.

Back ends keep no innovation of a single landmark. It is worked out again from what is stored: the landmark
is put where its earlier sightings lie when placed with the run's own online poses, the pose is the online
pose before moved by the odometry, and the difference is measured in the noise of the sensor and of this
odometry step alone. So it says where the run contradicts itself, not what its covariance made of it.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, chdtri

from slamcmp.geometry import inverse, local
from slamcmp.metrics.consistency import nees_series, quadratic_forms
from slamcmp.metrics.matching import pose_dimension
from slamcmp.types import FloatArray, GroundTruth, IntArray, MeasurementStream, Run, SensorModel

WINDOW = 10
"""Frames over which NIS is summed, and in which a suspect is looked for."""
FALSE_ALARM = 0.01
"""Probability that a consistent run is said to leave a band."""
FAULTY = 1e-4
"""A deviation with so little probability under its own noise is not taken for chance."""


@dataclass(frozen=True)
class Departure:
    """The first frame at which a run left the band of NIS or NEES."""

    test: str
    """``NIS``, ``NEES`` or ``MAP`` (map_shift.py)."""
    k: int
    value: float
    limit: float
    dof: int
    window: int
    """Frames that ``value`` is summed over."""


@dataclass(frozen=True)
class Suspect:
    """The observation that fits worst with what the run believed before."""

    k: int
    landmark: int
    component: str
    """Name of the part of the measurement that is furthest off, with its unit."""
    residual: float
    """That part of the residual, in the measurement's unit."""
    sigmas: float
    """Mahalanobis distance of the whole residual."""
    measurement_sigmas: float
    """Of the measurement from the truth in its own noise; NaN without truth."""
    odometry_sigmas: float
    """Of this frame's odometry from the truth in its own noise; NaN without truth."""
    stands_out: bool
    """Whether such a distance is more than bad luck."""
    measurement_faulty: bool
    odometry_faulty: bool


def first_departure(run: Run, truth: GroundTruth | None, *, reference: bool = False) -> Departure | None:
    """The first frame that left the band of NIS or NEES, or None for a run that shows no sign of it.

    Only the upper side counts: a value that is too small is a covariance that is too large. Against a
    ``reference`` that is not the truth there is no NEES.
    """
    found = [_nis_departure(run)]
    usable = truth is not None and not reference and bool(np.isfinite(run.online.T_world_body).all())
    if truth is not None and usable and run.online.t.size:
        found.append(_nees_departure(run, truth))
    known = [each for each in found if each is not None]
    return min(known, key=lambda departure: departure.k) if known else None


def find_suspect(
    stream: MeasurementStream, run: Run, truth: GroundTruth | None, last: int, *, window: int = WINDOW
) -> Suspect | None:
    """The observation of a known landmark that fits worst, in the ``window`` frames up to frame ``last``.

    ``last`` may be the frame that the run did not finish. None where no landmark in them was seen before,
    or where the pose before is not finite.
    """
    last = min(last, run.online.t.size, len(stream.frames) - 1)
    first = max(0, last - window + 1)
    of = {landmark for frame in stream.frames[first : last + 1] for landmark in frame.ids.tolist()}
    sightings = _sightings(stream, last, of)
    suspects = [
        found
        for k in range(first, last + 1)
        for found in [_worst_of_frame(stream, run, truth, k, sightings)]
        if found is not None
    ]
    return max(suspects, key=lambda suspect: suspect.sigmas, default=None)


def explain(run: Run, departure: Departure | None, suspect: Suspect | None) -> str:
    """What happened, in sentences that need no knowledge of the tests; empty where nothing did."""
    parts = []
    if departure is not None:
        parts.append(_departure_text(departure, run.online.t[departure.k]))
    elif run.status != "ok" and run.online.t.size:
        parts.append(f"No test gave a warning in the {run.online.t.size} frames that were finished.")
    if suspect is not None:
        parts.append(_suspect_text(suspect))
    return " ".join(parts)


def _nis_departure(run: Run) -> Departure | None:
    nis, dof = run.diagnostics.get("nis"), run.diagnostics.get("nis_dof")
    if nis is None or dof is None or not nis.size:
        return None
    used = np.isfinite(nis) & np.isfinite(dof) & (dof > 0)
    doubted = run.diagnostics.get("downweighted")
    if doubted is not None:
        # The NIS of a robust filter is that of least squares: an outlier that it doubted is not its fault.
        used &= ~(doubted > 0)
    sums, dofs = (_window_sums(np.where(used, series, 0.0)) for series in (nis, dof))
    limits = chdtri(np.maximum(dofs, 1.0), FALSE_ALARM / nis.size)
    outside = np.flatnonzero((dofs > 0) & (sums > limits))
    if not outside.size:
        return None
    k = int(outside[0])
    return Departure("NIS", k, float(sums[k]), float(limits[k]), round(float(dofs[k])), min(WINDOW, k + 1))


def _nees_departure(run: Run, truth: GroundTruth) -> Departure | None:
    values = nees_series(run.online, truth)
    p = pose_dimension(run.online.T_world_body)
    limit = float(chdtri(p, FALSE_ALARM / values.size))
    outside = np.flatnonzero(values > limit)
    return (
        Departure("NEES", int(outside[0]), float(values[outside[0]]), limit, p, 1) if outside.size else None
    )


def _window_sums(series: FloatArray) -> FloatArray:
    """Sum over the last :data:`WINDOW` entries up to each one."""
    total = np.cumsum(series)
    total[WINDOW:] -= total[:-WINDOW].copy()
    return total


@dataclass(frozen=True)
class _Sightings:
    """The measurements that place one landmark, in order."""

    sensor: SensorModel
    k: IntArray
    """(m,)."""
    z: FloatArray
    """(m, d)."""
    R: FloatArray
    """(m, d, d)."""


def _sightings(stream: MeasurementStream, last: int, of: Collection[int]) -> dict[int, _Sightings]:
    """Of each of the landmarks ``of`` what placed it up to frame ``last``.

    A sensor whose measurement places none has its landmarks' entries for that.
    """
    sensor = stream.problem.sensor
    by: SensorModel | None = getattr(sensor, "entry_sensor", None)
    found: dict[int, list[tuple[int, FloatArray, FloatArray]]] = {}
    for frame in stream.frames[: last + 1]:
        seen = frame if by is None else frame.entries
        if seen is not None:
            for row, landmark in enumerate(seen.ids.tolist()):
                if landmark in of:
                    found.setdefault(landmark, []).append((frame.k, seen.z[row], seen.R[row]))
    return {
        landmark: _Sightings(by or sensor, *(np.array(column) for column in zip(*each, strict=True)))
        for landmark, each in found.items()
    }


def _worst_of_frame(
    stream: MeasurementStream,
    run: Run,
    truth: GroundTruth | None,
    k: int,
    sightings: dict[int, _Sightings],
) -> Suspect | None:
    frame, sensor = stream.frames[k], stream.problem.sensor
    before = run.online.T_world_body[k - 1] if k else stream.problem.T_world_body
    predicted = before @ frame.T_prev_body
    if not np.isfinite(predicted).all():
        return None
    worst: tuple[float, int, int, FloatArray, FloatArray] | None = None
    for row, landmark in enumerate(frame.ids.tolist()):
        placed = _place(run, sightings.get(landmark), k)
        if placed is None:
            continue
        position, spread = placed
        by_pose, by_landmark = sensor.jacobians(predicted, position)
        residual = sensor.residual(frame.z[row], sensor.predict(predicted, position))
        noise = frame.R[row] + by_pose @ frame.Q @ by_pose.T + by_landmark @ spread @ by_landmark.T
        distance = math.sqrt(max(0.0, float(quadratic_forms(residual, noise))))
        if math.isfinite(distance) and (worst is None or distance > worst[0]):
            worst = distance, row, landmark, residual, noise
    if worst is None:
        return None
    distance, row, landmark, residual, noise = worst
    part = int(np.argmax(np.abs(residual) / np.sqrt(np.diagonal(noise))))
    measured = _measurement_sigmas(stream, truth, k, row)
    moved = _odometry_sigmas(stream, truth, k)
    return Suspect(
        k,
        landmark,
        sensor.components[part],
        float(residual[part]),
        distance,
        measured,
        moved,
        _improbable(distance, sensor.dim),
        _improbable(measured, sensor.dim),
        _improbable(moved, frame.Q.shape[0]),
    )


def _place(run: Run, seen: _Sightings | None, before: int) -> tuple[FloatArray, FloatArray] | None:
    """Mean of a landmark's sightings before a frame, weighted by the sensor's noise, and its covariance."""
    earlier = 0 if seen is None else int(np.searchsorted(seen.k, before))
    if seen is None or not earlier:
        return None
    T, z, R = run.online.T_world_body[seen.k[:earlier]], seen.z[:earlier], seen.R[:earlier]
    positions = seen.sensor.invert(T, z)
    _, by_landmark = seen.sensor.jacobians(T, positions)
    weights = np.swapaxes(by_landmark, -1, -2) @ np.linalg.solve(R, by_landmark)
    known = np.isfinite(positions).all(axis=-1) & np.isfinite(weights).all(axis=(-1, -2))
    positions, weights = positions[known], weights[known]
    information, total = weights.sum(axis=0), (weights @ positions[..., None])[..., 0].sum(axis=0)
    if not information.any():
        return None
    try:
        covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
    except np.linalg.LinAlgError:
        return None
    return covariance @ total, covariance


def _measurement_sigmas(stream: MeasurementStream, truth: GroundTruth | None, k: int, row: int) -> float:
    frame, sensor = stream.frames[k], stream.problem.sensor
    if truth is None:
        return math.nan
    where = np.flatnonzero(truth.ids == frame.ids[row])
    if not where.size:
        return math.nan
    expected = sensor.predict(truth.T_world_body[k], truth.positions[where[0]])
    return math.sqrt(float(quadratic_forms(sensor.residual(frame.z[row], expected), frame.R[row])))


def _odometry_sigmas(stream: MeasurementStream, truth: GroundTruth | None, k: int) -> float:
    if truth is None or k == 0:
        return math.nan
    moved = inverse(truth.T_world_body[k - 1]) @ truth.T_world_body[k]
    frame = stream.frames[k]
    return math.sqrt(float(quadratic_forms(local(frame.T_prev_body, moved), frame.Q)))


def _improbable(sigmas: float, dof: int) -> bool:
    return math.isfinite(sigmas) and bool(chdtrc(dof, sigmas**2) < FAULTY)


def _departure_text(departure: Departure, t: float) -> str:
    where = f"at frame {departure.k} (t = {t:.6g} s)"
    if departure.test == "NIS":
        return (
            f"The innovations left their band {where}: NIS over {departure.window} frames was "
            f"{departure.value:.4g}, where a consistent run of this length stays below {departure.limit:.4g}."
        )
    if departure.test == "MAP":
        return (
            f"The map shifted {where}: of {departure.dof} sightings in {departure.window} frames "
            f"{departure.value:.0f} lay further from where the run's own earlier poses put their landmarks "
            "than both covariances allow."
        )
    return (
        f"The pose error left its band {where}: NEES was {departure.value:.4g}, where a consistent run of "
        f"this length stays below {departure.limit:.4g}: the covariance promised more than it kept."
    )


def _suspect_text(suspect: Suspect) -> str:
    name, _, unit = suspect.component.rpartition("_")
    size = f"{math.degrees(suspect.residual):.3g}°" if unit == "rad" else f"{suspect.residual:.3g} {unit}"
    where = f"landmark {suspect.landmark} in frame {suspect.k}"
    off = (
        f"its {name or unit} was {size} off the place where the run's own earlier poses put it "
        f"({suspect.sigmas:.3g} σ of sensor and odometry noise)."
    )
    if not suspect.stands_out:
        return (
            f"No single observation stands out; the worst is {where}, {off} "
            "So the error has built up over many frames."
        )
    text = f"Behind it stands {where}: {off}"
    if not math.isfinite(suspect.measurement_sigmas):
        return text
    if suspect.measurement_faulty:
        return (
            f"{text} The measurement itself was wrong, {suspect.measurement_sigmas:.3g} σ from the truth: "
            "an outlier or another landmark."
        )
    fine = f"{text} The measurement itself was right ({suspect.measurement_sigmas:.2g} σ from the truth)"
    if suspect.odometry_faulty:
        return f"{fine}, but the odometry of this frame was {suspect.odometry_sigmas:.3g} σ off."
    return f"{fine}: the run's own poses and map had drifted apart before."
