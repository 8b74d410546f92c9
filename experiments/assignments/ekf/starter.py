"""EKF of a bicycle-model car: fill in the functions and hand in this file as ekf.py.

The state is (x, y, heading) of the rear axle in metres and radians, a control (speed, steering) in m/s and
radians. Write s for the speed, φ for the steering angle, θ for the heading and L for the wheelbase:

    x' = x + s dt cos θ,   y' = y + s dt sin θ,   θ' = θ + s dt tan(φ) / L

An observation of a landmark is (range, bearing); the bearing counts from the car's heading,
counter-clockwise, in (-π, π]. Covariances are of (x, y, heading) in the world. Leave the heading of a state
as it comes out: only bearings and their differences are wrapped.
"""

import numpy as np


def motion(state, control, dt, wheelbase):
    """g: the state (3,) after dt seconds with the control (2,)."""
    raise NotImplementedError


def motion_jacobian(state, control, dt, wheelbase):
    """G: derivative of g by the state, (3, 3)."""
    raise NotImplementedError


def measurement(state, landmark):
    """h: range [m] and bearing [rad] of the landmark (2,), as an array (2,)."""
    raise NotImplementedError


def measurement_jacobian(state, landmark):
    """H: derivative of h by the state, (2, 3)."""
    raise NotImplementedError


def innovation(observed, predicted):
    """Observed minus predicted (range, bearing), an array (2,)."""
    raise NotImplementedError


def propagate(covariance, G, process_noise):
    """Covariance (3, 3) after a motion with Jacobian G (problem 6 of the lecture)."""
    raise NotImplementedError


def update(mean, covariance, y, H, noise):
    """Mean (3,) and covariance (3, 3) given stacked innovations.

    Args:
        mean: (3,).
        covariance: (3, 3).
        y: innovations of m landmarks one after another, (2 m,).
        H: their Jacobians, (2 m, 3).
        noise: covariance of the observations, (2 m, 2 m).
    """
    raise NotImplementedError


def ekf_step(mean, covariance, control, dt, wheelbase, process_noise, landmarks, observations, noise):
    """One whole step: move, then one update with all observations of the new place.

    Linearise the motion at the old mean and every observation at the predicted mean.

    Args:
        mean, covariance: before the motion.
        control, dt, wheelbase, process_noise: of the motion.
        landmarks: positions of the m landmarks seen, (m, 2); m may be 0.
        observations: of them, (m, 2).
        noise: covariance of one observation, (2, 2).

    Returns:
        mean (3,) and covariance (3, 3) after the observations.
    """
    raise NotImplementedError
