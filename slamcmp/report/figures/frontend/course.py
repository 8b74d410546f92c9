"""The lecture's figures of the front end, drawn from two images of an experiment's typical trial.

They are drawn where an experiment or a command names them: each shows one stage, for a slide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from slamcmp.registry import figures
from slamcmp.report.figures import style
from slamcmp.report.figures.drawable import NotDrawable
from slamcmp.report.figures.frontend.front_end import corner_figure, match_figure
from slamcmp.report.figures.frontend.source_images import log_with_images, source_of_typical_trial
from slamcmp.results.store import Results
from slamcmp.types import BoolArray, FloatArray

if TYPE_CHECKING:
    # It loads OpenCV, which the figures of other experiments do not need.
    from slamcmp.frontend.vision.image_pair import Features, PairMatches

APART = 4
"""Frames between the two images: far enough for the matches to have a way to go."""
WRONG_SHARES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)
"""Of the matches, made wrong."""
DRAWS = 8
"""For each share: which matches are made wrong, and what RANSAC samples."""
_METHODS = {"least_squares": "least squares", "ransac": "RANSAC"}


@dataclass(frozen=True)
class Pair:
    """Two images, and what the stages make of them."""

    names: tuple[str, str]
    images: tuple[NDArray[np.uint8], NDArray[np.uint8]]
    features: tuple[Features, Features]
    matches: PairMatches


@figures.register(
    "harris_corners",
    title="Harris corners",
    needs=("the source's images",),
    on_request=True,
    caption="The strongest Harris corners of two images, before anything is left out.",
)
def plot_harris_corners(results: Results) -> Figure:
    """The strongest corners of two images, before suppression."""
    pair = _pair(results, suppression="none")
    return corner_figure(pair.names, pair.images, pair.features, suppressed=False)


@figures.register(
    "after_suppression",
    title="Corners after adaptive suppression",
    needs=("the source's images",),
    on_request=True,
    caption="The same images: of the same corners those that adaptive non-maximal suppression keeps.",
)
def plot_after_suppression(results: Results) -> Figure:
    """Of the same corners those that adaptive non-maximal suppression keeps."""
    pair = _pair(results)
    return corner_figure(pair.names, pair.images, pair.features, suppressed=True)


@figures.register(
    "matches",
    title="Matches kept and rejected",
    needs=("the source's images",),
    on_request=True,
    caption=(
        "ORB descriptors of two images matched where the choice is mutual and clear. Solid: matches that "
        "agree on one epipolar geometry; dashed: the rejected ones."
    ),
)
def plot_matches(results: Results) -> Figure:
    """Matches of two images, kept and rejected by the epipolar test."""
    pair = _pair(results)
    return match_figure(pair.names, pair.images, [pair.matches])


@figures.register(
    "ransac",
    title="RANSAC and least squares",
    needs=("the source's images",),
    on_request=True,
    caption=(
        "The matches between two images, of which a share exchanged their partners and so are wrong. Left: "
        "how far the right ones lie from the fundamental matrix, fitted to all matches at once and by RANSAC "
        "on minimal sets of eight (median Sampson distance; line and band: median and range of the draws). "
        "Right: the share of the right matches that each keeps."
    ),
)
def plot_ransac(results: Results) -> Figure:
    """How a growing share of wrong matches bends least squares, and not RANSAC."""
    pair = _pair(results)
    right: BoolArray = pair.matches.kept
    if right.sum() < 30:
        raise NotDrawable(f"only {int(right.sum())} right matches between two images, 30 are needed")
    first, second = pair.matches.first[right], pair.matches.second[right]
    figure = style.new_figure(9.5, 3.9, f"RANSAC and least squares: {len(first)} matches of two images")
    distance, kept = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2)
    for i, (method, label) in enumerate(_METHODS.items()):
        of_distance, of_kept = contaminated(first, second, method)
        for axes, values in ((distance, of_distance), (kept, 100.0 * of_kept)):
            _curve(axes, values, label, i)
    distance.set_yscale("log")
    style.log_axis(distance, "y")
    distance.set_title("distance of the right matches from the fit [px]")
    kept.set_title("right matches kept [%]")
    kept.set_ylim(-3, 103)
    for axes in (distance, kept):
        axes.set_xlabel("wrong matches [%]")
    keys = [
        style.line_key(label, color=style.PALETTE[i], marker=style.MARKERS[i])
        for i, label in enumerate(_METHODS.values())
    ]
    style.legend_below(figure, keys)
    return figure


def contaminated(
    first: FloatArray,
    second: FloatArray,
    method: str,
    shares: Sequence[float] = WRONG_SHARES,
    draws: int = DRAWS,
) -> tuple[FloatArray, FloatArray]:
    """How a fit suffers when matches are made wrong by exchanging their partners.

    Args:
        first: right matches in one image, (m, 2) [px].
        second: in the other, (m, 2) [px].
        method: ``least_squares`` or ``ransac``.
        shares: of the matches that are made wrong.
        draws: for each share.

    Returns:
        For each share and draw, (shares, draws): the median Sampson distance [px] of the right
        matches from the fit, infinite without one, and the share of them that is within its threshold.
    """
    from slamcmp.frontend.vision.geometry import fundamental

    distance = np.full((len(shares), draws), np.inf)
    kept = np.zeros_like(distance)
    for i, share in enumerate(shares):
        for draw in range(draws):
            generator = np.random.default_rng((draw, i))
            wrong = exchanged(len(first), share, generator)
            spoilt, right = second[wrong], wrong == np.arange(len(first))
            if method == "ransac":
                fit = fundamental.ransac(first, spoilt, generator)
            else:
                fit = fundamental.least_squares(first, spoilt)
            kept[i, draw] = fit.inliers[right].mean()
            if fit.F is not None:
                of_right = fundamental.sampson_distance(fit.F, first[right], second[right])
                distance[i, draw] = np.median(of_right)
    return distance, kept


def exchanged(count: int, share: float, generator: np.random.Generator) -> NDArray[np.int64]:
    """Whose partner each match gets, (count,): a share of them pass theirs on in a circle."""
    partner = np.arange(count)
    chosen = generator.permutation(count)[: round(share * count)]
    if len(chosen) > 1:
        partner[chosen] = np.roll(chosen, 1)
    return partner


def _curve(axes: Axes, values: FloatArray, label: str, i: int) -> None:
    shares = 100.0 * np.array(WRONG_SHARES)
    finite = np.where(np.isfinite(values), values, np.nan)
    low, middle, high = np.nanquantile(finite, [0.0, 0.5, 1.0], axis=1)
    axes.fill_between(shares, low, high, color=style.PALETTE[i], alpha=0.2, linewidth=0)
    axes.plot(shares, middle, color=style.PALETTE[i], marker=style.MARKERS[i], label=label)


def _pair(results: Results, suppression: str = "cells") -> Pair:
    """Two images from the middle of the typical trial.

    Raises:
        NotDrawable: the experiment has no images, or too few.
    """
    # OpenCV is loaded for experiments with images only.
    from slamcmp.frontend.vision.image_pair import extract_features, match_features

    images = log_with_images(source_of_typical_trial(results)).images
    assert images is not None
    middle = max(0, len(images) // 2 - APART // 2)
    frames = (middle, min(middle + APART, len(images) - 1))
    one, two = (images[k].image for k in frames)
    if one is None or two is None or frames[0] == frames[1]:
        raise NotDrawable("two images are needed, and one of them is missing")
    features = tuple(extract_features(image, suppression=suppression) for image in (one, two))  # type: ignore[arg-type]
    matches = match_features(features[0], features[1], seed=0)
    return Pair((f"image {frames[0]}", f"image {frames[1]}"), (one, two), (features[0], features[1]), matches)
