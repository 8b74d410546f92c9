"""Windows of a robot on a bend, and single questions about them."""

import numpy as np

from slamcmp.geometry import se2
from slamcmp.grading.run.trial import Case
from slamcmp.models.sensors import RangeBearing

SENSOR = RangeBearing()
Q = np.diag([0.06, 0.03, 0.015]) ** 2
R = np.diag([0.12, 0.025]) ** 2
PRIOR = np.diag([0.1, 0.1, 0.04]) ** 2
NAMES = ("Lam", "eta", "centre", "first")


def wrapped(angle):
    return np.pi - np.mod(np.pi - angle, 2 * np.pi)


def covariance(generator, deviations):
    """Positive definite and far from diagonal."""
    half = generator.normal(size=(len(deviations), len(deviations))) + np.eye(len(deviations))
    scaled = np.array(deviations)[:, None] * half
    return scaled @ scaled.T + 1e-2 * np.diag(np.square(deviations))


def information(generator, size):
    half = generator.normal(size=(size, size))
    return half @ half.T + 0.5 * np.eye(size)


def window(generator, poses=4, landmarks=4, known=2, heading=None):
    """A window whose measurements fit its values badly; the prior is on ``known`` landmarks.

    Landmarks are numbered by first sight: pose 0 has seen those of the prior and one more.
    """
    start = [*generator.uniform(-3, 3, 2), generator.uniform(-2.5, 2.5) if heading is None else heading]
    values = [np.array(start)]
    motions = np.column_stack(
        [
            generator.uniform(0.5, 1.0, poses - 1),
            generator.uniform(-0.1, 0.1, poses - 1),
            generator.uniform(-0.3, 0.3, poses - 1),
        ]
    )
    for motion in motions:
        values.append(moved(values[-1], motion + generator.normal(size=3) * [0.1, 0.05, 0.05]))
    values = np.array(values)
    places = values[:, :2].mean(axis=0) + generator.uniform(-5, 5, (landmarks, 2))
    pairs = [(0, number) for number in range(min(known + 1, landmarks))]
    later = [(i, number) for i in range(1, poses) for number in range(landmarks)]
    pairs += [pair for pair in later if sum(pair) % 2 or pair[0] == poses - 1]
    pose_of, landmark_of = np.array(pairs).T
    sights = np.array([seen(values[i], places[number]) for i, number in pairs])
    sights += generator.normal(size=sights.shape) * [0.2, 0.05]
    sights[:, 1] = wrapped(sights[:, 1])
    centre = np.concatenate([values[0], places[:known].ravel()])
    centre = centre + 0.1 * generator.normal(size=len(centre))
    centre[2] = wrapped(centre[2])
    first = centre + 0.1 * generator.normal(size=len(centre))
    prior = {
        "Lam": 20 * information(generator, len(centre)),
        "eta": 5 * generator.normal(size=len(centre)),
        "centre": centre,
        "first": first,
    }
    return {
        "poses": values,
        "landmarks": places,
        "motions": motions,
        "Q": np.array([covariance(generator, [0.1, 0.05, 0.05]) for _ in motions]),
        "pose_of": pose_of,
        "landmark_of": landmark_of,
        "z": sights,
        "R": np.array([covariance(generator, [0.2, 0.05]) for _ in pairs]),
        "prior": prior,
    }


def moved(pose, motion):
    T = se2(*pose) @ se2(*motion)
    return np.array([T[0, 2], T[1, 2], wrapped(pose[2] + motion[2])])


def seen(pose, landmark):
    return SENSOR.predict(se2(*pose), landmark)


def elsewhere(generator, some):
    """Other points for the Jacobians than the window's values."""
    poses = some["poses"] + generator.normal(size=some["poses"].shape) * [0.3, 0.3, 0.15]
    return poses, some["landmarks"] + 0.3 * generator.normal(size=some["landmarks"].shape)


def windows(reference, generator):
    cases = []
    for number in range(6):
        some = window(generator, poses=1 + number % 4, known=number % 3)
        cases.append(Case((some, some["poses"], some["landmarks"])))
    return cases


def windows_elsewhere(reference, generator):
    cases = []
    for number in range(5):
        some = window(generator, poses=2 + number % 3, known=number % 3)
        cases.append(Case((some, *elsewhere(generator, some))))
    return cases


def windows_west(reference, generator):
    """Robots that look west, where headings jump, and landmarks right behind them, where bearings do."""
    cases = []
    for number in range(6):
        some = window(generator, poses=2, known=1, heading=np.pi - 0.02)
        some["poses"][1] = moved(some["poses"][0], [0.8, 0.0, 0.05])
        some["motions"][:] = [0.75, 0.02, 0.03]
        some["prior"]["centre"][2] = some["poses"][0, 2] - 2 * np.pi + 0.04 if number % 2 else np.pi - 0.05
        if number % 3 == 0:
            some["landmarks"][0] = place(some["poses"][1], [3.0, np.pi - 0.01])
            some["z"][some["landmark_of"] == 0] = [3.1, -np.pi + 0.02]
        cases.append(Case((some, some["poses"], some["landmarks"]), f"a window looking west, {number + 1}"))
    return cases


def place(pose, z):
    return SENSOR.invert(se2(*pose), np.asarray(z))


def steps(reference, generator):
    """Two of them turn a robot across west."""
    cases = []
    for number in range(6):
        some = window(generator, poses=1 + number % 3, landmarks=1 + number % 4, known=0)
        if number % 3 == 0:
            some["poses"][0, 2] = np.pi - 0.05
        size = 3 * len(some["poses"]) + 2 * len(some["landmarks"])
        Lam = information(generator, size)
        dx = 0.3 * generator.normal(size=size)
        if number % 3 == 0:
            dx[2] = 0.2
        cases.append(Case((some, Lam, Lam @ dx)))
    return cases


def systems(reference, generator):
    cases = []
    for number in range(8):
        size = int(generator.integers(5, 13))
        # As many stay as go in none: an exchange of the two has to show in the shape as well.
        count = int(generator.integers(1, (size + 1) // 2)) if number % 2 else size // 2 + 1
        keep = np.sort(generator.permutation(size)[:count])
        cases.append(Case((information(generator, size), generator.normal(size=size), keep)))
    return cases


def pasts(reference, generator):
    """Windows and the newest pose of the past; in the first two nobody has to go yet."""
    cases = []
    for number in range(8):
        some = window(generator, poses=2 + number % 3, known=number % 3)
        newest = 0 if number < 2 else 1 + number % (len(some["poses"]) - 1)
        at = elsewhere(generator, some) if number % 2 else (some["poses"], some["landmarks"])
        cases.append(Case((some, newest, *at)))
    return cases


def policies(reference, generator):
    cases = []
    for number in range(8):
        some = window(generator, poses=1 + number % 3, known=number % 4)
        cases.append(Case((some, ("latest", "fej")[number // 2 % 2])))
    return cases


def places(reference, generator):
    cases = []
    for number in range(5):
        poses = np.column_stack([generator.uniform(-4, 4, (1 + number % 3, 2)), np.zeros(1 + number % 3)])
        poses[:, 2] = generator.uniform(-3, 3, len(poses))
        cases.append(Case((poses, generator.uniform(-5, 5, (number % 4, 2)))))
    return cases
