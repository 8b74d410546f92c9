"""Data of the sliding window's tests: windows of a robot on a bend, drives, and three other programs.

EKF-SLAM and the FEJ-EKF are slamcmp's own (covariance form, poses as matrices); the batch solution is
scipy's, of residuals written down anew and differentiated numerically.
"""

import numpy as np
from scipy.optimize import least_squares

from slamcmp.backends.filters.ekf_slam import EkfSlam
from slamcmp.backends.filters.variants import FirstEstimatesEkf
from slamcmp.geometry import exp, local, se2
from slamcmp.grading.run.trial import Case, Track
from slamcmp.models.sensors import RangeBearing
from slamcmp.types import Frame, Problem

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


def rest_of(some, newest, prior):
    """The window after its past has become a prior."""
    later = some["pose_of"] > newest
    names = ("pose_of", "landmark_of", "z", "R")
    rest = {name: some[name][later] for name in names}
    rest["pose_of"] = rest["pose_of"] - newest
    rest |= {name: some[name][newest:] for name in ("poses", "motions", "Q")}
    return rest | {"landmarks": some["landmarks"], "prior": dict(zip(NAMES, prior, strict=True))}


def put_together(functions, generator):
    """A window solved, its past summarised, and the rest solved again, with first estimates."""
    some = window(generator, poses=5, landmarks=5, known=2)
    at = None
    for _ in range(2):
        at = functions.call("points", some, "fej")
        before = some
        Lam, eta = functions.call("construct", some, *at)
        poses, landmarks = functions.call("solve", some, Lam, eta)
        some = {**some, "poses": np.asarray(poses), "landmarks": np.asarray(landmarks)}
    prior = functions.call("marginalise", before, 2, *at)
    some = rest_of(some, 2, [np.asarray(part) for part in prior])
    Lam, eta = functions.call("construct", some, *functions.call("points", some, "fej"))
    poses, landmarks = functions.call("solve", some, Lam, eta)
    kept, _ = functions.call("schur", np.asarray(Lam), np.asarray(eta), np.arange(3, 6))
    return [poses, landmarks, np.linalg.inv(kept)]


def free(generator, **sizes):
    """A window that nobody told where it is."""
    some = window(generator, known=0, **sizes)
    some["prior"] = {name: np.zeros(3) for name in NAMES} | {"Lam": np.zeros((3, 3))}
    some["prior"]["centre"] = some["prior"]["first"] = some["poses"][0].copy()
    return some


def shaken(generator, some):
    """What new measurements do to the estimates: they move, and the past stays linearised where it was."""
    poses = some["poses"] + generator.normal(size=some["poses"].shape) * [0.2, 0.2, 0.1]
    return {**some, "poses": poses, "landmarks": some["landmarks"] + 0.2 * generator.normal(size=(5, 2))}


def after_the_past(functions, generator, policy):
    """Information matrix of a window that nobody told where it is, once its past has become a prior."""
    some = free(generator, poses=5, landmarks=5)
    prior = functions.call("marginalise", some, 2, *functions.call("points", some, policy))
    some = shaken(generator, rest_of(some, 2, [np.asarray(part) for part in prior]))
    at = functions.call("points", some, policy)
    Lam, _ = functions.call("construct", some, *at)
    return np.asarray(Lam), at


def statements(functions, generator):
    """Marginals of Gaussians, and what nobody can see."""
    some = free(generator, poses=3)
    at = elsewhere(generator, some)
    Lam_free, _ = functions.call("construct", some, *at)
    N = functions.call("world_motions", *at)
    first = functions.call("marginalise", some, 1, *at)
    left = first[3]
    N_left = functions.call("world_motions", left[None, :3], left[3:].reshape(-1, 2))

    fej, fej_at = after_the_past(functions, generator, "fej")
    N_fej = functions.call("world_motions", *fej_at)

    whole = window(generator, poses=4)
    here = whole["poses"], whole["landmarks"]
    Lam, eta = functions.call("construct", whole, *here)
    everything = functions.call("solve", whole, Lam, eta)
    rest = rest_of(whole, 2, functions.call("marginalise", whole, 2, *here))
    Lam_rest, eta_rest = functions.call("construct", rest, whole["poses"][2:], whole["landmarks"])
    poses, landmarks = functions.call("solve", rest, Lam_rest, eta_rest)
    tail = np.arange(6, len(eta))

    turn, shift = 0.7, np.array([3.0, -2.0])
    c, s = np.cos(turn), np.sin(turn)
    away = np.array([[c, -s], [s, c]])
    other = {**some, "poses": some["poses"].copy(), "landmarks": some["landmarks"] @ away.T + shift}
    other["poses"][:, :2] = some["poses"][:, :2] @ away.T + shift
    other["poses"][:, 2] = wrapped(some["poses"][:, 2] + turn)
    prior = {**whole["prior"], "Lam": 20 * np.eye(3), "eta": np.zeros(3), "first": some["poses"][0]}
    answers = []
    for each in (some, other):
        held = {**each, "prior": {**prior, "centre": each["poses"][0]}}
        system = functions.call("construct", held, each["poses"], each["landmarks"])
        answers.append(functions.call("solve", held, *system))
    (poses_1, landmarks_1), (poses_2, landmarks_2) = answers
    return {
        "without a prior, moving or turning the whole world at the points of the Jacobians changes nothing": (
            relative(Lam_free @ N, Lam_free)
        ),
        "what marginalising leaves knows nothing of where the world is": relative(
            first[0] @ N_left, first[0]
        ),
        "with first estimates, a window with a summarised past still does not see the whole world turn": (
            relative(fej @ N_fej, fej)
        ),
        "with the past summarised, the rest of the window takes the step that it takes with it": float(
            max(np.abs(poses - everything[0][2:]).max(), np.abs(landmarks - everything[1]).max())
        ),
        "the rest of the window is as certain with the summary as with the past itself": relative(
            np.linalg.inv(Lam_rest) - np.linalg.inv(Lam)[np.ix_(tail, tail)], np.linalg.inv(Lam_rest)
        ),
        "moving the whole world moves the solution with it": float(
            max(
                np.abs(poses_1[:, :2] @ away.T + shift - poses_2[:, :2]).max(),
                np.abs(wrapped(poses_1[:, 2] + turn - poses_2[:, 2])).max(),
                np.abs(landmarks_1 @ away.T + shift - landmarks_2).max(),
            )
        ),
    }


def relative(matrix, scale):
    return float(np.abs(matrix).max() / np.abs(scale).max())


def heading_from_nothing(functions, generator):
    """Standard deviations' worth of information about the world's heading [1/rad], with the latest estimates.

    Nothing told it: the past was linearised at other values than the present.
    """
    Lam, at = after_the_past(functions, generator, "latest")
    turn = functions.call("world_motions", *at)[:, 2]
    return float(np.sqrt(max(turn @ Lam @ turn, 0.0)))


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
