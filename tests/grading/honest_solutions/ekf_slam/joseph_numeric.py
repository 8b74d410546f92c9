"""Joseph form, and every Jacobian by central differences in the body's axes."""

import numpy as np

from slamcmp.geometry import exp


def differentiated(function, size, step=1e-5):
    columns = []
    for direction in step * np.eye(size):
        columns.append((function(direction) - function(-direction)) / (2 * step))
    return np.array(columns).T


def augment(T_world_body, landmarks, P, z, R):
    G = differentiated(lambda step: SENSOR.invert(T_world_body @ exp(step), z), 3)
    by_z = differentiated(lambda step: SENSOR.invert(T_world_body, z + step), 2)
    position = SENSOR.invert(T_world_body, z)
    size = len(P)
    grown = np.zeros((size + 2, size + 2))
    grown[:size, :size] = P
    grown[size:, :size] = G @ P[:3]
    grown[:size, size:] = grown[size:, :size].T
    grown[size:, size:] = G @ P[:3, :3] @ G.T + by_z @ R @ by_z.T
    return np.concatenate([landmarks, position[None]]), grown


def stacked_jacobian(T_world_body, landmarks, numbers):
    seen = landmarks[numbers]
    predicted = SENSOR.predict(T_world_body, seen)

    def residual(step):
        moved = landmarks + step[3:].reshape(-1, 2)
        return SENSOR.residual(
            SENSOR.predict(T_world_body @ exp(step[:3]), moved[numbers]), predicted
        ).ravel()

    return differentiated(residual, 3 + 2 * len(landmarks))


def update(T_world_body, landmarks, P, numbers, z, R):
    H = stacked_jacobian(T_world_body, landmarks, numbers)
    y = SENSOR.residual(z, SENSOR.predict(T_world_body, landmarks[numbers])).ravel()
    noise = block_diagonal(R)
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + noise)
    left = np.eye(len(P)) - K @ H
    step = K @ y
    return (
        T_world_body @ exp(step[:3]),
        landmarks + step[3:].reshape(-1, 2),
        left @ P @ left.T + K @ noise @ K.T,
    )
