"""Drives through the whole back end, and three other programs to compare it with.

EKF-SLAM and the FEJ-EKF are slamcmp's own (covariance form, poses as matrices); the batch solution is
scipy's, of residuals written down anew and differentiated numerically.
"""

import numpy as np
from scipy.optimize import least_squares

from slamcmp.backends.filters.ekf_slam import EkfSlam
from slamcmp.backends.filters.variants import FirstEstimatesEkf
from slamcmp.geometry import exp, local, se2
from slamcmp.grading.run.trial import Track
from slamcmp.types import Frame, Problem

from .some_windows import PRIOR, SENSOR, Q, R, moved, place, wrapped


def simulate(generator, frames, sight=4, noise=Q):
    """True poses (K, 3, 3), the problem, and the frames; the fourth frame sees nothing."""
    world = generator.uniform([-4, -4], [12, 14], (14, 2))
    true = np.eye(3) @ exp(generator.normal(size=3) * np.sqrt(np.diag(PRIOR)))
    states, told = [], []
    for k in range(frames):
        step = se2(0.6, 0.0, 0.12)
        if k > 0:
            true = true @ step @ exp(generator.normal(size=3) * np.sqrt(np.diag(noise)))
        far = np.linalg.norm(world - true[:2, 2], axis=1)
        near = np.flatnonzero((far < 7) & (far > 1))
        those = generator.permutation(near)[: 0 if k == 3 else sight]
        z = SENSOR.predict(true, world[those]) + generator.normal(size=(len(those), 2)) * np.sqrt(np.diag(R))
        z[:, 1] = wrapped(z[:, 1])
        odometry = (step, noise) if k > 0 else (np.eye(3), np.zeros((3, 3)))
        told.append(Frame(k, 0.2 * k, *odometry, 10 + those, z, np.tile(R, (len(those), 1, 1))))
        states.append(true)
    return np.array(states), Problem(np.eye(3), PRIOR, SENSOR), told


DONE = {}


def once(program, problem, frames):
    """What a program of our own says of a drive: to explain a mistake, the same is asked many times."""
    key = program.__name__, frames[0].z.tobytes(), frames[-1].z.tobytes()
    if key not in DONE:
        if len(DONE) > 8:
            DONE.clear()
        DONE[key] = program(problem, frames)
    return DONE[key]


def ekf_slam(problem, frames):
    return along(EkfSlam(problem), frames)


def fej_ekf(problem, frames):
    return along(FirstEstimatesEkf(problem), frames)


def along(back_end, frames):
    """Names of the landmarks; pose, its covariance, the landmarks and theirs; at every frame."""
    told = []
    for frame in frames:
        back_end.update(frame)
        estimate, seen = back_end.estimate(), back_end.landmarks()
        order = np.argsort(seen.ids)
        parts = (estimate.T_world_body, estimate.P, seen.positions[order], seen.covariances[order])
        told.append((seen.ids[order], parts))
    return told


def gaps_to(functions, program, problem, frames, policy):
    """Largest differences in pose, its covariance, the landmarks and theirs, over all frames."""
    handle = functions.construct("SlidingWindow", problem, {"window": 1, "iterations": 1, "policy": policy})
    gaps = np.zeros(4)
    for frame, (ids, parts) in zip(frames, once(program, problem, frames), strict=True):
        answer = functions.step(handle, frame, landmarks=True)
        order = np.argsort(answer.landmarks.ids)
        if not np.array_equal(answer.landmarks.ids[order], ids):
            return np.full(4, np.inf)
        told = answer.landmarks.positions[order], answer.landmarks.covariances[order]
        own = (answer.estimate.T_world_body, answer.estimate.P, *told)
        sizes = [np.abs(mine - theirs).max(initial=0.0) for mine, theirs in zip(own, parts, strict=True)]
        gaps = np.maximum(gaps, sizes)
    return gaps


def filters(functions, generator):
    """A window of one pose, solved once, against two filters in covariance form."""
    _, problem, frames = simulate(generator, 7, sight=3)
    latest = gaps_to(functions, ekf_slam, problem, frames, "latest")
    # First estimates disagree about which way the robot looked: noise that is round does not care.
    round_noise = np.diag([0.05, 0.05, 0.015]) ** 2
    _, problem, frames = simulate(generator, 7, sight=3, noise=round_noise)
    fej = gaps_to(functions, fej_ekf, problem, frames, "fej")
    return {
        "latest estimates: pose and map are EKF-SLAM's at every frame": max(latest[0], latest[2]),
        "latest estimates: covariances are EKF-SLAM's at every frame": max(latest[1], latest[3]),
        "first estimates: pose and map are the FEJ-EKF's at every frame": max(fej[0], fej[2]),
        "first estimates: covariances are the FEJ-EKF's at every frame": max(fej[1], fej[3]),
    }


def smoother(functions, generator):
    """All poses kept and solved to the end, against scipy's minimum of the same cost."""
    _, problem, frames = simulate(generator, 6, sight=3)
    handle = functions.construct("SlidingWindow", problem, {"iterations": 6})
    answer = None
    for frame in frames:
        answer = functions.step(handle, frame, landmarks=True)
    poses, landmarks, ids = once(minimum, problem, frames)
    order = np.argsort(answer.landmarks.ids)
    if not np.array_equal(answer.landmarks.ids[order], np.sort(ids)):
        return {"every landmark that was seen is in the map": np.inf}
    return {
        "the last pose is that of the batch solution": float(
            np.abs(local(answer.estimate.T_world_body, se2(*poses[-1]))).max()
        ),
        "the map is that of the batch solution": float(
            np.abs(answer.landmarks.positions[order] - landmarks[np.argsort(ids)]).max()
        ),
    }


def minimum(problem, frames):
    """The most likely poses and landmarks, with the plane's points as complex numbers."""
    poses, landmarks, ids = [np.zeros(3)], [], []
    for frame in frames:
        if frame.k > 0:
            T = frame.T_prev_body
            poses.append(moved(poses[-1], [T[0, 2], T[1, 2], np.arctan2(T[1, 0], T[0, 0])]))
        for name, z in zip(frame.ids.tolist(), frame.z, strict=True):
            if name not in ids:
                ids.append(name)
                landmarks.append(place(poses[-1], z))
    split = 3 * len(poses)

    def whitened(x):
        p, heading = x[0:split:3] + 1j * x[1:split:3], x[2:split:3]
        points = x[split::2] + 1j * x[split + 1 :: 2]
        parts = [np.linalg.solve(np.linalg.cholesky(problem.P), x[:3])]
        for frame in frames:
            k = frame.k
            if k > 0:
                T = frame.T_prev_body
                d, turn = T[0, 2] + 1j * T[1, 2], np.arctan2(T[1, 0], T[0, 0])
                gap = ((p[k] - p[k - 1]) * np.exp(-1j * heading[k - 1]) - d) * np.exp(-1j * turn)
                r = [gap.real, gap.imag, wrapped(heading[k] - heading[k - 1] - turn)]
                parts.append(np.linalg.solve(np.linalg.cholesky(frame.Q), r))
            for name, z, noise in zip(frame.ids.tolist(), frame.z, frame.R, strict=True):
                way = (points[ids.index(name)] - p[k]) * np.exp(-1j * heading[k])
                r = [abs(way) - z[0], wrapped(np.angle(way) - z[1])]
                parts.append(np.linalg.solve(np.linalg.cholesky(noise), r))
        return np.concatenate(parts)

    start = np.concatenate([np.ravel(poses), np.ravel(landmarks)])
    x = least_squares(whitened, start, jac="3-point", xtol=1e-14, ftol=1e-14, gtol=1e-12).x
    return x[:split].reshape(-1, 3), x[split:].reshape(-1, 2), np.array(ids)


def dial(functions, generator):
    """Everything that windows of two lengths say along a drive, with either policy."""
    rows = []
    _, problem, frames = simulate(generator, 6, sight=3)
    for length, policy in ((2, "latest"), (4, "fej")):
        settings = {"window": length, "iterations": 2, "policy": policy}
        handle = functions.construct("SlidingWindow", problem, settings)
        for frame in frames:
            answer = functions.step(handle, frame, landmarks=True)
            order = np.argsort(answer.landmarks.ids)
            parts = (answer.landmarks.positions[order], answer.landmarks.covariances[order])
            rows += [answer.estimate.T_world_body, answer.estimate.P, *parts]
    return rows


def drive(functions, generator):
    """A window of three poses along a drive."""
    states, problem, frames = simulate(generator, 9, sight=3)
    handle = functions.construct("SlidingWindow", problem, {"window": 3, "iterations": 2})
    poses, covariances = [], []
    for frame in frames:
        told = functions.step(handle, frame).estimate
        poses.append(told.T_world_body)
        covariances.append(told.P)
    poses = np.array(poses)
    paths = {"path": poses[:, :2, 2], "true_path": states[:, :2, 2]}
    return Track(0.2 * np.arange(len(states)), local(poses, states), np.array(covariances), **paths)


def long_drive(functions, generator):
    _, problem, frames = simulate(generator, 30)
    handle = functions.construct("SlidingWindow", problem, {"window": 3, "iterations": 2})
    for frame in frames:
        functions.step(handle, frame)
