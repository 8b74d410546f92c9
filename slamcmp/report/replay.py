"""A trial as a recording for Rerun: paths, ellipses, landmarks, measurements, images, features and matches.

Two timelines: ``frame`` counts, ``time`` is seconds since the first frame. Worlds in the plane lie at z = 0.
All of a back end is below ``world/LABEL`` and ``plots``, so that the viewer turns it on and off as one.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from slamcmp.errors import DataError, MissingDataError, SlamcmpError, UsageError
from slamcmp.frontend.stream_file import load_stream
from slamcmp.models.camera import Camera
from slamcmp.report.figures.drawable import NotDrawable, typical_trial
from slamcmp.report.figures.frontend.images import measured_pixels
from slamcmp.report.figures.frontend.source_images import log_with_images, source_of_trial
from slamcmp.report.live import LIGHT
from slamcmp.results.grid import has_values, labels, rows_of, trial_name
from slamcmp.results.store import Results
from slamcmp.types import CameraFrame, FloatArray, MeasurementStream

if TYPE_CHECKING:
    import rerun

CHI2_95 = {2: 5.991464547107979, 3: 7.814727903251179}
"""By the dimension of space: within so many squared sigmas lie 95 % (inverse of the chi-square law)."""
TRUTH = (90, 90, 90)
INSTALL = "slamcmp view needs Rerun: pip install 'slamcmp[view]'"


def write_replay(
    results: Results, path: Path, *, trial: int | None = None, back_ends: Sequence[str] | None = None
) -> list[str]:
    """Write one trial as an ``.rrd`` file.

    Args:
        results: of an experiment.
        path: of the file to write.
        trial: default: the one with the median error.
        back_ends: labels; default: all.

    Returns:
        The labels that are in it.

    Raises:
        MissingDataError: Rerun is not installed.
        UsageError: there is no such trial or label.
        DataError: no run of the trial has a pose.
        StorageError: the file cannot be written.
    """
    try:
        import rerun
    except ImportError as error:
        raise MissingDataError(INSTALL) from error
    trial = typical_trial(results) if trial is None else trial
    if trial not in set(results.trials["trial"]):
        raise UsageError(
            f"{results.folder} has no trial {trial}: they are 0 to {results.trials['trial'].max()}"
        )
    unknown = sorted(set(back_ends or ()) - set(labels(results)))
    if unknown:
        raise UsageError(f"{results.folder} has no back end {unknown[0]!r}: {', '.join(labels(results))}")
    shown = [
        label
        for label in labels(results)
        if (back_ends is None or label in back_ends) and len(rows_of(results.frames, trial, label))
    ]
    if not shown:
        raise DataError(f"{trial_name(results, trial)}: no run has a pose to show")
    name = str(results.manifest.get("name", results.folder.name))
    recording = rerun.RecordingStream(
        f"slamcmp {name}", recording_id=f"{name}-{trial}", send_properties=False
    )
    from slamcmp.support.files.atomic import storage_error

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        recording.save(path)
    except (OSError, RuntimeError) as error:
        raise storage_error(path, error if isinstance(error, OSError) else OSError(str(error))) from error
    _Replay(rerun, recording, results, trial).record(shown)
    recording.flush()
    recording.disconnect()
    return shown


class _Replay:
    """Puts one trial into a recording."""

    def __init__(self, module: Any, recording: rerun.RecordingStream, results: Results, trial: int) -> None:
        self._rr, self._recording = module, recording
        self._results, self._trial = results, trial
        digest = str(results.trials.loc[results.trials["trial"] == trial, "digest"].iloc[0])
        self._stream: MeasurementStream | None = None
        with contextlib.suppress(SlamcmpError):
            self._stream = load_stream(results.folder / "streams" / f"{digest}.npz")

    def record(self, shown: Sequence[str]) -> None:
        """Everything that is known of the trial and these back ends."""
        about = [trial_name(self._results, self._trial), str(self._results.manifest.get("question") or "")]
        self._fixed("about", self._rr.TextDocument("\n\n".join(filter(None, about))))
        order = labels(self._results)
        first = rows_of(self._results.frames, self._trial, shown[0]).sort_values("k")
        self._truth(first)
        for label in shown:
            self._back_end(label, _colour(order.index(label)))
        if self._stream is not None:
            self._images(self._stream, first)

    def _truth(self, rows: pd.DataFrame) -> None:
        if has_values(rows, ["true_x"]):
            path = _points(rows, "true")
            self._fixed("world/truth/path", self._rr.LineStrips3D([path], colors=[TRUTH]))
            for k, t, point in zip(rows["k"], _seconds(rows), path, strict=True):
                if np.isfinite(point).all():
                    self._at(int(k), t)
                    self._log("world/truth/now", self._rr.Points3D([point], colors=[TRUTH], radii=[-5.0]))
        marks = self._results.landmarks
        marks = marks[marks["trial"] == self._trial] if len(marks) else marks
        if has_values(marks, ["true_x"]):
            places = _points(marks.drop_duplicates("landmark" if "landmark" in marks else "true_x"), "true")
            self._fixed("world/truth/landmarks", self._rr.Points3D(places, colors=[TRUTH], radii=[-3.0]))

    def _back_end(self, label: str, colour: tuple[int, int, int]) -> None:
        rr = self._rr
        # As parts, which Rerun escapes: a label may hold blanks and slashes.
        entity: list[object] = ["world", label]
        rows = rows_of(self._results.frames, self._trial, label).sort_values("k")
        path = _points(rows, "online")
        self._fixed([*entity, "online"], rr.LineStrips3D([path], colors=[(*colour, 120)]))
        if has_values(rows, ["final_x"]):
            self._fixed([*entity, "final"], rr.LineStrips3D([_points(rows, "final")], colors=[colour]))
        marks = rows_of(self._results.landmarks, self._trial, label)
        if has_values(marks, ["x", "y"]):
            places = _points(marks, "")
            self._fixed([*entity, "landmarks"], rr.Points3D(places, colors=[colour], radii=[-4.0]))
            rings = [
                _ellipse(place, P)
                for place, P in zip(places, _covariances(marks, ""), strict=True)
                if P is not None
            ]
            if rings and len(rings[0]):
                self._fixed([*entity, "landmark ellipses"], rr.LineStrips3D(rings, colors=[colour]))
        covariances = _covariances(rows, "online_")
        headings = rows["online_heading_rad"] if "online_heading_rad" in rows else [None] * len(rows)
        for row, t, place, P, heading in zip(
            rows.to_dict("records"), _seconds(rows), path, covariances, headings, strict=True
        ):
            self._at(int(row["k"]), t)
            self._log([*entity, "now"], rr.Points3D([place], colors=[colour], radii=[-6.0]))
            if P is not None:
                self._log([*entity, "ellipse"], self._region(place, P, colour))
            self._log(
                [*entity, "measured"],
                rr.LineStrips3D(self._rays(int(row["k"]), place, heading), colors=[colour]),
            )
            for column, title in (("online_position_error_m", "error [m]"), ("online_nees", "NEES")):
                value = row.get(column)
                if value is not None and np.isfinite(value):
                    self._log(["plots", title, label], rr.Scalars([value]))

    def _region(self, place: FloatArray, P: FloatArray, colour: tuple[int, int, int]) -> Any:
        if len(P) == 2:
            return self._rr.LineStrips3D([_ellipse(place, P)], colors=[colour])
        values, vectors = np.linalg.eigh(P)
        if np.linalg.det(vectors) < 0:
            vectors[:, 0] *= -1.0
        from slamcmp.geometry import quaternion

        sizes = np.sqrt(CHI2_95[3] * np.clip(values, 0.0, None))
        return self._rr.Ellipsoids3D(
            half_sizes=[sizes], centers=[place], quaternions=[quaternion(vectors)], colors=[colour]
        )

    def _rays(self, k: int, place: FloatArray, heading: float | None) -> list[FloatArray]:
        """From the robot to what it measured at a frame, in the plane."""
        stream = self._stream
        if stream is None or heading is None or not np.isfinite(heading) or k >= len(stream.frames):
            return []
        sensor, frame = stream.problem.sensor, stream.frames[k]
        if stream.problem.T_world_body.shape != (3, 3) or not hasattr(sensor, "invert") or not len(frame.ids):
            return []
        from slamcmp.geometry import se2

        seen = sensor.invert(se2(place[0], place[1], heading), frame.z)
        return [np.array([place, [*each, 0.0]]) for each in seen]

    def _images(self, stream: MeasurementStream, rows: pd.DataFrame) -> None:
        """Images with what was measured in them, and where it was in the image before."""
        try:
            log = log_with_images(source_of_trial(self._results, self._trial))
        except NotDrawable:
            return
        sensor = stream.problem.sensor
        if not isinstance(sensor, Camera):
            return
        before: dict[int, FloatArray] = {}
        seconds = dict(zip(rows["k"].astype(int), _seconds(rows), strict=True))
        for frame, picture in _pictures(stream, log.images or ()):
            if frame.k not in seconds:
                continue
            self._at(frame.k, seconds[frame.k])
            self._log("camera", self._rr.Image(picture))
            places = measured_pixels(frame, sensor)
            pixels = {int(i): place for i, place in zip(frame.ids, places, strict=True)}
            self._log(
                "camera/features",
                self._rr.Points2D(list(pixels.values()), colors=[(230, 120, 20)], radii=[3.0]),
            )
            ways = [np.array([before[i], place]) for i, place in pixels.items() if i in before]
            self._log("camera/matches", self._rr.LineStrips2D(ways, colors=[(60, 160, 230)]))
            before = pixels

    def _at(self, k: int, t: float) -> None:
        self._recording.set_time("frame", sequence=k)
        self._recording.set_time("time", duration=float(t))

    def _log(self, entity: str | list[object], what: Any) -> None:
        self._recording.log(entity, what)

    def _fixed(self, entity: str | list[object], what: Any) -> None:
        self._recording.log(entity, what, static=True)


def _pictures(
    stream: MeasurementStream, images: Sequence[CameraFrame]
) -> Iterator[tuple[Any, np.ndarray[Any, np.dtype[np.uint8]]]]:
    for frame, taken in zip(stream.frames, images, strict=False):
        if taken.image is not None:
            yield frame, taken.image


def _colour(index: int) -> tuple[int, int, int]:
    text = LIGHT[index % len(LIGHT)]
    return int(text[1:3], 16), int(text[3:5], 16), int(text[5:7], 16)


def _seconds(rows: pd.DataFrame) -> FloatArray:
    t: FloatArray = rows["t"].to_numpy(float)
    since: FloatArray = t - t[0]
    return since


def _points(rows: pd.DataFrame, which: str) -> FloatArray:
    """Positions (K, 3) of columns such as ``online_x``."""
    prefix = f"{which}_" if which else ""
    known = [rows[f"{prefix}{axis}"].to_numpy(float) for axis in "xyz" if f"{prefix}{axis}" in rows]
    return np.column_stack([*known, *[np.zeros(len(rows))] * (3 - len(known))])


def _covariances(rows: pd.DataFrame, prefix: str) -> list[FloatArray | None]:
    """Position covariances, (n, n) each, of columns such as ``online_P_xx``; None where there is none."""
    axes = "xyz" if f"{prefix}P_zz" in rows else "xy"
    if f"{prefix}P_xx" not in rows:
        return [None] * len(rows)
    names = [[f"{prefix}P_{''.join(sorted((a, b)))}" for b in axes] for a in axes]
    values = np.array([[rows[name].to_numpy(float) for name in line] for line in names])
    return [P if np.isfinite(P).all() else None for P in np.moveaxis(values, -1, 0)]


def _ellipse(place: FloatArray, P: FloatArray) -> FloatArray:
    """The 95 % ellipse of a planar covariance as a closed line, (33, 3); empty in space."""
    if len(P) != 2:
        return np.empty((0, 3))
    values, vectors = np.linalg.eigh(P)
    angle = np.linspace(0.0, 2.0 * np.pi, 33)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    ring = vectors @ (np.sqrt(CHI2_95[2] * np.clip(values, 0.0, None))[:, None] * circle)
    return np.column_stack([ring.T + place[:2], np.full(33, place[2])])
