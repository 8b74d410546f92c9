"""Drawn pictures, their corners, and bits that flip."""

import numpy as np

from slamcmp.grading.results.scoring import as_array
from slamcmp.grading.run.trial import Case
from slamcmp.grading.sandbox.errors import StudentError

KEPT = 60
BITS = 256
PATTERN = np.random.default_rng(0).normal(0, 4, (BITS, 4)).clip(-9, 9).round().astype(int)
"""Pixels to compare around a corner: row and column of the one, row and column of the other."""


def draw(generator, columns, rows, shapes, extent):
    """Grey values in [0, 1] at the given places: soft-edged rectangles, each of its own grey, and noise."""
    middles = generator.uniform([0, 0], extent, (shapes, 2))
    image = 0.3 + 0.2 * columns / extent[0] + 0.1 * rows / extent[1]
    for (x, y), halves, grey in zip(
        middles, generator.uniform(3, 9, (shapes, 2)), generator.uniform(size=shapes), strict=True
    ):
        inside = np.minimum(halves[0] - np.abs(columns - x), halves[1] - np.abs(rows - y))
        share = np.clip(inside + 0.5, 0, 1)
        image = (1 - share) * image + share * grey
    return image + 0.005 * generator.normal(size=image.shape)


def picture(generator):
    """32 to 48 rows and 40 to 64 columns."""
    height, width = int(generator.integers(32, 49)), int(generator.integers(40, 65))
    rows, columns = np.mgrid[:height, :width].astype(float)
    return draw(generator, columns, rows, 8, (width, height))


def pictures(reference, generator):
    return [
        Case((picture(generator), (3, 5)[number % 2], generator.uniform(0.04, 0.06))) for number in range(5)
    ]


def harris_statements(functions, generator):
    image = picture(generator)

    def response(of):
        return as_array(functions.call("harris_response", of, 3, 0.05), of.shape, "the Harris response")

    plain = response(image)
    edge = np.tile(np.linspace(-3, 3, 24).clip(0, 1), (20, 1))
    straight = response(edge)[4:-4, 4:-4]
    turned = relative(response(np.rot90(image)), np.rot90(plain))
    return {
        "turning the picture by 90° turns the response": turned,
        "more light everywhere does not change the response": relative(response(image + 0.3), plain),
        "twice the contrast makes the response 2⁴ times as large": relative(response(2 * image) / 16, plain),
        "on a straight edge the response is nowhere positive": max(0.0, straight.max() / abs(straight).max()),
    }


def crowd(generator, count):
    """Corners (m, 2), the strong ones crowded into a part of the picture, and their responses."""
    crowded = generator.uniform([400, 50], [520, 150], (count // 2, 2))
    spread = generator.uniform([0, 0], [640, 480], (count - count // 2, 2))
    strength = np.concatenate(
        [generator.uniform(0.5, 1.0, count // 2), generator.uniform(0.2, 0.9, len(spread))]
    )
    order = generator.permutation(count)
    return np.concatenate([crowded, spread])[order], strength[order]


def crowds(reference, generator):
    return [Case((*crowd(generator, 80), 10 + number, 0.9)) for number in range(6)]


def flipped(generator, bits, share):
    return bits ^ (generator.uniform(size=bits.shape) < share)


def described(generator, features=40):
    """Descriptors of two pictures: with the same features, with twins of some, and with others.

    No distances are so alike that the answer would hang on rounding or on the order of the features.
    """
    while True:
        bits = generator.uniform(size=(features, BITS)) < 0.5
        first = [flipped(generator, bits, 0.05), flipped(generator, bits[:8], 0.12)]
        second = [flipped(generator, bits[4:], 0.08), flipped(generator, bits[20:28], 0.1)]
        others = generator.uniform(size=(2, 10, BITS)) < 0.5
        first = generator.permutation(np.concatenate([*first, others[0]]))
        second = generator.permutation(np.concatenate([*second, others[1]]))
        ratio = generator.uniform(0.7, 0.85)
        one, two = first.astype(float), second.astype(float)
        distance = one @ (1 - two).T + (1 - one) @ two.T
        closest, after = np.sort(distance, axis=1)[:, :2].T
        columns = np.sort(distance, axis=0)[:, distance.argmin(axis=1)[closest < ratio * after]]
        if np.abs(closest - ratio * after).min() > 1e-3 and (columns[0] < columns[1]).all():
            return first, second, ratio


def descriptions(reference, generator):
    return [Case(described(generator)) for _ in range(5)]


def pictures_to_shrink(reference, generator):
    return [Case((picture(generator), 2)) for _ in range(4)]


def places_in_levels(reference, generator):
    return [Case((generator.uniform(0, 100, (20, 2)), level)) for level in (1, 1, 2, 3)]


def half_the_size(functions, generator):
    """Corners of a picture matched with those of one half as large, as from twice as far away."""
    rows, columns = np.mgrid[:160, :208].astype(float)
    seed = int(generator.integers(1 << 30))
    large, far = (
        draw(np.random.default_rng(seed), columns, rows, 60, (208, 160))
        + 0.005 * generator.normal(size=(160, 208))
        for _ in range(2)
    )
    small = far.reshape(80, 2, 104, 2).mean(axis=(1, 3))
    found, descriptors = [], []
    for image, levels in ((large, 2), (small, 1)):
        images = functions.call("pyramid", image, levels)
        if not isinstance(images, list | tuple) or len(images) != levels:
            raise StudentError("ValueError", f"pyramid has to return a list of {levels} images")
        places, bits = [], []
        for level, given in enumerate([image, *images]):
            shape = (image.shape[0] >> level, image.shape[1] >> level)
            smaller = as_array(given, shape, f"level {level} of pyramid")
            response = functions.call("harris_response", smaller, 5, 0.05)
            xy, strength = maxima(as_array(response, shape, "the Harris response"))
            count = min(KEPT >> level, len(xy))
            kept = as_array(
                functions.call("suppress", xy, strength, count, 0.9), (count,), "the answer of suppress"
            )
            xy = xy[kept.astype(int)]
            there = functions.call("at_full_size", xy, level)
            places.append(as_array(there, (count, 2), "the answer of at_full_size"))
            bits.append(describe(smaller, xy))
        found.append(np.concatenate(places))
        descriptors.append(np.concatenate(bits))
    pairs = np.asarray(functions.call("match", *descriptors, 0.8)).astype(int).reshape(-1, 2)
    expected = 2.0 * (found[1][pairs[:, 1]] + 0.5) - 0.5
    off = np.linalg.norm(found[0][pairs[:, 0]] - expected, axis=1)
    return np.concatenate([np.ravel(found[0]), np.ravel(found[1]), [len(pairs), (off < 3.0).sum()]])


def maxima(response, margin=12, count=150):
    """Places (m, 2) and responses of the strongest local maxima."""
    inner = response[margin:-margin, margin:-margin]
    neighbours = [
        response[margin + down : down - margin, margin + right : right - margin]
        for down in (-1, 0, 1)
        for right in (-1, 0, 1)
        if (down, right) != (0, 0)
    ]
    rows, columns = np.nonzero(inner > np.max(neighbours, axis=0))
    strength = inner[rows, columns]
    order = np.argsort(-strength)[:count]
    return np.stack([columns, rows], axis=1)[order] + float(margin), strength[order]


def describe(image, xy):
    """Which of two pixels near a corner is brighter, 256 times (BRIEF: Calonder et al. 2010)."""
    padded = np.pad(image, 1, mode="edge")
    views = np.lib.stride_tricks.sliding_window_view(padded, (3, 3))
    smooth = views.mean(axis=(2, 3))
    columns, rows = xy.astype(int).T[:, :, None]
    return (
        smooth[rows + PATTERN[:, 0], columns + PATTERN[:, 1]]
        < smooth[rows + PATTERN[:, 2], columns + PATTERN[:, 3]]
    )


def relative(given, wanted):
    return float(np.abs(given - wanted).max() / np.abs(wanted).max())
