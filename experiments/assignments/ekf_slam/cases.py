"""Data of the EKF-SLAM tests: a robot on a bend among landmarks it does not know."""

import numpy as np

from slamcmp.geometry import exp, inverse, local, se2, transform
from slamcmp.grading.run.trial import Case, Track
from slamcmp.models.sensors import RangeBearing
from slamcmp.types import Frame, Problem

SENSOR = RangeBearing()
Q = np.diag([0.05, 0.02, 0.01]) ** 2
R = np.diag([0.1, 0.02]) ** 2
PRIOR = np.diag([0.1, 0.1, 0.03]) ** 2


def noise(generator, covariance):
    return generator.normal(size=len(covariance)) * np.sqrt(np.diag(covariance))


def increment(generator):
    return se2(generator.uniform(0.3, 1.0), generator.uniform(-0.1, 0.1), generator.uniform(-0.4, 0.4))


def joint(generator, landmarks):
    """A pose, landmarks 2 to 8 m away from it, and their covariance with correlations everywhere."""
    T = se2(*generator.uniform(-4, 4, 2), generator.uniform(-3, 3))
    angles, far = generator.uniform(-np.pi, np.pi, landmarks), generator.uniform(2, 8, landmarks)
    body = far[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    half = generator.normal(size=(3 + 2 * landmarks, 3 + 2 * landmarks))
    half[2] *= 0.2
    return T, transform(T, body), 0.01 * half @ half.T + 1e-4 * np.eye(len(half))


def observed(generator, T, landmarks):
    z = SENSOR.predict(T, landmarks) + generator.normal(size=landmarks.shape) * np.sqrt(np.diag(R)) * 2
    z[:, 1] = np.pi - np.mod(np.pi - z[:, 1], 2 * np.pi)
    return z, np.tile(R, (len(z), 1, 1))


def predictions(reference, generator):
    cases = []
    for number in range(8):
        T, _, P = joint(generator, number % 4)
        cases.append(Case((T, P, increment(generator), Q)))
    return cases


def augmentations(reference, generator):
    cases = []
    for number in range(8):
        T, landmarks, P = joint(generator, number % 4)
        z = np.array([generator.uniform(1, 8), generator.uniform(-3, 3)])
        cases.append(Case((T, landmarks, P, z, R)))
    return cases


def updates(reference, generator):
    cases = []
    for number in range(8):
        T, landmarks, P = joint(generator, 4)
        numbers = generator.permutation(4)[: 1 + number % 3]
        z, noises = observed(generator, T, landmarks[numbers])
        # Not across the jump of the bearing: that has a test of its own.
        z[:, 1] = SENSOR.predict(T, landmarks[numbers])[:, 1] + generator.normal(size=len(z)) * 0.02
        cases.append(Case((T, landmarks, P, numbers, z, noises)))
    return cases


def updates_behind(reference, generator):
    """Landmarks right behind the robot, predicted at one end of (-π, π] and seen at the other."""
    cases = []
    for number in range(6):
        T, landmarks, P = joint(generator, 3)
        landmarks[0] = transform(T, np.array([-3.0, 0.03]))
        predicted = SENSOR.predict(T, landmarks[0])
        z = np.array([predicted[0] + 0.05 * generator.normal(), -np.pi + generator.uniform(0.005, 0.03)])
        cases.append(Case((T, landmarks, P, np.array([0]), z[None], R[None]), f"step {number + 1}"))
    return cases


def simulate(generator, steps):
    """True poses (K, 3, 3), the problem, and the frames."""
    world = generator.uniform([-4, -4], [12, 14], (14, 2))
    start = np.eye(3)
    true = start @ exp(noise(generator, PRIOR))
    states, frames = [], []
    for k in range(steps):
        moved = se2(0.6, 0.0, 0.12)
        if k > 0:
            true = true @ moved @ exp(noise(generator, Q))
        far = np.linalg.norm(world - true[:2, 2], axis=1)
        near = np.flatnonzero((far < 7) & (far > 1))
        seen = generator.permutation(near)[:4]
        z, noises = observed_once(generator, true, world[seen])
        odometry = (moved, Q) if k > 0 else (np.eye(3), np.zeros((3, 3)))
        frames.append(Frame(k, 0.2 * k, *odometry, 10 + seen, z, noises))
        states.append(true)
    return np.array(states), Problem(start, PRIOR, SENSOR), frames


def observed_once(generator, T, landmarks):
    z = SENSOR.predict(T, landmarks) + generator.normal(size=landmarks.shape) * np.sqrt(np.diag(R))
    z[:, 1] = np.pi - np.mod(np.pi - z[:, 1], 2 * np.pi)
    return z, np.tile(R, (len(z), 1, 1))


def put_together(functions, generator):
    """A drive with the three functions only: which landmark is which is ours to know."""
    _, problem, frames = simulate(generator, 15)
    T, P, landmarks, ids = problem.T_world_body, problem.P, np.empty((0, 2)), []
    for frame in frames:
        if frame.k > 0:
            T, P = functions.call("predict", T, P, frame.T_prev_body, frame.Q)
        known = np.isin(frame.ids, ids)
        for index in np.flatnonzero(~known):
            landmarks, P = functions.call("augment", T, landmarks, P, frame.z[index], frame.R[index])
        numbers = np.array([ids.index(landmark) for landmark in frame.ids[known]], dtype=int)
        ids += frame.ids[~known].tolist()
        if len(numbers):
            arguments = (T, landmarks, P, numbers, frame.z[known], frame.R[known])
            T, landmarks, P = functions.call("update", *arguments)
    return [T, landmarks, P]


def whole_back_end(functions, generator):
    """Everything the back end says along a drive."""
    _, problem, frames = simulate(generator, 25)
    handle = functions.construct("EkfSlam", problem)
    rows = []
    for frame in frames:
        answer = functions.step(handle, frame, landmarks=True)
        order = np.argsort(answer.landmarks.ids)
        parts = (answer.landmarks.positions[order], answer.landmarks.covariances[order])
        rows.append([answer.estimate.T_world_body, answer.estimate.P, *parts])
    return rows


def statements(functions, generator):
    T, landmarks, P = joint(generator, 3)
    z, noises = observed(generator, T, landmarks)
    numbers = np.arange(3)
    T_1, landmarks_1, P_1 = functions.call("update", T, landmarks, P, numbers, z, noises)
    order = np.array([2, 0, 1])
    T_2, landmarks_2, P_2 = functions.call("update", T, landmarks, P, order, z[order], noises)
    moved = se2(3.0, -2.0, 0.7)
    turn = np.eye(9)
    for index in (3, 5, 7):
        turn[index : index + 2, index : index + 2] = moved[:2, :2]
    elsewhere = (moved @ T, transform(moved, landmarks), turn @ P @ turn.T)
    T_3, _, P_3 = functions.call("update", *elsewhere, numbers, z, noises)
    _, P_4 = functions.call("augment", T, landmarks, P, z[0], R)
    _, P_5 = functions.call("predict", T, P, increment(generator), Q)
    return {
        "the order of the observations in a frame changes nothing": float(
            max(np.abs(T_2 - T_1).max(), np.abs(landmarks_2 - landmarks_1).max(), np.abs(P_2 - P_1).max())
        ),
        "moving the whole world moves the estimate with it": float(
            max(np.abs(inverse(moved) @ T_3 - T_1).max(), np.abs(turn.T @ P_3 @ turn - P_1).max())
        ),
        "a new landmark changes nothing about what was known": float(np.abs(P_4[:9, :9] - P).max()),
        "moving the robot does not change the landmarks' covariance": float(
            np.abs(P_5[3:, 3:] - P[3:, 3:]).max()
        ),
    }


def heading_gained(functions, generator):
    """What a robot that stands still learns about its heading from one landmark: nothing, in truth.

    The landmark comes from the robot's own pose; an EKF that linearises anew at every mean gains
    all the same.
    """
    problem = Problem(np.eye(3), np.diag([0.3, 0.3, 0.2]) ** 2, SENSOR)
    handle = functions.construct("EkfSlam", problem)
    place = np.array([[4.0, 1.0]])
    noises = (np.diag([0.3, 0.1]) ** 2)[None]
    answer = None
    for k in range(60):
        z = SENSOR.predict(np.eye(3), place) + generator.normal(size=(1, 2)) * [0.3, 0.1]
        # As good as none, but with an inverse, for who works with information matrices.
        still = np.zeros((3, 3)) if k == 0 else 1e-6 * np.eye(3)
        frame = Frame(k, float(k), np.eye(3), still, np.array([1]), z, noises)
        answer = functions.step(handle, frame)
    return float(1 - np.sqrt(answer.estimate.P[2, 2]) / 0.2)


def drive(functions, generator):
    states, problem, frames = simulate(generator, 40)
    handle = functions.construct("EkfSlam", problem)
    errors, covariances, path = [], [], []
    for T, frame in zip(states, frames, strict=True):
        told = functions.step(handle, frame).estimate
        errors.append(local(told.T_world_body, T))
        covariances.append(told.P)
        path.append(told.T_world_body[:2, 2])
    return Track(
        0.2 * np.arange(40.0),
        np.array(errors),
        np.array(covariances),
        path=np.array(path),
        true_path=states[:, :2, 2],
    )


def long_drive(functions, generator):
    _, problem, frames = simulate(generator, 150)
    handle = functions.construct("EkfSlam", problem)
    for frame in frames:
        functions.step(handle, frame)
