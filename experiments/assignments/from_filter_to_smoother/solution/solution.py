"""From filter to smoother: a sliding window (Sibley 2006; first estimates: Dong-Si and Mourikis 2011)."""

import numpy as np

from slamcmp.geometry import se2
from slamcmp.types import Estimate, Landmarks


def wrap(angle):
    """The same angle in (-π, π]."""
    return np.pi - np.mod(np.pi - angle, 2 * np.pi)


def turned(angle):
    """Rotation matrix (2, 2)."""
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def coordinates(T):
    """x, y and heading of a pose T (3, 3)."""
    return np.array([T[0, 2], T[1, 2], np.arctan2(T[1, 0], T[0, 0])])


def axes_of(pose):
    """Turns an error in the robot's axes into one in the world's, (3, 3)."""
    axes = np.eye(3)
    axes[:2, :2] = turned(pose[2])
    return axes


def odometry(pose, after, motion):
    """Residual (3,) of a motion between two poses, and its Jacobians by each (3, 3)."""
    back, to_after = turned(pose[2]).T, turned(motion[2]).T
    way = back @ (after[:2] - pose[:2])
    r = np.array([*(to_after @ (way - motion[:2])), wrap(after[2] - pose[2] - motion[2])])
    J_pose, J_after = -np.eye(3), np.eye(3)
    J_pose[:2, :2], J_after[:2, :2] = -to_after @ back, to_after @ back
    J_pose[:2, 2] = to_after @ [way[1], -way[0]]
    return r, J_pose, J_after


def sight(pose, landmark, z):
    """Residual (2,) of a sight, and its Jacobians by the pose (2, 3) and the landmark (2, 2)."""
    x, y = landmark - pose[:2]
    far = np.hypot(x, y)
    r = np.array([far - z[0], wrap(np.arctan2(y, x) - pose[2] - z[1])])
    J_landmark = np.array([[x / far, y / far], [-y / far**2, x / far**2]])
    return r, np.column_stack([-J_landmark, [0.0, -1.0]]), J_landmark


def place(pose, z):
    """The landmark (2,) that a pose sees like that."""
    angle = pose[2] + z[1]
    return pose[:2] + z[0] * np.array([np.cos(angle), np.sin(angle)])


def construct(window, poses_at, landmarks_at):
    """Normal equations of the whole window."""
    poses, landmarks, prior = window["poses"], window["landmarks"], window["prior"]
    split = 3 * len(poses)
    size = split + 2 * len(landmarks)
    Lam, eta = np.zeros((size, size)), np.zeros(size)

    old = prior_rows(prior, split)
    change = np.concatenate([poses[0], landmarks.ravel()])[: len(old)] - prior["centre"]
    change[2] = wrap(change[2])
    Lam[np.ix_(old, old)] += prior["Lam"]
    eta[old] += prior["eta"] - prior["Lam"] @ change

    def add(r, covariance, blocks):
        columns = np.concatenate([start + np.arange(block.shape[1]) for start, block in blocks])
        J = np.hstack([block for _, block in blocks])
        weighted = np.linalg.solve(covariance, J).T
        Lam[np.ix_(columns, columns)] += weighted @ J
        eta[columns] -= weighted @ r

    for i, (motion, Q) in enumerate(zip(window["motions"], window["Q"], strict=True)):
        r, _, _ = odometry(poses[i], poses[i + 1], motion)
        _, J_pose, J_after = odometry(poses_at[i], poses_at[i + 1], motion)
        add(r, Q, [(3 * i, J_pose), (3 * i + 3, J_after)])
    seen = zip(window["pose_of"], window["landmark_of"], window["z"], window["R"], strict=True)
    for i, number, z, R in seen:
        r, _, _ = sight(poses[i], landmarks[number], z)
        _, J_pose, J_landmark = sight(poses_at[i], landmarks_at[number], z)
        add(r, R, [(3 * i, J_pose), (split + 2 * number, J_landmark)])
    return Lam, eta


def prior_rows(prior, split):
    """Where the prior's variables stand in a state whose landmarks begin at ``split``."""
    return np.concatenate([np.arange(3), split + np.arange(len(prior["eta"]) - 3)])


def solve(window, Lam, eta):
    """One Gauss–Newton step."""
    dx = np.linalg.solve(Lam, eta)
    split = 3 * len(window["poses"])
    poses = window["poses"] + dx[:split].reshape(-1, 3)
    poses[:, 2] = wrap(poses[:, 2])
    return poses, window["landmarks"] + dx[split:].reshape(-1, 2)


def schur(Lam, eta, keep):
    """What the system says about the rows that stay."""
    drop = np.setdiff1d(np.arange(len(eta)), keep)
    C = np.linalg.solve(Lam[np.ix_(drop, drop)], Lam[np.ix_(drop, keep)]).T
    Lam_keep = Lam[np.ix_(keep, keep)] - C @ Lam[np.ix_(drop, keep)]
    return (Lam_keep + Lam_keep.T) / 2, eta[keep] - C @ eta[drop]


def marginalise(window, newest, poses_at, landmarks_at):
    """All that was known up to pose ``newest``, as a prior on it and on the landmarks."""
    past = window["pose_of"] <= newest
    known = (len(window["prior"]["eta"]) - 3) // 2
    known = max(known, int(window["landmark_of"][past].max(initial=-1)) + 1)
    part = {
        "poses": window["poses"][: newest + 1],
        "landmarks": window["landmarks"][:known],
        "motions": window["motions"][:newest],
        "Q": window["Q"][:newest],
        **{name: window[name][past] for name in ("pose_of", "landmark_of", "z", "R")},
        "prior": window["prior"],
    }
    Lam, eta = construct(part, poses_at[: newest + 1], landmarks_at[:known])
    Lam, eta = schur(Lam, eta, np.arange(3 * newest, len(eta)))
    centre = np.concatenate([part["poses"][newest], part["landmarks"].ravel()])
    first = np.concatenate([poses_at[newest], landmarks_at[:known].ravel()])
    return Lam, eta, centre, first


def points(window, policy):
    """Where Jacobians are taken."""
    poses, landmarks = np.array(window["poses"]), np.array(window["landmarks"])
    if policy == "fej":
        first = window["prior"]["first"]
        poses[0] = first[:3]
        landmarks[: (len(first) - 3) // 2] = first[3:].reshape(-1, 2)
    return poses, landmarks


def world_motions(poses, landmarks):
    """The whole world moved along x, along y, and turned about the origin."""
    N = np.zeros((3 * len(poses) + 2 * len(landmarks), 3))
    for start, (x, y) in zip(range(0, 3 * len(poses), 3), poses[:, :2], strict=True):
        N[start : start + 3] = [[1, 0, -y], [0, 1, x], [0, 0, 1]]
    for start, (x, y) in zip(range(3 * len(poses), len(N), 2), landmarks, strict=True):
        N[start : start + 2] = [[1, 0, -y], [0, 1, x]]
    return N


class SlidingWindow:
    """The dial: ``window`` poses are kept, solved ``iterations`` times a frame, linearised by ``policy``."""

    def __init__(self, problem, *, window=None, iterations=3, policy="latest"):
        self.length, self.iterations, self.policy = window, iterations, policy
        pose = coordinates(problem.T_world_body)
        axes = axes_of(pose)
        Lam = np.linalg.inv(axes @ problem.P @ axes.T)
        self.ids = []
        self.state = {
            "poses": pose[None],
            "landmarks": np.empty((0, 2)),
            "motions": np.empty((0, 3)),
            "Q": np.empty((0, 3, 3)),
            "pose_of": np.empty(0, dtype=int),
            "landmark_of": np.empty(0, dtype=int),
            "z": np.empty((0, 2)),
            "R": np.empty((0, 2, 2)),
            "prior": {"Lam": Lam, "eta": np.zeros(3), "centre": pose, "first": pose},
        }

    def update(self, frame):
        """Cost construction, Gauss–Newton, marginalisation."""
        self._extend(frame)
        state = self.state
        for _ in range(self.iterations):
            at = points(state, self.policy)
            Lam, eta = construct(state, *at)
            before = dict(state)
            state["poses"], state["landmarks"] = solve(state, Lam, eta)
        self.Lam = Lam
        newest = -1 if self.length is None else len(state["poses"]) - self.length
        if newest >= 0:
            # With the values before the last step: nothing is linearised again after solving.
            prior = marginalise(before, newest, *at)
            state["prior"] = dict(zip(("Lam", "eta", "centre", "first"), prior, strict=True))
            self._forget(newest)

    def _extend(self, frame):
        """The frame's pose where odometry takes it, new landmarks where it sees them, and all sights."""
        state = self.state
        if frame.k > 0:
            motion = coordinates(frame.T_prev_body)
            last = state["poses"][-1]
            new = last + axes_of(last) @ motion
            new[2] = wrap(new[2])
            state["poses"] = np.vstack([state["poses"], new])
            state["motions"] = np.vstack([state["motions"], motion])
            state["Q"] = np.concatenate([state["Q"], frame.Q[None]])
        for name, z in zip(frame.ids.tolist(), frame.z, strict=True):
            if name not in self.ids:
                self.ids.append(name)
                state["landmarks"] = np.vstack([state["landmarks"], place(state["poses"][-1], z)])
        numbers = np.array([self.ids.index(name) for name in frame.ids.tolist()], dtype=int)
        here = np.full(len(numbers), len(state["poses"]) - 1)
        new = {"pose_of": here, "landmark_of": numbers, "z": frame.z, "R": frame.R}
        for name, values in new.items():
            state[name] = np.concatenate([state[name], values])

    def _forget(self, newest):
        """Drop what the prior holds now."""
        state = self.state
        for name in ("poses", "motions", "Q"):
            state[name] = state[name][newest:]
        later = state["pose_of"] > newest
        for name in ("pose_of", "landmark_of", "z", "R"):
            state[name] = state[name][later]
        state["pose_of"] = state["pose_of"] - newest

    def estimate(self):
        """Pose and its covariance in the body tangent."""
        pose = self.state["poses"][-1]
        last = self._split() - 3
        P = np.linalg.inv(self.Lam)[last : last + 3, last : last + 3]
        return Estimate(se2(*pose), axes_of(pose).T @ P @ axes_of(pose))

    def landmarks(self):
        """The map."""
        Sigma, split = np.linalg.inv(self.Lam), self._split()
        blocks = [Sigma[i : i + 2, i : i + 2] for i in range(split, len(Sigma), 2)]
        return Landmarks(self.ids, self.state["landmarks"], np.array(blocks).reshape(-1, 2, 2))

    def _split(self):
        return len(self.Lam) - 2 * len(self.ids)
