"""EKF for a bicycle-model car that sees known landmarks (Thrun, Burgard, Fox 2005, table 7.2)."""

import numpy as np


def motion(state, control, dt, wheelbase):
    """g: the state after dt."""
    x, y, heading = state
    speed, steering = control
    turn = speed * np.tan(steering) / wheelbase
    return np.array([x + speed * dt * np.cos(heading), y + speed * dt * np.sin(heading), heading + turn * dt])


def motion_jacobian(state, control, dt, wheelbase):
    """G: derivative of g by the state."""
    heading, speed = state[2], control[0]
    G = np.eye(3)
    G[0, 2] = -speed * dt * np.sin(heading)
    G[1, 2] = speed * dt * np.cos(heading)
    return G


def measurement(state, landmark):
    """h: range and bearing of a landmark."""
    dx, dy = landmark - state[:2]
    return np.array([np.hypot(dx, dy), wrap(np.arctan2(dy, dx) - state[2])])


def measurement_jacobian(state, landmark):
    """H: derivative of h by the state."""
    dx, dy = landmark - state[:2]
    square = dx**2 + dy**2
    r = np.sqrt(square)
    return np.array([[-dx / r, -dy / r, 0.0], [dy / square, -dx / square, -1.0]])


def innovation(observed, predicted):
    """Observed minus predicted, the bearing in (-pi, pi]."""
    difference = observed - predicted
    return np.array([difference[0], wrap(difference[1])])


def propagate(covariance, G, process_noise):
    """Covariance after the motion."""
    return G @ covariance @ G.T + process_noise


def update(mean, covariance, y, H, noise):
    """Mean and covariance given the stacked innovations y."""
    S = H @ covariance @ H.T + noise
    gain = np.linalg.solve(S, H @ covariance).T
    covariance_new = covariance - gain @ H @ covariance
    return mean + gain @ y, (covariance_new + covariance_new.T) / 2


def ekf_step(mean, covariance, control, dt, wheelbase, process_noise, landmarks, observations, noise):
    """Move, then take in all observations of the new place at once."""
    G = motion_jacobian(mean, control, dt, wheelbase)
    predicted = motion(mean, control, dt, wheelbase)
    covariance = propagate(covariance, G, process_noise)
    if len(landmarks) == 0:
        return predicted, covariance
    pairs = list(zip(landmarks, observations, strict=True))
    y = np.concatenate([innovation(z, measurement(predicted, landmark)) for landmark, z in pairs])
    H = np.concatenate([measurement_jacobian(predicted, landmark) for landmark in landmarks])
    return update(predicted, covariance, y, H, np.kron(np.eye(len(pairs)), noise))


def wrap(angle):
    """The same angle in (-pi, pi]."""
    return np.pi - np.mod(np.pi - angle, 2 * np.pi)
