"""Some images of an experiment, with what the front end found and measured in them.

Drawn from the stored stream and from the images, which the source delivers again: a results folder does not
hold them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from slamcmp.errors import SlamcmpError
from slamcmp.experiment.job.task import stream_path
from slamcmp.frontend.stream_file import load_stream
from slamcmp.models.camera import Camera, StereoCamera
from slamcmp.registry import figures
from slamcmp.report.figures import style
from slamcmp.report.figures.drawable import NotDrawable
from slamcmp.report.figures.frontend.source_images import (
    TrialSource,
    log_with_images,
    source_of_typical_trial,
)
from slamcmp.results.runs.run_file import StoredTruth
from slamcmp.results.runs.streams import known_streams
from slamcmp.results.store import Results
from slamcmp.types import FloatArray, Frame, Log, MeasurementStream
from slamcmp.types.stream import EVENT, PASSED, PASSED_RIGHT, RIGHT

COUNT = 4
"""Images shown."""
_CORNER = "#E69F00"
_COLOURS = "cool"
"""From cyan near by to magenta far away: both are bright enough for a grey image."""
_STREAMS_MAX = 30
"""Rows of the table."""
_NOT_SKIPPED = "no epipolar test"
"""How events begin that skipped a test and not the frame."""


@dataclass(frozen=True)
class Shown:
    """One image and what the stream has of it."""

    k: int
    image: NDArray[np.uint8]
    corners: FloatArray
    """(n, 2) [px], found again."""
    pixels: FloatArray
    """(m, 2) [px], measured."""
    before: FloatArray
    """(m, 2) [px] where the same landmarks were measured in the frame before; NaN where they were not."""
    depth_m: FloatArray
    """(m,); NaN where a single camera measures none."""


def stream_table(results: Results) -> pd.DataFrame:
    """A row a stream: images, skipped ones with their reasons, points, precision and recall by the truth."""
    known = known_streams(results.folder)
    digests = results.trials.drop_duplicates("digest").set_index("digest")["trial"]
    rows = []
    for digest, trial in list(digests.items())[:_STREAMS_MAX]:
        if str(digest) in known:
            rows.append({"trial": trial, **_row(known[str(digest)])})
    return pd.DataFrame(rows)


def frame_panels(results: Results) -> list[Figure]:
    """Each image as a figure of its own: small ones stay readable on a narrow page."""
    shown, _ = _gathered(results)
    norm = _norm(shown)
    panels: list[Figure] = []
    for each in shown:
        height, width = each.image.shape
        below = 0.4 if norm is None else 0.85
        figure = style.new_figure(4.6, 4.6 * height / width + below, _title(each).capitalize())
        axes = figure.add_subplot()
        _draw(axes, each, norm)
        axes.set_title("")
        if norm is not None:
            _depth_bar(figure, [axes], norm)
        panels.append(figure)
    return panels


@figures.register(
    "images",
    title="Images",
    needs=("streams and the source's images",),
    caption=(
        "Some images of one typical trial. Small orange points: corners found. Circles: points measured, "
        "coloured by their depth where the camera tells it; the line leads to where the same landmark was "
        "in the image before. In the table, what each stream made of its images: how many were skipped and "
        "why, and where the truth is known precision (right among the matches that passed all tests) and "
        "recall (passed among the right matches)."
    ),
    table=stream_table,
    panels=frame_panels,
)
def plot_images(results: Results) -> Figure:
    """Corners, measured points with their depth, and their way since the image before."""
    shown, title = _gathered(results)
    norm = _norm(shown)
    height, width = shown[0].image.shape
    columns = 1 if width > 2.2 * height else 2
    rows = -(-len(shown) // columns)
    panel = 10.0 / columns
    figure = style.new_figure(10.0, rows * (panel * height / width + 0.4) + 1.2, f"Images: {title}")
    grid = [figure.add_subplot(rows, columns, i + 1) for i in range(len(shown))]
    for axes, each in zip(grid, shown, strict=True):
        _draw(axes, each, norm)
    if norm is not None:
        _depth_bar(figure, grid, norm)
    return figure


def _gathered(results: Results) -> tuple[list[Shown], str]:
    """The images to show and the trial's name.

    Raises:
        NotDrawable: the experiment has no images, or they are not there any more.
    """
    found = source_of_typical_trial(results)
    return _read(stream_path(results.folder, found.digest), found), found.title


_remembered: tuple[object, list[Shown]] | None = None
"""The last trial's images: a page shows them twice."""


def _read(stored: Path, found: TrialSource) -> list[Shown]:
    global _remembered
    key = stored, repr(found)
    if _remembered is None or _remembered[0] != key:
        _remembered = key, _read_again(stored, found)
    return _remembered[1]


def _read_again(stored: Path, found: TrialSource) -> list[Shown]:
    log = log_with_images(found)
    try:
        stream = load_stream(stored)
    except SlamcmpError as error:
        raise NotDrawable(f"the stream is not there any more: {error}") from error
    assert log.images is not None
    if len(log.images) != len(stream.frames):
        raise NotDrawable("the source delivers other images than it did")
    shown = [each for k in _spread(stream) if (each := _shown(stream, log, k)) is not None]
    if not shown:
        raise NotDrawable("not one image could be used")
    return shown


def _spread(stream: MeasurementStream) -> list[int]:
    """Frames spread over the stream, of those that have measurements, if any has."""
    seen = [frame.k for frame in stream.frames if frame.ids.size] or [frame.k for frame in stream.frames]
    places = (np.arange(COUNT) + 0.5) / COUNT * len(seen)
    return list(dict.fromkeys(seen[int(place)] for place in places))


def _shown(stream: MeasurementStream, log: Log, k: int) -> Shown | None:
    # OpenCV is loaded for experiments with images only.
    from slamcmp.frontend.vision.image_pair import extract_features

    assert log.images is not None
    image = log.images[k].image
    sensor = stream.problem.sensor
    if image is None or not isinstance(sensor, Camera):
        return None
    frame = stream.frames[k]
    pixels = measured_pixels(frame, sensor)
    before = np.full(pixels.shape, np.nan)
    if k:
        last = stream.frames[k - 1]
        _, here, there = np.intersect1d(frame.ids, last.ids, return_indices=True)
        before[here] = measured_pixels(last, sensor)[there]
    return Shown(k, image, extract_features(image).xy, pixels, before, _depths(frame, sensor))


def _depths(frame: Frame, sensor: Camera) -> FloatArray:
    return sensor.depths(frame.z) if isinstance(sensor, StereoCamera) else np.full(len(frame.z), np.nan)


def measured_pixels(frame: Frame, sensor: Camera) -> FloatArray:
    """Where a frame's landmarks were measured in the (left) image, (m, 2) [px]."""
    return frame.z[:, [0, 2]] if isinstance(sensor, StereoCamera) else frame.z[:, :2]


def _norm(shown: Sequence[Shown]) -> LogNorm | None:
    """One scale of depth for all images."""
    depth = np.concatenate([each.depth_m for each in shown])
    depth = depth[np.isfinite(depth)]
    if not depth.size:
        return None
    low, high = np.percentile(depth, [2, 98])
    return LogNorm(max(float(low), 1e-3), max(float(high), 1.01 * float(low)))


def _draw(axes: Axes, shown: Shown, norm: LogNorm | None) -> None:
    # A little darker than it is, so that the marks stand out in bright skies too.
    axes.imshow(shown.image, cmap="gray", vmin=0, vmax=330, interpolation="antialiased")
    axes.plot(shown.corners[:, 0], shown.corners[:, 1], ".", color=_CORNER, markersize=1.8, alpha=0.8)
    if norm is None:
        colours: Any = np.tile(np.array([[0x56, 0xB4, 0xE9, 0xFF]]) / 255.0, (len(shown.pixels), 1))
    else:
        colours = ScalarMappable(norm, _COLOURS).to_rgba(shown.depth_m)
    known = np.isfinite(shown.before[:, 0])
    ways = np.stack([shown.before[known], shown.pixels[known]], axis=1)
    axes.add_collection(LineCollection(list(ways), colors=colours[known], linewidths=1.3))
    axes.scatter(
        shown.pixels[:, 0], shown.pixels[:, 1], s=18, facecolors="none", edgecolors=colours, linewidths=1.2
    )
    axes.set_axis_off()
    axes.set_xlim(-0.5, shown.image.shape[1] - 0.5)
    axes.set_ylim(shown.image.shape[0] - 0.5, -0.5)
    axes.set_title(_title(shown))


def _title(shown: Shown) -> str:
    return f"image {shown.k}: {len(shown.corners)} corners, {len(shown.pixels)} measured"


def _depth_bar(figure: Figure, axes: Sequence[Axes], norm: LogNorm) -> None:
    bar = figure.colorbar(
        ScalarMappable(norm, _COLOURS), ax=list(axes), orientation="horizontal", aspect=40, pad=0.02
    )
    style.log_axis(bar.ax, "x")
    bar.set_label("depth [m]")


def _row(known: StoredTruth) -> dict[str, object]:
    totals = known.front_end
    skipped = {
        name.removeprefix(EVENT): count
        for name, count in totals.items()
        if name.startswith(EVENT) and not name.removeprefix(EVENT).startswith(_NOT_SKIPPED)
    }
    used = max(known.frames - sum(skipped.values()), 1)
    row: dict[str, object] = {
        "images": known.frames,
        "skipped": "; ".join(f"{count}: {reason}" for reason, count in skipped.items()) or "none",
        "corners an image": totals.get("raw", 0) / used,
        "measured an image": totals.get("kept", 0) / used,
    }
    if RIGHT in totals:
        passed, right = totals[PASSED], totals[RIGHT]
        row["precision [%]"] = 100.0 * totals[PASSED_RIGHT] / passed if passed else float("nan")
        row["recall [%]"] = 100.0 * totals[PASSED_RIGHT] / right if right else float("nan")
    return row
