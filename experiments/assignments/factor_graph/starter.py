"""Factor graph: fill in the functions and the class, and hand in this file as factor_graph.py.

The variables are K poses, homogeneous matrices T_world_body (3, 3) as one array (K, 3, 3), and L landmarks
(L, 2) in the world [m]. A pose is moved in its BODY tangent, T exp(step) with step = (x, y, heading) in m and
rad; a landmark by adding. All steps in one vector dx (3 K + 2 L,): poses first, pose i at 3 i, then the
landmarks, landmark l at 3 K + 2 l.

A factor answers with its WHITENED residual and the Jacobians of it: with the covariance S of what is
observed and S = L Lᵀ (numpy.linalg.cholesky), these are L⁻¹ r and L⁻¹ J, where r is predicted minus observed
and J the derivative of r by the step of one variable. The cost is half the sum of their squares.

The sensor is given, so are functions of poses (slamcmp.geometry):

    SENSOR.predict(T, landmark)       h: (range [m], bearing [rad])
    SENSOR.jacobians(T, landmark)     derivatives of h by the pose's step (2, 3) and by the landmark (2, 2)
    SENSOR.residual(a, b)             a - b, the bearing wrapped
    SENSOR.invert(T, z)               the landmark that would be seen like that
    exp(step), log(T), inverse(T)     T == exp(log(T))
    adjoint(T)                        T exp(step) inverse(T) == exp(adjoint(T) @ step)
    right_jacobian(r)                 log(exp(r) exp(step)) ≈ r + inverse of it @ step, for small steps
"""

import numpy as np

from slamcmp.geometry import adjoint, exp, inverse, log, right_jacobian
from slamcmp.models.sensors import RangeBearing
from slamcmp.types import Estimate, Landmarks

SENSOR = RangeBearing()


def prior_factor(T, T_prior, P):
    """The factor of what is known about one pose beforehand: T = T_prior exp(r) with r ~ N(0, P).

    Args:
        T: current value of the pose, (3, 3).
        T_prior: its mean beforehand, (3, 3).
        P: its covariance in the body tangent, (3, 3).

    Returns:
        whitened residual (3,), and its Jacobian by the pose's step (3, 3).
    """
    raise NotImplementedError


def odometry_factor(T_i, T_j, T_ij, Q):
    """The factor of an odometry between two poses: T_j = T_i T_ij exp(r) with r ~ N(0, Q).

    Args:
        T_i, T_j: current values of the poses, (3, 3).
        T_ij: the increment that was measured, (3, 3).
        Q: its covariance in the tangent of the second body frame, (3, 3).

    Returns:
        whitened residual (3,), and its Jacobians by the steps of T_i (3, 3) and of T_j (3, 3).
    """
    raise NotImplementedError


def observation_factor(T, landmark, z, R):
    """The factor of one observation: h(T, landmark) = z + r, with r ~ N(0, R).

    Args:
        T: current value of the pose, (3, 3).
        landmark: current value of the landmark, (2,).
        z: range [m] and bearing [rad], (2,).
        R: covariance of z, (2, 2).

    Returns:
        whitened residual (2,), the bearing's difference wrapped before it is whitened; and its Jacobians by
        the pose's step (2, 3) and by the landmark (2, 2).
    """
    raise NotImplementedError


def linear_system(factors, size):
    """The normal equations Lam dx = eta of the linearised cost.

    Args:
        factors: a list of (r, blocks), one a factor: r (d,) is whitened, and blocks is a list of (start, J):
            J (d, w) is the Jacobian of r by the w entries of dx that begin at ``start``.
        size: entries of dx.

    Returns:
        Lam (size, size), all of it and not only one half, and eta (size,).
    """
    raise NotImplementedError


def gauss_newton_step(poses, landmarks, Lam, eta):
    """Solve the normal equations and move every variable by its part of dx.

    Args:
        poses: (K, 3, 3).
        landmarks: (L, 2); L may be 0.
        Lam, eta: (3 K + 2 L, 3 K + 2 L) and (3 K + 2 L,).

    Returns:
        poses (K, 3, 3) and landmarks (L, 2).
    """
    raise NotImplementedError


def marginalise(Lam, eta, keep):
    """What the normal equations say about some variables once all others are eliminated.

    Args:
        Lam, eta: (n, n) and (n,).
        keep: rows that stay, rising, (k,); all others go.

    Returns:
        Lam (k, k) and eta (k,) of the rows that stay.
    """
    raise NotImplementedError


def marginal_covariance(Lam, keep):
    """Covariance of some variables, with nothing assumed about the others.

    Args:
        Lam: information matrix, (n, n).
        keep: rows, rising, (k,).

    Returns:
        (k, k).
    """
    raise NotImplementedError


def smooth(graph, poses, landmarks, iterations):
    """Build the cost of a whole graph and minimise it: nothing is marginalised.

    Every iteration linearises all factors at the current values and takes one step.

    Args:
        graph: a dictionary with
            "prior": {"T": (3, 3), "P": (3, 3)} of pose 0;
            "odometry": a list of {"i": i, "j": j, "T_ij": (3, 3), "Q": (3, 3)} between poses i and j;
            "observations": a list of {"i": i, "landmark": l, "z": (2,), "R": (2, 2)}: l seen from pose i.
        poses: values to start from, (K, 3, 3).
        landmarks: likewise, (L, 2).
        iterations: how many.

    Returns:
        poses (K, 3, 3), landmarks (L, 2), and the covariance (3, 3) of the last pose, from the Lam of the
        last iteration.
    """
    raise NotImplementedError


class WindowOne:
    """A graph with a window of one pose, fed one frame at a time: the back end.

    For every frame, in the lecture's three steps: the cost gets the new pose, at T_world_body @ T_prev_body,
    with its odometry factor, the new landmarks, where SENSOR.invert sees them from that pose, and a factor
    for every observation; one Gauss-Newton step on all variables; then the past pose is marginalised. What
    marginalising leaves is the prior of the next frame.
    """

    def __init__(self, problem):
        """problem.T_world_body (3, 3) and problem.P (3, 3) are the prior of the pose at frame 0."""
        raise NotImplementedError

    def update(self, frame):
        """frame has k, T_prev_body, Q, ids (m,), z (m, 2), R (m, 2, 2); frame 0 has no motion."""
        raise NotImplementedError

    def estimate(self):
        """Estimate(T_world_body, P of the pose (3, 3) in the body tangent)."""
        raise NotImplementedError

    def landmarks(self):
        """Landmarks(ids, positions (L, 2), covariances (L, 2, 2)), in the order in which they joined."""
        raise NotImplementedError
