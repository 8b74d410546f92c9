"""Data of the factor graph's tests: a robot on a bend among landmarks, and systems of normal equations."""

import numpy as np

from slamcmp.backends.filters.ekf_slam import EkfSlam
from slamcmp.geometry import adjoint, exp, inverse, local, se2, transform
from slamcmp.grading.run.trial import Case, Track
from slamcmp.models.sensors import RangeBearing
from slamcmp.types import Frame, Problem

SENSOR = RangeBearing()
Q = np.diag([0.06, 0.03, 0.015]) ** 2
R = np.diag([0.12, 0.025]) ** 2
PRIOR = np.diag([0.1, 0.1, 0.04]) ** 2


def pose(generator):
    return se2(*generator.uniform(-4, 4, 2), generator.uniform(-3, 3))


def increment(generator):
    return se2(generator.uniform(0.3, 1.0), generator.uniform(-0.1, 0.1), generator.uniform(-0.4, 0.4))


def covariance(generator, deviations):
    """Positive definite and far from diagonal."""
    half = generator.normal(size=(len(deviations), len(deviations))) + np.eye(len(deviations))
    scaled = np.array(deviations)[:, None] * half
    return scaled @ scaled.T + 1e-2 * np.diag(np.square(deviations))


def moved(T, step):
    return T @ exp(step)


def noise(generator, spread):
    return generator.normal(size=len(spread)) * np.sqrt(np.diag(spread))


def priors(reference, generator):
    cases = []
    for _ in range(6):
        T = pose(generator)
        P = covariance(generator, [0.2, 0.2, 0.1])
        cases.append(Case((T @ exp(generator.normal(size=3) * [0.4, 0.4, 0.3]), T, P)))
    return cases


def neighbours(reference, generator):
    """Two poses and an odometry that fits them badly: only so the size of the residual matters."""
    cases = []
    for _ in range(8):
        T, step = pose(generator), increment(generator)
        other = T @ step @ exp(generator.normal(size=3) * [0.3, 0.3, 0.3])
        cases.append(Case((T, other, step, covariance(generator, [0.1, 0.05, 0.05]))))
    return cases


def neighbours_apart(reference, generator):
    """The same with independent noises, so that a row of a Jacobian has a name."""
    cases = []
    for case in neighbours(reference, generator)[:5]:
        cases.append(Case((*case.arguments[:3], np.diag([0.1, 0.05, 0.04]) ** 2)))
    return cases


def sightings(reference, generator):
    cases = []
    for _ in range(8):
        T, angle = pose(generator), generator.uniform(-2.5, 2.5)
        landmark = transform(T, generator.uniform(1, 7) * np.array([np.cos(angle), np.sin(angle)]))
        spread = covariance(generator, [0.2, 0.05])
        z = SENSOR.predict(T, landmark) + np.linalg.cholesky(spread) @ generator.normal(size=2)
        cases.append(Case((T, landmark, z, spread)))
    return cases


def sightings_behind(reference, generator):
    """Landmarks right behind the robot, predicted at one end of (-π, π] and seen at the other."""
    cases = []
    for number in range(6):
        T = pose(generator)
        landmark = transform(T, np.array([-3.0, 0.03]))
        z = np.array([3.0 + 0.05 * generator.normal(), -np.pi + generator.uniform(0.005, 0.03)])
        cases.append(Case((T, landmark, z, R), f"step {number + 1}"))
    return cases


def whitened(reference, generator):
    """Linearised factors of three poses and two landmarks, several on the same variables."""
    cases = []
    for _ in range(5):
        factors = [(generator.normal(size=3), [(0, generator.normal(size=(3, 3)))])]
        for start in (0, 3):
            blocks = [(start, generator.normal(size=(3, 3))), (start + 3, generator.normal(size=(3, 3)))]
            factors.append((generator.normal(size=3), blocks))
        for start, landmark in ((0, 9), (3, 9), (3, 11), (6, 11), (6, 9)):
            blocks = [(start, generator.normal(size=(2, 3))), (landmark, generator.normal(size=(2, 2)))]
            factors.append((generator.normal(size=2), blocks))
        cases.append(Case((factors, 13)))
    return cases


def information(generator, size):
    half = generator.normal(size=(size, size))
    return half @ half.T + 0.5 * np.eye(size)


def steps(reference, generator):
    cases = []
    for number in range(6):
        count, landmarks = 1 + number % 3, number % 4
        poses = np.array([pose(generator) for _ in range(count)])
        Lam = information(generator, 3 * count + 2 * landmarks)
        eta = Lam @ (0.4 * generator.normal(size=len(Lam)))
        cases.append(Case((poses, generator.uniform(-5, 5, (landmarks, 2)), Lam, eta)))
    return cases


def systems(reference, generator):
    cases = []
    for _ in range(8):
        size = int(generator.integers(5, 13))
        keep = np.sort(generator.permutation(size)[: int(generator.integers(2, size - 1))])
        cases.append(Case((information(generator, size), generator.normal(size=size), keep)))
    return cases


def informations(reference, generator):
    return [Case((Lam, keep)) for Lam, _, keep in (case.arguments for case in systems(reference, generator))]


def simulate(generator, frames, sight=4):
    """True poses (K, 3, 3), the problem, and the frames; the sixth frame sees nothing."""
    world = generator.uniform([-4, -4], [12, 14], (14, 2))
    true = np.eye(3) @ exp(noise(generator, PRIOR))
    states, told = [], []
    for k in range(frames):
        step = se2(0.6, 0.0, 0.12)
        if k > 0:
            true = true @ step @ exp(noise(generator, Q))
        far = np.linalg.norm(world - true[:2, 2], axis=1)
        near = np.flatnonzero((far < 7) & (far > 1))
        seen = generator.permutation(near)[: 0 if k == 5 else sight]
        z = SENSOR.predict(true, world[seen]) + generator.normal(size=(len(seen), 2)) * np.sqrt(np.diag(R))
        z[:, 1] = np.pi - np.mod(np.pi - z[:, 1], 2 * np.pi)
        odometry = (step, Q) if k > 0 else (np.eye(3), np.zeros((3, 3)))
        told.append(Frame(k, 0.2 * k, *odometry, 10 + seen, z, np.tile(R, (len(seen), 1, 1))))
        states.append(true)
    return np.array(states), Problem(np.eye(3), PRIOR, SENSOR), told


def graph_of(problem, frames):
    """The frames as one graph, with poses from odometry and landmarks from their first sight."""
    graph = {"prior": {"T": problem.T_world_body, "P": problem.P}, "odometry": [], "observations": []}
    poses, landmarks, ids = [problem.T_world_body], [], []
    for frame in frames:
        if frame.k > 0:
            poses.append(poses[-1] @ frame.T_prev_body)
            link = {"i": frame.k - 1, "j": frame.k, "T_ij": frame.T_prev_body, "Q": frame.Q}
            graph["odometry"].append(link)
        for name, z, spread in zip(frame.ids.tolist(), frame.z, frame.R, strict=True):
            if name not in ids:
                ids.append(name)
                landmarks.append(SENSOR.invert(poses[-1], z))
            seen = {"i": frame.k, "landmark": ids.index(name), "z": z, "R": spread}
            graph["observations"].append(seen)
    return graph, np.array(poses), np.array(landmarks)


def put_together(functions, generator):
    """Two Gauss-Newton steps on a graph of six poses, then all poses but the last marginalised."""
    _, problem, frames = simulate(generator, 6, sight=3)
    graph, poses, landmarks = graph_of(problem, frames)
    Lam, eta = None, None
    for _ in range(2):
        prior = graph["prior"]
        r, J = functions.call("prior_factor", poses[0], prior["T"], prior["P"])
        factors = [(r, [(0, J)])]
        for link in graph["odometry"]:
            i, j = link["i"], link["j"]
            r, J_i, J_j = functions.call("odometry_factor", poses[i], poses[j], link["T_ij"], link["Q"])
            factors.append((r, [(3 * i, J_i), (3 * j, J_j)]))
        for seen in graph["observations"]:
            i, start = seen["i"], 3 * len(poses) + 2 * seen["landmark"]
            arguments = (poses[i], landmarks[seen["landmark"]], seen["z"], seen["R"])
            r, J_pose, J_landmark = functions.call("observation_factor", *arguments)
            factors.append((r, [(3 * i, J_pose), (start, J_landmark)]))
        Lam, eta = functions.call("linear_system", factors, 3 * len(poses) + 2 * len(landmarks))
        poses, landmarks = functions.call("gauss_newton_step", poses, landmarks, Lam, eta)
    keep = np.arange(3 * len(poses) - 3, len(eta))
    Lam_keep, _ = functions.call("marginalise", Lam, eta, keep)
    P = functions.call("marginal_covariance", Lam_keep, np.arange(3))
    return [poses, landmarks, P]


def smoothed(functions, generator):
    """A whole graph solved from far away: poses, landmarks, and what is known about the last pose."""
    _, problem, frames = simulate(generator, 10, sight=3)
    graph, poses, landmarks = graph_of(problem, frames)
    poses = np.array([T @ exp(generator.normal(size=3) * [0.3, 0.3, 0.15]) for T in poses])
    landmarks = landmarks + 0.3 * generator.normal(size=landmarks.shape)
    return list(functions.call("smooth", graph, poses, landmarks, 6))


def statements(functions, generator):
    """Marginals of Gaussians, and the gauge: only the prior says where the whole map is."""
    Lam, eta = information(generator, 10), generator.normal(size=10)
    keep = np.array([1, 2, 5, 6, 9])
    Lam_1, eta_1 = functions.call("marginalise", Lam, eta, keep)
    first = np.array([0, 1, 2, 5, 6, 8, 9])
    Lam_2, eta_2 = functions.call("marginalise", Lam, eta, first)
    Lam_2, eta_2 = functions.call("marginalise", Lam_2, eta_2, np.flatnonzero(np.isin(first, keep)))
    block = np.linalg.inv(Lam)[np.ix_(keep, keep)]

    T, step = pose(generator), increment(generator)
    other = T @ step @ exp(generator.normal(size=3) * 0.1)
    landmark = transform(T, np.array([3.0, 1.5]))
    z = SENSOR.predict(T, landmark) + generator.normal(size=2) * np.sqrt(np.diag(R))
    away, direction = se2(3.0, -2.0, 0.7), generator.normal(size=3)
    r_1, J_i, J_j = functions.call("odometry_factor", T, other, step, Q)
    r_2, _, _ = functions.call("odometry_factor", away @ T, away @ other, step, Q)
    r_3, J_pose, J_landmark = functions.call("observation_factor", T, landmark, z, R)
    r_4, _, _ = functions.call("observation_factor", away @ T, transform(away, landmark), z, R)
    # All of the map moved by exp(direction) in the world, as each variable's own step.
    steps_of_poses = [adjoint(inverse(each)) @ direction for each in (T, other)]
    of_landmark = direction[:2] + direction[2] * np.array([-landmark[1], landmark[0]])
    free_1 = J_i @ steps_of_poses[0] + J_j @ steps_of_poses[1]
    free_2 = J_pose @ steps_of_poses[0] + J_landmark @ of_landmark
    return {
        "the inverse of the marginal information is the block of the whole covariance": float(
            np.abs(np.linalg.inv(Lam_1) - block).max()
        ),
        "what stays has its minimum where it was before marginalising": float(
            np.abs(np.linalg.solve(Lam_1, eta_1) - np.linalg.solve(Lam, eta)[keep]).max()
        ),
        "marginalising in two goes gives the same as in one": float(
            max(np.abs(Lam_2 - Lam_1).max(), np.abs(eta_2 - eta_1).max())
        ),
        "moving the whole map changes no residual of odometry and observations": float(
            max(np.abs(r_2 - r_1).max(), np.abs(r_4 - r_3).max())
        ),
        "the Jacobians of odometry and observations leave the whole map free to move": float(
            max(np.abs(free_1).max(), np.abs(free_2).max())
        ),
    }


def window_one_is_the_ekf(functions, generator):
    """Against EKF-SLAM in covariance form, a second program for the same estimate."""
    _, problem, frames = simulate(generator, 20)
    handle = functions.construct("WindowOne", problem)
    ekf = EkfSlam(problem, error_state="body")
    gaps = np.zeros(4)
    for frame in frames:
        answer = functions.step(handle, frame, landmarks=True)
        ekf.update(frame)
        order, right = np.argsort(answer.landmarks.ids), ekf.landmarks()
        order_right = np.argsort(right.ids)
        pairs = [
            (answer.estimate.T_world_body, ekf.estimate().T_world_body),
            (answer.estimate.P, ekf.estimate().P),
        ]
        if np.array_equal(answer.landmarks.ids[order], right.ids[order_right]):
            pairs += [
                (answer.landmarks.positions[order], right.positions[order_right]),
                (answer.landmarks.covariances[order], right.covariances[order_right]),
            ]
        else:
            gaps[2:] = np.inf
        sizes = [np.abs(own - best).max(initial=0.0) for own, best in pairs]
        gaps[: len(sizes)] = np.maximum(gaps[: len(sizes)], sizes)
    names = ("pose", "pose's covariance", "landmarks", "landmarks' covariances")
    return {
        f"the {name}: at every frame those of EKF-SLAM": gap for name, gap in zip(names, gaps, strict=True)
    }


def heading_gained(functions, generator):
    """What a robot that stands still learns about its heading from one landmark: nothing, in truth.

    The landmark comes from the robot's own pose; linearised anew at every mean, with the past gone, the
    EKF gains all the same. With the past poses kept there is no such gain.
    """
    problem = Problem(np.eye(3), np.diag([0.3, 0.3, 0.2]) ** 2, SENSOR)
    handle = functions.construct("WindowOne", problem)
    place = np.array([[4.0, 1.0]])
    noises = (np.diag([0.3, 0.1]) ** 2)[None]
    answer = None
    for k in range(20):
        z = SENSOR.predict(np.eye(3), place) + generator.normal(size=(1, 2)) * [0.3, 0.1]
        still = np.zeros((3, 3)) if k == 0 else 1e-5 * np.eye(3)
        answer = functions.step(handle, Frame(k, float(k), np.eye(3), still, np.array([1]), z, noises))
    return float(1 - np.sqrt(max(answer.estimate.P[2, 2], 0.0)) / 0.2)


def drive(functions, generator):
    states, problem, frames = simulate(generator, 30)
    handle = functions.construct("WindowOne", problem)
    poses, covariances = [], []
    for frame in frames:
        told = functions.step(handle, frame).estimate
        poses.append(told.T_world_body)
        covariances.append(told.P)
    return track(states, np.array(poses), np.array(covariances))


def drive_smoothed(functions, generator):
    """Every pose of a drive with hindsight."""
    states, problem, frames = simulate(generator, 20, sight=3)
    poses, _, _ = functions.call("smooth", *graph_of(problem, frames), 5)
    return track(states, np.reshape(poses, states.shape), None)


def track(states, poses, covariances):
    t = 0.2 * np.arange(len(states))
    paths = {"path": poses[:, :2, 2], "true_path": states[:, :2, 2]}
    return Track(t, local(poses, states), covariances, **paths)


def long_drive(functions, generator):
    _, problem, frames = simulate(generator, 120)
    handle = functions.construct("WindowOne", problem)
    for frame in frames:
        functions.step(handle, frame)
