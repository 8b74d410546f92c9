"""EKF-SLAM: fill in the functions and the class, and hand in this file as ekf_slam.py.

The state is the robot's pose, a homogeneous matrix T_world_body (3, 3), and L landmarks (L, 2) in the world.
P (3 + 2 L, 3 + 2 L) is their joint covariance: first the pose's error in the BODY tangent, in the order
(x, y, heading) and defined by T_true = T exp(error), then the landmarks' errors in world axes.

The sensor is given, so are exp, inverse and adjoint of poses:

    SENSOR.predict(T, landmarks)      h: (range [m], bearing [rad]) of one landmark or several
    SENSOR.invert(T, z)               the landmark that would be seen like that
    SENSOR.jacobians(T, landmarks)    H by the pose's error (…, 2, 3) and by the landmark (…, 2, 2)
    SENSOR.residual(z, predicted)     the difference, bearings wrapped
    adjoint(T)                        T exp(error) inverse(T) == exp(adjoint(T) @ error)
"""

import numpy as np

from slamcmp.geometry import adjoint, exp, inverse
from slamcmp.models.sensors import RangeBearing
from slamcmp.types import Estimate, Landmarks

SENSOR = RangeBearing()


def predict(T_world_body, P, T_prev_body, Q):
    """Move by the odometry's increment.

    Args:
        T_world_body: pose, (3, 3).
        P: joint covariance, (3 + 2 L, 3 + 2 L).
        T_prev_body: the increment: the new pose is T_world_body @ T_prev_body.
        Q: its covariance in the tangent of the new body frame, (3, 3).

    Returns:
        the new pose, and P with everything that changes in it.
    """
    raise NotImplementedError


def augment(T_world_body, landmarks, P, z, R):
    """Let one new landmark join the state, last.

    Args:
        T_world_body: pose, (3, 3).
        landmarks: (L, 2); L may be 0.
        P: (3 + 2 L, 3 + 2 L).
        z: observation of the new landmark, (2,).
        R: covariance of the observation, (2, 2).

    Returns:
        landmarks (L + 1, 2) and P (5 + 2 L, 5 + 2 L).
    """
    raise NotImplementedError


def update(T_world_body, landmarks, P, numbers, z, R):
    """One update with all observations at once.

    Args:
        T_world_body, landmarks, P: as above.
        numbers: which landmarks are seen, rows of ``landmarks``, (m,).
        z: observations, (m, 2).
        R: their covariances, (m, 2, 2).

    Returns:
        pose, landmarks and P after the update.
    """
    raise NotImplementedError


class EkfSlam:
    """The whole back end, fed one frame at a time.

    For every frame: predict; let landmarks that are new join from the PREDICTED pose, in the frame's order;
    then one update with the landmarks that were known before.
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
