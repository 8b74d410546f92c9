"""Data of the Kalman filter's tests: a target with constant velocity, and random systems."""

import numpy as np

from slamcmp.grading.run.trial import Case, Track

DT = 0.5


def target():
    """A, C and the two noises of a target in the plane: position and velocity, position observed."""
    eye = np.eye(2)
    A = np.block([[eye, DT * eye], [np.zeros((2, 2)), eye]])
    G = np.vstack([0.5 * DT**2 * eye, DT * eye])
    return (
        A,
        np.hstack([eye, np.zeros((2, 2))]),
        0.3**2 * G @ G.T + 1e-6 * np.eye(4),
        np.diag([0.3, 0.8]) ** 2,
    )


def covariance(generator, size):
    """Symmetric, positive definite, far from diagonal."""
    half = generator.normal(size=(size, size))
    return half @ half.T + 0.1 * np.eye(size)


def system(generator):
    n, m = int(generator.integers(2, 6)), int(generator.integers(1, 3))
    A, C = generator.normal(size=(n, n)), generator.normal(size=(m, n))
    return A, C, covariance(generator, n), covariance(generator, m)


def predictions(reference, generator):
    cases = []
    for _ in range(10):
        A, _, Q, _ = system(generator)
        n = len(A)
        cases.append(Case((generator.normal(size=n), covariance(generator, n), A, Q)))
    return cases


def corrections(reference, generator):
    cases = []
    for _ in range(10):
        A, C, _, R = system(generator)
        n, m = len(A), len(C)
        state = generator.normal(size=n), covariance(generator, n)
        cases.append(Case((*state, 3 * generator.normal(size=m), C, R)))
    return cases


def simulate(generator, steps, *, gaps=False):
    """True states (K, 4), observations (K, 2), and what a filter is told at the start."""
    A, C, Q, R = target()
    P = np.diag([1.0, 1.0, 0.5, 0.5]) ** 2
    mean = np.array([0.0, 0.0, 1.0, -0.5])
    x = generator.multivariate_normal(mean, P)
    states, measurements = [], []
    for t in range(steps):
        if t > 0:
            x = A @ x + generator.multivariate_normal(np.zeros(4), Q)
        states.append(x)
        y = C @ x + generator.multivariate_normal(np.zeros(2), R)
        measurements.append(np.full(2, np.nan) if gaps and t % 4 == 2 else y)
    return np.array(states), np.array(measurements), mean, P


def sequences(reference, generator):
    A, C, Q, R = target()
    cases = []
    for gaps in (False, True):
        _, measurements, mean, P = simulate(generator, 20, gaps=gaps)
        label = "a sequence with missing observations" if gaps else "a sequence"
        cases.append(Case((mean, P, measurements, A, C, Q, R), label))
    return cases


def put_together(functions, generator):
    A, C, Q, R = target()
    _, measurements, mean, P = simulate(generator, 25)
    rows = []
    for t, y in enumerate(measurements):
        if t > 0:
            mean, P = functions.call("predict", mean, P, A, Q)
        mean, P = functions.call("correct", mean, P, y, C, R)
        rows.append([mean, P])
    return rows


def statements(functions, generator):
    A, C, Q, R = target()
    _, measurements, mean, P = simulate(generator, 12)
    P = P + 0.3
    y = measurements[0]
    one, both = functions.call("correct", mean, P, y, C, R)
    first = functions.call("correct", mean, P, y[:1], C[:1], R[:1, :1])
    second = functions.call("correct", *first, y[1:], C[1:], R[1:, 1:])
    information = np.linalg.inv(P) + C.T @ np.linalg.inv(R) @ C
    means, _ = functions.call("run_filter", mean, P, measurements, A, C, Q, R)
    changed = measurements.copy()
    changed[-1] += 100.0
    means_changed, _ = functions.call("run_filter", mean, P, changed, A, C, Q, R)
    return {
        "independent observations give the same, one by one or at once": float(
            np.abs(second[0] - one).max() + np.abs(second[1] - both).max()
        ),
        "the inverse of the updated covariance is the old inverse plus CᵀR⁻¹C": float(
            np.abs(both @ information - np.eye(4)).max()
        ),
        "a filter's estimate does not depend on observations that come later": float(
            np.abs(means_changed[:-1] - means[:-1]).max()
        ),
    }


def drive(functions, generator):
    A, C, Q, R = target()
    states, measurements, mean, P = simulate(generator, 40)
    means, covariances = functions.call("run_filter", mean, P, measurements, A, C, Q, R)
    means, covariances = np.reshape(means, (40, 4)), np.reshape(covariances, (40, 4, 4))
    return Track(DT * np.arange(40.0), states - means, covariances)


def long_sequence(functions, generator):
    A, C, Q, R = target()
    _, measurements, mean, P = simulate(generator, 1500)
    functions.call("run_filter", mean, P, measurements, A, C, Q, R)
