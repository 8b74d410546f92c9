"""One observation after the other, all linearised at the predicted mean."""

import numpy as np

from slamcmp.geometry import exp


def update(T_world_body, landmarks, P, numbers, z, R):
    step = np.zeros(len(P))
    for number, seen, noise in zip(numbers, z, R):
        H = stacked_jacobian(T_world_body, landmarks, [number])
        y = SENSOR.residual(seen, SENSOR.predict(T_world_body, landmarks[number])) - H @ step
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + noise)
        step = step + K @ y
        P = P - K @ H @ P
    return T_world_body @ exp(step[:3]), landmarks + step[3:].reshape(-1, 2), P
