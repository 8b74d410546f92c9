"""The course's three figures of the front end for any images, and its table of counts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from slamcmp.report.figures.style import RC, legend_below, line_key, new_figure

if TYPE_CHECKING:
    # It loads OpenCV, which no other figure needs.
    from slamcmp.frontend.vision.image_pair import Features, PairMatches

Image = NDArray[np.uint8]

# From the palette of Okabe and Ito: on grey photographs these two stay apart for every reader.
CORNER = "#E69F00"
KEPT, REJECTED = "#56B4E9", "#D55E00"
_GAP_PX = 12
_PANEL_INCH = 5.2
SAYING = {
    "epipolar": "one epipolar geometry",
    "planar_scene": "a plane: epipolar geometry open, matches judged by a homography",
    "pure_rotation": "a camera that only turned: matches judged by the rotation's homography",
    "plane_or_rotation": "a plane or a pure rotation: matches judged by a homography",
    "no_motion": "no motion between the images",
    "collinear": "points on one line: nothing can be judged",
    "too_few": "fewer than eight distinct matches: nothing can be judged",
    "chance": "no more matches agree than chance explains: nothing can be judged",
    "mirrored": "a mirror image: no camera sees that, nothing can be judged",
    "not_finite": "matches that are not finite: nothing can be judged",
}
"""For each of ``frontend.vision.geometry.degeneracy.Geometry``."""


def draw_front_end(
    names: Sequence[str],
    images: Sequence[Image],
    features: Sequence[Features],
    pairs: Sequence[PairMatches],
    folder: Path,
    *,
    formats: Sequence[str] = ("png",),
) -> list[Path]:
    """Write the three figures for images and the pairs of neighbours among them.

    Args:
        names: of the images.
        images: grey values.
        features: of each image.
        pairs: matches of image i with image i + 1, one fewer than images.
        folder: is made where it does not exist.
        formats: of the files, as matplotlib knows them.

    Returns:
        The files: ``harris_corners``, ``after_suppression`` and, with two images or more, ``matches``.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context(RC):
        figures = {
            "harris_corners": corner_figure(names, images, features, suppressed=False),
            "after_suppression": corner_figure(names, images, features, suppressed=True),
        }
        if pairs:
            figures["matches"] = match_figure(names, images, pairs)
        files = []
        for name, figure in figures.items():
            for kind in formats:
                path = folder / f"{name}.{kind}"
                figure.savefig(
                    path, dpi=130, bbox_inches="tight", metadata={"Date": None} if kind == "svg" else None
                )
                files.append(path)
    return files


def front_end_tables(
    names: Sequence[str], features: Sequence[Features], pairs: Sequence[PairMatches]
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """What each stage let through and took: a row an image, and a row a pair; times in milliseconds."""
    per_image = pd.DataFrame(
        [
            {"image": name, **feature.counts, "time_ms": sum(feature.times_ms.values())}
            for name, feature in zip(names, features, strict=True)
        ]
    )
    per_pair = pd.DataFrame(
        [
            {
                "pair": f"{names[i]} – {names[i + 1]}",
                **pair.counts,
                "geometry": str(pair.verification.geometry),
                "time_ms": sum(pair.times_ms.values()),
            }
            for i, pair in enumerate(pairs)
        ]
    )
    return per_image, per_pair


def corner_figure(
    names: Sequence[str], images: Sequence[Image], features: Sequence[Features], *, suppressed: bool
) -> Figure:
    """Corners before or after suppression, an image a panel."""
    title = "Corners after adaptive suppression" if suppressed else "Harris corners"
    columns = min(len(images), 2)
    figure, grid = _grid(title, images, columns)
    for axes, name, image, feature in zip(grid, names, images, features, strict=False):
        _show(axes, image)
        xy = feature.xy if suppressed else feature.corners.xy
        size = 5.0 if suppressed else 1.6
        axes.plot(
            xy[:, 0], xy[:, 1], "o", color=CORNER, markersize=size, fillstyle="none", markeredgewidth=0.9
        )
        if suppressed:
            said = f"{len(xy)} of {len(feature.corners.xy)} corners,\nspread over what has texture"
        else:
            found = feature.corners.found
            said = f"the {len(xy)} strongest of {found} corners,\ncrowded where texture is strong"
        axes.set_title(f"{name}: {said}")
    return figure


def match_figure(names: Sequence[str], images: Sequence[Image], pairs: Sequence[PairMatches]) -> Figure:
    """Matches of neighbouring images, a pair a panel: what was kept and what was rejected."""
    canvases = [_side_by_side(images[i], images[i + 1]) for i in range(len(pairs))]
    figure, grid = _grid("Matches kept and rejected", canvases, 1)
    for i, (axes, canvas, pair) in enumerate(zip(grid, canvases, pairs, strict=False)):
        _show(axes, canvas)
        ends = np.stack([pair.first, pair.second + np.array([images[i].shape[1] + _GAP_PX, 0.0])], axis=1)
        for mask, colour, width in ((pair.kept, KEPT, 0.7), (~pair.kept, REJECTED, 1.1)):
            style = "-" if colour == KEPT else (0, (4, 2))
            axes.add_collection(
                LineCollection(list(ends[mask]), colors=colour, linewidths=width, linestyles=style)
            )
            dots = ends[mask].reshape(-1, 2)
            axes.plot(dots[:, 0], dots[:, 1], ".", color=colour, markersize=3.0)
        axes.set_title(f"{names[i]} – {names[i + 1]}: {_summary(pair)}")
        left = images[i].shape[1] - 0.5
        axes.axvspan(left, left + _GAP_PX, color="white")
    legend_below(
        figure,
        [line_key("kept", color=KEPT), line_key("rejected", color=REJECTED, linestyle=(0, (4, 2)))],
    )
    return figure


def _summary(pair: PairMatches) -> str:
    counts, said = pair.counts, SAYING[pair.verification.geometry]
    if not counts["kept"]:
        return f"{counts['matches']} matches, none kept\n{said.capitalize()}"
    return (
        f"{counts['matches']} mutual, unambiguous matches, {counts['kept']} kept, "
        f"{counts['rejected']} rejected\nThe kept ones agree on {said}"
    )


def _side_by_side(left: Image, right: Image) -> Image:
    height = max(left.shape[0], right.shape[0])
    canvas = np.full((height, left.shape[1] + _GAP_PX + right.shape[1]), 255, dtype=np.uint8)
    canvas[: left.shape[0], : left.shape[1]] = left
    canvas[: right.shape[0], left.shape[1] + _GAP_PX :] = right
    return canvas


def _grid(title: str, images: Sequence[Image], columns: int) -> tuple[Figure, list[Axes]]:
    rows = -(-len(images) // columns)
    height, width = images[0].shape
    inch = _PANEL_INCH if columns > 1 or width < 1.5 * height else 2 * _PANEL_INCH
    figure = new_figure(columns * inch, rows * (inch * height / width + 0.45) + 0.5, title)
    axes = [figure.add_subplot(rows, columns, i + 1) for i in range(len(images))]
    return figure, axes


def _show(axes: Axes, image: Image) -> None:
    # A little darker than it is, so that the marks stand out in bright skies too.
    axes.imshow(image, cmap="gray", vmin=0, vmax=330, interpolation="nearest")
    axes.set_axis_off()
