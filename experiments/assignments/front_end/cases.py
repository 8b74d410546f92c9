"""Data of the front end's tests: drawn pictures, bits that flip, and matches of a scene seen twice."""

import numpy as np

from slamcmp.geometry import exp, hat, inverse, transform
from slamcmp.grading.results.scoring import as_array
from slamcmp.grading.run.trial import Case, Track
from slamcmp.grading.sandbox.errors import StudentError

CAMERA = np.array([[400.0, 0.0, 320.0], [0.0, 400.0, 240.0], [0.0, 0.0, 1.0]])
WRONG_PX = 20.0
"""Wrong matches of the exact tests are at least so far from obeying the true F."""
THRESHOLD_PX = 1.0
KEPT = 60
BOUNDS = np.array([3.841, 5.991, 7.815])
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


def moved(generator):
    """Pose of the second camera in the first one's frame, and the true F."""
    T = exp(np.concatenate([generator.normal(size=3) * 0.04, np.zeros(3)]))
    T[:3, 3] = [generator.uniform(0.4, 0.7) * generator.choice([-1, 1]), *generator.uniform(-0.15, 0.15, 2)]
    T_2_1 = inverse(T)
    K_inv = np.linalg.inv(CAMERA)
    return T_2_1, K_inv.T @ hat(T_2_1[:3, 3]) @ T_2_1[:3, :3] @ K_inv


def seen_twice(generator, T_2_1, count):
    """Pixels (count, 2) in both pictures of points 3 to 9 m away, without noise."""
    first = generator.uniform([20, 20], [620, 460], (count, 2))
    rays = np.column_stack([(first - CAMERA[:2, 2]) / 400.0, np.ones(count)])
    seen = transform(T_2_1, rays * generator.uniform(3.0, 9.0, count)[:, None]) @ CAMERA.T
    return first, seen[:, :2] / seen[:, 2:]


def distances(F, first, second):
    """Sampson's, as the tests measure it."""
    one, two = (np.column_stack([points, np.ones(len(points))]) for points in (first, second))
    lines_2, lines_1 = one @ F.T, two @ F
    slope = np.sqrt((lines_2[:, :2] ** 2).sum(axis=1) + (lines_1[:, :2] ** 2).sum(axis=1))
    return np.abs((two * lines_2).sum(axis=1)) / slope


def matches(generator, count, wrong, noise_px, wrong_px=0.0):
    """Matched pixels of a new scene in any order, a share of them wrong, and what is true of it."""
    T_2_1, F = moved(generator)
    first, second = seen_twice(generator, T_2_1, count)
    bad = round(wrong * count)
    for index in range(bad):
        while True:
            second[index] = generator.uniform([0, 0], [640, 480])
            if distances(F, first[index][None], second[index][None])[0] > wrong_px:
                break
    order = generator.permutation(count)
    first, second = (points + noise_px * generator.normal(size=(count, 2)) for points in (first, second))
    return first[order], second[order], T_2_1, F


def right_matches(reference, generator):
    return [Case(matches(generator, count, 0.0, 0.5)[:2]) for count in (12, 20, 40, 80, 80)]


def scenes(reference, generator):
    cases = []
    for number in range(5):
        first, second, _, F = matches(generator, 40, 0.3, 0.5)
        cases.append(Case((F * 10.0**number, first, second)))
    return cases


def epipolar_statements(functions, generator):
    first, second, _, _ = matches(generator, 50, 0.0, 0.5)

    def least_squares(one, two):
        return as_array(functions.call("fundamental_least_squares", one, two), (3, 3), "F")

    def distance(F, one, two):
        return as_array(functions.call("sampson_distance", F, one, two), (len(one),), "the distance")

    F = least_squares(first, second)
    order = generator.permutation(50)
    half, shift = np.diag([0.5, 0.5, 1.0]), np.array([60.0, -40.0])
    half[:2, 2] = 0.5 * shift
    plain = distance(F, first, second)
    return {
        "the pictures in the other order give the transpose of F": apart(least_squares(second, first).T, F),
        "the order of the matches does not change F": apart(least_squares(first[order], second[order]), F),
        "measured from another corner and in other pixels, F is the same F": apart(
            half.T @ least_squares(first, 0.5 * (second + shift)), F
        ),
        "F has rank 2": np.linalg.svd(F)[1][2] / np.linalg.norm(F) * 1e4,
        "the distance does not depend on the scale and sign of F": relative(
            distance(-3.0 * F, first, second), plain
        ),
        "the distance is the same for the pictures in the other order": relative(
            distance(F.T, second, first), plain
        ),
    }


def apart(F, G):
    """How far two matrices differ if neither's scale counts."""
    F, G = F / np.linalg.norm(F), G / np.linalg.norm(G)
    return float(min(np.abs(F - G).max(), np.abs(F + G).max()) / np.abs(G).max())


def relative(given, wanted):
    return float(np.abs(given - wanted).max() / np.abs(wanted).max())


def shares(reference, generator):
    cases = [Case((share, confidence)) for share in (0.3, 0.5, 0.8) for confidence in (0.9, 0.999)]
    cases += [Case((generator.uniform(0.3, 0.9), 0.99)) for _ in range(4)]
    return [*cases, Case((1.0, 0.99), "the case without any outlier")]


def outlier_scenes(reference, generator):
    """So far apart are right and wrong here that every RANSAC ends at the same F, whatever it draws."""
    cases = []
    for _ in range(4):
        first, second, _, _ = matches(generator, 90, 0.25, 0.1, WRONG_PX)
        seed = int(generator.integers(1 << 30))
        cases.append(Case((first, second, THRESHOLD_PX, 0.9999, 400, seed)))
    return cases


def robust(functions, generator, first, second, *, threshold_px=THRESHOLD_PX, samples_max=400):
    arguments = (threshold_px, 0.999, samples_max, int(generator.integers(1 << 30)))
    answer = functions.call("ransac_fundamental", first, second, *arguments)
    if not isinstance(answer, list | tuple) or len(answer) != 2:
        raise StudentError("TypeError", "ransac_fundamental has to return two things, F and the inliers")
    F, inliers = answer
    F = as_array(F, (3, 3), "F of ransac_fundamental")
    return F, as_array(inliers, (len(first),), "the inliers of ransac_fundamental") > 0.5


def ransac_statements(functions, generator):
    first, second, _, _ = matches(generator, 90, 0.3, 0.1, WRONG_PX)
    F, inliers = robust(functions, generator, first, second)
    again = functions.call("fundamental_least_squares", first[inliers], second[inliers])
    distance = functions.call("sampson_distance", F, first, second)
    within = as_array(distance, (90,), "the distance") <= THRESHOLD_PX
    return {
        "the F of RANSAC is the least-squares fit to the matches that it calls inliers": apart(
            as_array(again, (3, 3), "F"), F
        ),
        "the inliers of RANSAC are the matches within the threshold of its F": float(
            np.mean(within != inliers)
        ),
    }


def bent(functions, generator):
    """Error of the least-squares fit with one wrong match among sixty."""
    first, second, T_2_1, F = matches(generator, 59, 0.0, 0.2)
    while True:
        places = generator.uniform([20, 20], [620, 460], (2, 1, 2))
        if distances(F, *places)[0] > 60:
            break
    given = (np.vstack([first, places[0]]), np.vstack([second, places[1]]))
    answer = as_array(functions.call("fundamental_least_squares", *given), (3, 3), "F")
    return rms(distances(answer, *seen_twice(generator, T_2_1, 100)))


def majority(functions, generator):
    """Distance of the still background from the F that follows a large moving object."""
    first, second, _, F = matches(generator, 80, 0.0, 0.1)
    while True:
        still, _ = moved(generator)
        background = seen_twice(generator, still, 500)
        away = np.flatnonzero(distances(F, *background) > WRONG_PX)[:25]
        if len(away) == 25:
            break
    background = [points[away] for points in background]
    both = (np.vstack([first, background[0]]), np.vstack([second, background[1]]))
    answer, _ = robust(functions, generator, *both)
    return rms(distances(answer, *background))


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def predicted_observations(reference, generator):
    """Of one, two and three components, just inside and just outside of the bound, and far from it."""
    cases = []
    for number in range(15):
        # 3 and 5 have no common divisor: every size meets every share.
        size = 1 + number % 3
        half = generator.uniform(1, 5, (size, 1)) * generator.normal(size=(size, size))
        S = half @ half.T + np.eye(size)
        direction = generator.normal(size=size)
        direction /= np.sqrt(direction @ np.linalg.solve(S, direction))
        share = (0.35, 0.6, 0.9, 1.1, 2.5)[number % 5]
        z = generator.uniform(0, 300, size)
        cases.append(Case((z + direction * np.sqrt(share * BOUNDS[size - 1]), z, S)))
    return cases


def two_pictures(functions, generator):
    """The whole chain: from two drawn pictures to F. Local maxima and descriptors are ours."""
    rows, columns = np.mgrid[:96, :128].astype(float)
    place = np.stack([columns, rows], axis=-1)
    step = np.array([0.45, 0.08, 0.2])
    phase = generator.uniform(0, 2 * np.pi, 2)

    def in_second(seen):
        depth = 4.5 + 1.2 * np.sin(seen[..., 0] / 16 + phase[0]) + 0.8 * np.sin(seen[..., 1] / 12 + phase[1])
        body = np.concatenate([(seen - [64, 48]) / 110, np.ones((*seen.shape[:-1], 1))], axis=-1)
        body = body * depth[..., None] - step
        return 110 * body[..., :2] / body[..., 2:] + [64, 48]

    # What the second camera sees at a place is where the first one saw it.
    source = place.copy()
    for _ in range(40):
        source += place - in_second(source)
    seed = int(generator.integers(1 << 30))
    found, descriptors = [], []
    for seen in (place, source):
        image = draw(np.random.default_rng(seed), *np.moveaxis(seen, -1, 0), 50, (128, 96))
        response = functions.call("harris_response", image, 5, 0.05)
        xy, strength = maxima(as_array(response, image.shape, "the Harris response"))
        kept = functions.call("suppress", xy, strength, KEPT, 0.9)
        found.append(xy[as_array(kept, (KEPT,), "the answer of suppress").astype(int)])
        descriptors.append(describe(image, found[-1]))
    pairs = np.asarray(functions.call("match", *descriptors, 0.8)).astype(int).reshape(-1, 2)
    F, _ = robust(functions, generator, found[0][pairs[:, 0]], found[1][pairs[:, 1]], threshold_px=1.5)
    # Below this the error depends on what RANSAC happened to draw.
    error = max(rms(distances(F, place.reshape(-1, 2), in_second(place).reshape(-1, 2))), 8.0)
    return np.concatenate([np.ravel(found), [len(pairs), error]])


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


def outliers(functions, generator):
    """Errors in places where matches without noise ought to be on the epipolar lines."""
    share = generator.uniform(0.3, 0.5)
    first, second, T_2_1, _ = matches(generator, 200, share, 0.25, WRONG_PX)
    F, _ = robust(functions, generator, first, second, samples_max=4000)
    return Track(np.arange(60.0), distances(F, *seen_twice(generator, T_2_1, 60))[:, None])


def work(functions, generator):
    image = generator.uniform(size=(120, 160))
    bits = generator.uniform(size=(2, 150, BITS)) < 0.5
    for _ in range(4):
        functions.call("harris_response", image, 5, 0.05)
        functions.call("suppress", *crowd(generator, 300), 100, 0.9)
        functions.call("match", *bits, 0.8)
        first, second, _, _ = matches(generator, 100, 0.25, 0.1, WRONG_PX)
        robust(functions, generator, first, second)
