"""Data of the EKF's tests: a car that drives bends among eight known landmarks."""

import numpy as np

from slamcmp.grading.run.trial import Case, Track

DT, WHEELBASE = 0.2, 2.5
PROCESS_NOISE = np.diag([0.03, 0.03, 0.01]) ** 2
NOISE = np.diag([0.15, 0.02]) ** 2
PRIOR = np.diag([0.3, 0.3, 0.05]) ** 2


def state(generator):
    return np.array([*generator.uniform(-5, 5, 2), generator.uniform(-2.5, 2.5)])


def control(generator):
    return np.array([generator.uniform(2, 6), generator.uniform(-0.5, 0.5)])


def spread(generator):
    half = generator.normal(size=(3, 3)) * np.array([[0.3], [0.3], [0.05]])
    return half @ half.T + 1e-4 * np.eye(3)


def around(generator, place, count):
    """Landmarks between 3 m and 15 m away, ahead of and behind the car."""
    angles = generator.uniform(-np.pi, np.pi, count)
    distances = generator.uniform(3, 15, count)
    return place[:2] + distances[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def motions(reference, generator):
    return [Case((state(generator), control(generator), DT, WHEELBASE)) for _ in range(10)]


def sightings(reference, generator):
    cases = []
    for _ in range(12):
        place = state(generator)
        cases.append(Case((place, around(generator, place, 1)[0])))
    return cases


def innovations(reference, generator):
    """Half of them with the landmark right behind the car, where bearings jump by a whole turn."""
    cases = []
    for number in range(10):
        behind = number % 2 == 0
        observed = np.pi - generator.uniform(0, 0.05) if behind else generator.uniform(-2, 2)
        predicted = -np.pi + generator.uniform(0, 0.05) if behind else observed + generator.normal() * 0.1
        distances = generator.uniform(2, 10) + generator.normal(size=2) * 0.1
        pair = (np.array([distances[0], observed]), np.array([distances[1], predicted]))
        cases.append(Case(pair, f"step {number + 1}"))
    return cases


def propagations(reference, generator):
    cases = []
    for _ in range(8):
        G = reference.call("motion_jacobian", state(generator), control(generator), DT, WHEELBASE)
        cases.append(Case((spread(generator), G, PROCESS_NOISE)))
    return cases


def updates(reference, generator):
    cases = []
    for number in range(8):
        place, count = state(generator), 1 + number % 3
        seen = around(generator, place, count)
        H = np.concatenate([reference.call("measurement_jacobian", place, landmark) for landmark in seen])
        y = generator.normal(size=2 * count) * np.tile([0.3, 0.05], count)
        cases.append(Case((place, spread(generator), y, H, np.kron(np.eye(count), NOISE))))
    return cases


def simulate(generator, steps, sight=4):
    """True states (K, 3) and for each step what a filter is told: control, landmarks, observations."""
    world = np.array([[x, y] for x in (-12.0, 0.0, 12.0) for y in (-4.0, 8.0, 20.0)])
    world += generator.uniform(-2, 2, world.shape)
    true = np.array([0.0, 0.0, 0.0]) + generator.multivariate_normal(np.zeros(3), PRIOR)
    states, told = [], []
    for _ in range(steps):
        u = np.array([3.0, 0.28 + 0.1 * generator.normal()])
        x, y, heading = true
        true = np.array(
            [
                x + u[0] * DT * np.cos(heading),
                y + u[0] * DT * np.sin(heading),
                heading + u[0] * DT * np.tan(u[1]) / WHEELBASE,
            ]
        ) + generator.multivariate_normal(np.zeros(3), PROCESS_NOISE)
        difference = world - true[:2]
        distance = np.hypot(*difference.T)
        near = np.flatnonzero(distance > 1.5)
        near = near[np.argsort(distance[near])[:sight]]
        bearings = np.arctan2(difference[near, 1], difference[near, 0]) - true[2]
        seen = np.stack([distance[near], bearings], axis=1)
        seen += generator.normal(size=seen.shape) * np.sqrt(np.diag(NOISE))
        seen[:, 1] = np.pi - np.mod(np.pi - seen[:, 1], 2 * np.pi)
        states.append(true)
        told.append((u, world[near], seen))
    return np.array(states), told


def steps(reference, generator):
    """Single steps along a drive, each from the reference's own estimate."""
    _, told = simulate(generator, 24)
    mean, P = np.zeros(3), PRIOR
    cases = []
    for number, (u, seen, z) in enumerate(told):
        if number == 3:
            seen, z = seen[:0], z[:0]
        arguments = (mean, P, u, DT, WHEELBASE, PROCESS_NOISE, seen, z, NOISE)
        cases.append(Case(arguments, f"step {number + 1}"))
        mean, P = reference.call("ekf_step", *arguments)
    return cases


def put_together(functions, generator):
    """A drive with the small functions only: the order of the calls is ours."""
    _, told = simulate(generator, 20, sight=2)
    mean, P = np.zeros(3), PRIOR
    rows = []
    for u, landmarks, observations in told:
        G = functions.call("motion_jacobian", mean, u, DT, WHEELBASE)
        mean = functions.call("motion", mean, u, DT, WHEELBASE)
        P = functions.call("propagate", P, G, PROCESS_NOISE)
        y, H = [], []
        for landmark, z in zip(landmarks, observations, strict=True):
            y.append(functions.call("innovation", z, functions.call("measurement", mean, landmark)))
            H.append(functions.call("measurement_jacobian", mean, landmark))
        noise = np.kron(np.eye(len(y)), NOISE)
        mean, P = functions.call("update", mean, P, np.concatenate(y), np.concatenate(H), noise)
        rows.append([mean, P])
    return rows


def left_over(functions, generator):
    """Residual range after one update from a bad prior: only relinearising would remove it."""
    bearing = generator.uniform(1.0, 1.4)
    mean = np.array([0.0, 0.0, 0.0])
    P = np.diag([4.0, 4.0, 1e-6])
    landmark = np.array([3.0, 0.0])
    z = np.array([3.0, bearing])
    still = (np.array([0.0, 0.0]), DT, WHEELBASE, 1e-12 * np.eye(3))
    noise = np.diag([1e-3, 1e-3]) ** 2
    after, _ = functions.call("ekf_step", mean, P, *still, landmark[None], z[None], noise)
    return float(abs(np.hypot(*(landmark - np.asarray(after, dtype=float)[:2])) - z[0]))


def drive(functions, generator):
    states, told = simulate(generator, 40)
    mean, P = np.zeros(3), PRIOR
    means, covariances = [], []
    for u, seen, z in told:
        mean, P = functions.call("ekf_step", mean, P, u, DT, WHEELBASE, PROCESS_NOISE, seen, z, NOISE)
        means.append(np.reshape(mean, 3))
        covariances.append(np.reshape(P, (3, 3)))
    means = np.array(means)
    errors = states - means
    errors[:, 2] = np.pi - np.mod(np.pi - errors[:, 2], 2 * np.pi)
    t = DT * np.arange(1.0, 41.0)
    return Track(t, errors, np.array(covariances), path=means[:, :2], true_path=states[:, :2])
