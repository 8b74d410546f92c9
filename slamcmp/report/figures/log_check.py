"""What a log looks like before a filter runs on it: gaps, clocks, scales, sightings, errors."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slamcmp.datasets.plain.log_checks import GAP, OUTLIER_SIGMAS, ComponentErrors, Report
from slamcmp.report.figures.style import BAND, MARKERS, PALETTE, RC, TRUTH, new_figure
from slamcmp.support.files.atomic import write_atomically
from slamcmp.types import FloatArray

_BARS = 40
"""Landmarks up to which each has its name under its bar."""


def draw_log_check(report: Report, path: Path) -> None:
    """Draw a log's check into a file of the kind that its name ends in.

    Raises:
        StorageError: the disk is full or the folder cannot be written.
    """
    buffer = io.BytesIO()
    kind = path.suffix.removeprefix(".")
    with matplotlib.rc_context(RC):
        metadata = {"Date": None} if kind == "svg" else None
        log_check_figure(report).savefig(buffer, format=kind, dpi=130, metadata=metadata)
    write_atomically(path, lambda file: file.write(buffer.getvalue()))


def log_check_figure(report: Report) -> Figure:
    """Stamps, offset and scales in the upper row; sightings and each component's errors below."""
    components = list(report.errors.items())
    found = f"{len(report.findings)} findings" if report.findings else "nothing wrong found"
    figure = new_figure(12.0, 6.6, f"Before a filter runs: {found}")
    upper, lower = np.ravel(np.asarray(figure.subfigures(2, 1), dtype=object))
    stamps, offset, speeds, turns = upper.subplots(1, 4)
    _stamps(stamps, report.stamps)
    _against_truth(offset, speeds, turns, report)
    panels = lower.subplots(1, 1 + max(1, len(components)), squeeze=False)[0]
    _sightings(panels[0], report.sightings)
    if not components:
        _nothing(panels[1], "Errors of the detections", "they need truth and landmarks")
    for axes, (name, errors) in zip(panels[1:], components, strict=False):
        _errors(axes, name, errors)
    return figure


def _nothing(axes: Axes, title: str, why: str) -> None:
    axes.set_title(title)
    axes.text(0.5, 0.5, why, ha="center", va="center", transform=axes.transAxes, color="grey")
    axes.set(xticks=[], yticks=[])


def _stamps(axes: Axes, stamps: dict[str, FloatArray]) -> None:
    axes.set(title="Time between rows, × the usual", xlabel="time [s]", yscale="log")
    for k, (name, t) in enumerate(stamps.items()):
        steps = np.diff(t)
        if steps.size:
            shown: Any = {"marker": MARKERS[k % 7], "color": PALETTE[k % 7], "label": name}
            axes.plot(t[1:], steps / np.median(steps), ls="", ms=2.5, **shown)
    axes.axhline(GAP, color=TRUTH, ls=":", label=f"a gap: {GAP:g} ×")
    axes.legend(fontsize=7, loc="upper right")


def _against_truth(offset: Axes, speeds: Axes, turns: Axes, report: Report) -> None:
    against = report.against_truth
    if against is None:
        for axes, title in ((offset, "Clock offset"), (speeds, "Speeds"), (turns, "Yaw rates")):
            _nothing(axes, title, "it needs odometry and\ntruth with time in common")
        return
    clock = against.clock
    if clock.tells:
        offset.set(
            title=f"Clock offset {clock.offset_s:+.2f} s",
            xlabel="offset tried [s]",
            ylabel="1 − correlation, added",
        )
        offset.axvspan(-clock.resolved_s, clock.resolved_s, color=BAND, alpha=0.6, lw=0)
        offset.plot(against.offsets_s, clock.misfit, color=PALETTE[0])
        offset.axvline(clock.offset_s, color=PALETTE[1], ls="--")
    else:
        _nothing(offset, "Clock offset", "speed and yaw rate\nvary too little to tell")
    for axes, title, unit, (own, theirs) in (
        (speeds, "Speeds", "m/s", against.speeds),
        (turns, "Yaw rates", "rad/s", against.turns),
    ):
        scale = float(own @ theirs / (own @ own)) if own.std() > 0 else float("nan")
        axes.set(
            title=f"{title}: truth {scale:.3f} × odometry",
            xlabel=f"odometry [{unit}]",
            ylabel=f"truth [{unit}]",
        )
        axes.plot(own, theirs, ".", ms=1.5, alpha=0.4, color=PALETTE[0], rasterized=True)
        ends = np.array([own.min(), own.max()])
        axes.plot(ends, ends, color=TRUTH, ls=":", label="equal")
        axes.plot(ends, scale * ends, color=PALETTE[1], ls="--", label="fitted scale")
        axes.legend(fontsize=7, loc="upper left")


def _sightings(axes: Axes, sightings: dict[int, int]) -> None:
    if not sightings:
        _nothing(axes, "Detections of each landmark", "no detection has an id")
        return
    axes.set(
        title=f"Detections of each of {len(sightings)} landmarks", xlabel="landmark", ylabel="detections"
    )
    axes.bar(np.arange(len(sightings)), list(sightings.values()), color=PALETTE[0])
    if len(sightings) <= _BARS:
        axes.set_xticks(np.arange(len(sightings)), [str(name) for name in sightings], rotation=90, fontsize=7)
    axes.grid(False, axis="x")


def _errors(axes: Axes, name: str, errors: ComponentErrors) -> None:
    axes.set(
        title=f"{name}: {errors.middle:+.3g} ± {errors.sigma:.3g} {errors.unit}",
        xlabel="time [s]",
        ylabel=f"measured − expected [{errors.unit}]",
    )
    far = np.abs(errors.errors - errors.middle) > OUTLIER_SIGMAS * errors.sigma
    band = np.array([-1.0, 1.0]) * OUTLIER_SIGMAS * errors.sigma + errors.middle
    axes.axhspan(*band, color=BAND, alpha=0.5, lw=0, label=f"{OUTLIER_SIGMAS:g} sigma (robust)")
    axes.plot(errors.t[~far], errors.errors[~far], ".", ms=2, color=PALETTE[0])
    # Far ones would squeeze the others; they stand at the edge, on their side.
    edge = np.clip(errors.errors[far], *(1.3 * (band - errors.middle) + errors.middle))
    axes.plot(errors.t[far], edge, "x", ms=4, color=PALETTE[1], label=f"beyond: {int(far.sum())}")
    axes.axhline(errors.middle, color=TRUTH, lw=1)
    axes.legend(fontsize=7, loc="upper right")
