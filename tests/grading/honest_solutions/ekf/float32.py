"""In single precision throughout, angles wrapped by a complex number."""

import numpy as np


def f(*arrays):
    return [np.asarray(array, dtype=np.float32) for array in arrays]


def wrap(angle):
    return np.angle(np.exp(np.complex64(1j) * np.float32(angle)))


def motion(state, control, dt, wheelbase):
    (x, y, theta), (v, phi), dt, length = f(state, control, dt, wheelbase)
    return np.array(
        [x + v * dt * np.cos(theta), y + v * dt * np.sin(theta), theta + v * dt * np.tan(phi) / length]
    )


def motion_jacobian(state, control, dt, wheelbase):
    state, control, dt = f(state, control, dt)
    s, c = np.sin(state[2]), np.cos(state[2])
    return np.array([[1, 0, -control[0] * dt * s], [0, 1, control[0] * dt * c], [0, 0, 1]], dtype=np.float32)


def measurement(state, landmark):
    state, landmark = f(state, landmark)
    away = landmark - state[:2]
    return np.array([np.hypot(*away), wrap(np.arctan2(away[1], away[0]) - state[2])])


def measurement_jacobian(state, landmark):
    state, landmark = f(state, landmark)
    dx, dy = landmark - state[:2]
    q = dx * dx + dy * dy
    r = np.sqrt(q)
    return np.array([[-dx / r, -dy / r, 0], [dy / q, -dx / q, -1]], dtype=np.float32)


def innovation(observed, predicted):
    observed, predicted = f(observed, predicted)
    return np.array([observed[0] - predicted[0], wrap(observed[1] - predicted[1])])


def propagate(covariance, G, process_noise):
    covariance, G, process_noise = f(covariance, G, process_noise)
    return G @ covariance @ G.T + process_noise


def update(mean, covariance, y, H, noise):
    mean, covariance, y, H, noise = f(mean, covariance, y, H, noise)
    S = H @ covariance @ H.T + noise
    K = covariance @ H.T @ np.linalg.inv(S)
    return mean + K @ y, covariance - K @ H @ covariance
