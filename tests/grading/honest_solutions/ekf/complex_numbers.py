"""The plane as complex numbers; information form of the update."""

import numpy as np


def wrap(angle):
    return np.angle(np.exp(1j * angle))


def motion(state, control, dt, wheelbase):
    place = complex(state[0], state[1]) + control[0] * dt * np.exp(1j * state[2])
    return [place.real, place.imag, state[2] + control[0] * dt * np.tan(control[1]) / wheelbase]


def measurement(state, landmark):
    away = complex(*landmark) - complex(*state[:2])
    return np.array([abs(away), np.angle(away * np.exp(-1j * state[2]))])


def measurement_jacobian(state, landmark):
    away = complex(*landmark) - complex(*state[:2])
    unit = away / abs(away)
    return np.array([[-unit.real, -unit.imag, 0.0], [unit.imag / abs(away), -unit.real / abs(away), -1.0]])


def update(mean, covariance, y, H, noise):
    weight = np.linalg.solve(noise, H).T
    P = np.linalg.inv(np.linalg.inv(covariance) + weight @ H)
    return mean + P @ weight @ y, P
