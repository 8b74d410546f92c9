"""Every Jacobian by central differences."""

import numpy as np

from slamcmp.geometry import exp, inverse, log


def differentiated(function, size, step=1e-5):
    columns = []
    for direction in step * np.eye(size):
        columns.append((function(direction) - function(-direction)) / (2 * step))
    return np.array(columns).T


def prior_factor(T, T_prior, P):
    back = inverse(T_prior)
    return whiten(P, log(back @ T), differentiated(lambda step: log(back @ T @ exp(step)), 3))


def odometry_factor(T_i, T_j, T_ij, Q):
    def residual(step_i, step_j):
        return log(inverse(T_ij) @ inverse(T_i @ exp(step_i)) @ T_j @ exp(step_j))

    none = np.zeros(3)
    J_i = differentiated(lambda step: residual(step, none), 3)
    J_j = differentiated(lambda step: residual(none, step), 3)
    return whiten(Q, residual(none, none), J_i, J_j)


def observation_factor(T, landmark, z, R):
    def residual(step, move):
        return SENSOR.residual(SENSOR.predict(T @ exp(step), landmark + move), z)

    at = residual(np.zeros(3), np.zeros(2))
    near = SENSOR.predict(T, landmark)

    def from_here(step, move):
        return SENSOR.residual(SENSOR.predict(T @ exp(step), landmark + move), near)

    J_pose = differentiated(lambda step: from_here(step, np.zeros(2)), 3)
    J_landmark = differentiated(lambda move: from_here(np.zeros(3), move), 2)
    return whiten(R, at, J_pose, J_landmark)
