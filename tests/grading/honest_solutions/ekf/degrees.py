"""Angles in degrees inside, with the covariances scaled to and fro."""

import numpy as np

SCALE = np.array([1.0, 1.0, 180.0 / np.pi])


def wrap(angle):
    degrees = np.degrees(angle)
    return np.radians(180.0 - (180.0 - degrees) % 360.0)


def motion(state, control, dt, wheelbase):
    heading, steering = np.degrees(state[2]), np.degrees(control[1])
    way = control[0] * dt
    turn = np.degrees(way * np.tan(np.radians(steering)) / wheelbase)
    x = state[0] + way * np.cos(np.radians(heading))
    y = state[1] + way * np.sin(np.radians(heading))
    return np.array([x, y, np.radians(heading + turn)])


def propagate(covariance, G, process_noise):
    two = np.outer(SCALE, SCALE)
    G = G * SCALE[:, None] / SCALE
    return (G @ (covariance * two) @ G.T + process_noise * two) / two


def update(mean, covariance, y, H, noise):
    two = np.outer(SCALE, SCALE)
    scale = np.tile([1.0, 180.0 / np.pi], len(y) // 2)
    P, H, y, R = covariance * two, H * scale[:, None] / SCALE, y * scale, noise * np.outer(scale, scale)
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    return (mean * SCALE + K @ y) / SCALE, ((np.eye(3) - K @ H) @ P) / two
