"""From filter to smoother: fill in the functions and the class, and hand in as from_filter_to_smoother.py.

All numbers are in the world: a pose is (x [m], y [m], heading [rad]), a landmark (x, y), and a step is added
to them. The state x holds all of a window: poses first, pose i at 3 i, then the landmarks, landmark l at
3 K + 2 l. Headings stay in (-π, π]: use ``wrap``.

A WINDOW is a dictionary; numpy arrays stand in it, K poses, L landmarks and M sights:

    "poses"        current values, oldest first, (K, 3)
    "landmarks"    current values, in the order in which they were first seen, (L, 2)
    "motions", "Q"                 what odometry measured from pose i to i + 1: (dx, dy, turn) in the axes of
                                   pose i, (K-1, 3), and its covariance in those of i + 1, (K-1, 3, 3)
    "pose_of", "landmark_of"       who saw whom: index of the pose and of the landmark, (M,) each
    "z", "R"                       range [m] and bearing [rad], (M, 2), and their covariances (M, 2, 2)
    "prior"        what is left of the past, a dictionary:
        "Lam", "eta"               the cost ½ δᵀ Lam δ - etaᵀ δ on pose 0 and the first landmarks, as many as
                                   there are entries, (s, s) and (s,)
        "centre"                   the values from which δ is measured: δ = x - centre, (s,); mind the heading
        "first"                    where Jacobians were taken when the past became this prior, (s,)

What is given, residuals (predicted minus observed) with their Jacobians, is at the top of this file.
"""

import numpy as np

from slamcmp.geometry import se2
from slamcmp.types import Estimate, Landmarks


def wrap(angle):
    """The same angle in (-π, π]."""
    return np.pi - np.mod(np.pi - angle, 2 * np.pi)


def turned(angle):
    """Rotation matrix (2, 2) of a heading."""
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
    """Step 1, the cost: its normal equations Lam dx = eta about the window's current values.

    The cost is the prior's plus ½ rᵀ S⁻¹ r of every motion (S = Q) and every sight (S = R). Residuals are
    those of the current values; Jacobians are taken at ``poses_at`` and ``landmarks_at``.

    Args:
        window: K poses, L landmarks, as above.
        poses_at, landmarks_at: where Jacobians are taken, (K, 3) and (L, 2).

    Returns:
        Lam (3 K + 2 L, 3 K + 2 L), all of it and not only one half, and eta (3 K + 2 L,).
    """
    raise NotImplementedError


def solve(window, Lam, eta):
    """Step 2, Gauss-Newton: one step from the window's current values.

    Returns:
        poses (K, 3), headings in (-π, π], and landmarks (L, 2).
    """
    raise NotImplementedError


def schur(Lam, eta, keep):
    """What normal equations say about some variables once all others are eliminated.

    Args:
        Lam, eta: (n, n) and (n,).
        keep: rows that stay, rising, (k,); all others go. All may stay.

    Returns:
        Lam (k, k) and eta (k,) of the rows that stay.
    """
    raise NotImplementedError


def marginalise(window, newest, poses_at, landmarks_at):
    """Step 3, marginalisation: all that was known when the robot stood at pose ``newest``, as a new prior.

    That is the old prior, the motions up to this pose, and the sights from it and from the poses before it.
    The poses before it are eliminated. The prior is on this pose and on the first landmarks, as many as the
    old prior and these sights reach.

    Args:
        window: K poses, L landmarks.
        newest: index of that pose, 0 to K - 1; with 0 nothing is eliminated.
        poses_at, landmarks_at: where Jacobians are taken, (K, 3) and (L, 2).

    Returns:
        Lam (s, s), eta (s,), centre (s,): the window's current values, and first (s,): those of poses_at and
        landmarks_at.
    """
    raise NotImplementedError


def points(window, policy):
    """Where Jacobians are to be taken.

    "latest": at the current values. "fej", first-estimates Jacobians: what the prior is on stays where it was
    linearised when the past became the prior, all else is at its current value.

    Args:
        window: K poses, L landmarks.
        policy: "latest" or "fej".

    Returns:
        poses (K, 3) and landmarks (L, 2); the window's own arrays stay as they are.
    """
    raise NotImplementedError


def world_motions(poses, landmarks):
    """How the state changes when the whole world is moved a little: what no sensor of the robot can see.

    Args:
        poses, landmarks: (K, 3) and (L, 2).

    Returns:
        N (3 K + 2 L, 3): the state's derivative by a shift along x, one along y, and a turn about the origin.
    """
    raise NotImplementedError


class SlidingWindow:
    """The dial, fed one frame at a time: the back end.

    For every frame: the new pose joins where odometry takes the last one, new landmarks where that pose sees
    them (``place``), and the motion and the sights with them; then ``iterations`` times: points, construct,
    solve. At the end, if ``window`` poses or more are there, marginalise makes a prior of everything up to
    the oldest of the newest ``window`` poses, and what the prior holds now is dropped. It gets the values
    that the last Gauss-Newton step started from, and the points where its Jacobians were taken: nothing is
    linearised again after solving.
    """

    def __init__(self, problem, *, window=None, iterations=3, policy="latest"):
        """The prior of the pose at frame 0, and the dial's settings.

        Args:
            problem: T_world_body (3, 3), the mean, and P (3, 3) in the robot's own axes.
            window: poses kept; None: all.
            iterations: Gauss-Newton steps a frame.
            policy: as for ``points``.
        """
        raise NotImplementedError

    def update(self, frame):
        """frame has k, T_prev_body, Q, ids (m,), z (m, 2), R (m, 2, 2); frame 0 has no motion."""
        raise NotImplementedError

    def estimate(self):
        """Estimate(T_world_body, P of the pose (3, 3) in the robot's own axes), from the Lam last solved."""
        raise NotImplementedError

    def landmarks(self):
        """Landmarks(ids, positions (L, 2), covariances (L, 2, 2)), in the order in which they joined."""
        raise NotImplementedError
