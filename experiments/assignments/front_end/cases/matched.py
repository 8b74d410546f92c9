"""Matches of a scene that was seen twice, some of them wrong, and what holds of F."""

import numpy as np

from slamcmp.geometry import exp, hat, inverse, transform
from slamcmp.grading.results.scoring import as_array
from slamcmp.grading.run.trial import Case, Track
from slamcmp.grading.sandbox.errors import StudentError

from .drawn import relative

CAMERA = np.array([[400.0, 0.0, 320.0], [0.0, 400.0, 240.0], [0.0, 0.0, 1.0]])
WRONG_PX = 20.0
"""Wrong matches of the exact tests are at least so far from obeying the true F."""
THRESHOLD_PX = 1.0
BOUNDS = np.array([3.841, 5.991, 7.815])


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


def outliers(functions, generator):
    """Errors in places where matches without noise ought to be on the epipolar lines."""
    share = generator.uniform(0.3, 0.5)
    first, second, T_2_1, _ = matches(generator, 200, share, 0.25, WRONG_PX)
    F, _ = robust(functions, generator, first, second, samples_max=4000)
    return Track(np.arange(60.0), distances(F, *seen_twice(generator, T_2_1, 60))[:, None])
