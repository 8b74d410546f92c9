"""Sines and cosines instead of Lie groups, a landmark at a time in loops; nothing of slamcmp's geometry."""

import math

import numpy as np


def matrix(x, y, theta):
    return np.array(
        [[math.cos(theta), -math.sin(theta), x], [math.sin(theta), math.cos(theta), y], [0, 0, 1]]
    )


def predict(T_world_body, P, T_prev_body, Q):
    c, s = T_prev_body[0, 0], T_prev_body[1, 0]
    x, y = T_prev_body[0, 2], T_prev_body[1, 2]
    # A turn of the old body moves the new one sideways.
    A = np.array([[c, s, s * x - c * y], [-s, c, c * x + s * y], [0, 0, 1]])
    F = np.eye(len(P))
    F[:3, :3] = A
    grown = np.zeros_like(P)
    grown[:3, :3] = Q
    a = math.atan2(T_world_body[1, 0], T_world_body[0, 0])
    place = T_world_body[:2, 2] + [math.cos(a) * x - math.sin(a) * y, math.sin(a) * x + math.cos(a) * y]
    return matrix(*place, a + math.atan2(s, c)), F @ P @ F.T + grown


def derivatives(T, landmark):
    body = T[:2, :2].T @ (landmark - T[:2, 2])
    r = math.hypot(*body)
    by_point = np.array([[body[0] / r, body[1] / r], [-body[1] / r**2, body[0] / r**2]])
    by_pose = np.column_stack([-by_point, by_point @ [body[1], -body[0]]])
    return (r, math.atan2(body[1], body[0])), by_pose, by_point @ T[:2, :2].T


def augment(T_world_body, landmarks, P, z, R):
    direction = math.atan2(T_world_body[1, 0], T_world_body[0, 0]) + z[1]
    position = T_world_body[:2, 2] + z[0] * np.array([math.cos(direction), math.sin(direction)])
    _, by_pose, by_landmark = derivatives(T_world_body, position)
    M = np.linalg.inv(by_landmark)
    G = np.zeros((2, len(P)))
    G[:, :3] = -M @ by_pose
    whole = np.vstack([np.eye(len(P)), G])
    grown = whole @ P @ whole.T
    grown[-2:, -2:] += M @ R @ M.T
    return np.vstack([landmarks, position]), grown


def update(T_world_body, landmarks, P, numbers, z, R):
    size = len(P)
    rows, y = [], []
    for i, number in enumerate(numbers):
        predicted, by_pose, by_landmark = derivatives(T_world_body, landmarks[number])
        H = np.zeros((2, size))
        H[:, :3] = by_pose
        H[:, 3 + 2 * number : 5 + 2 * number] = by_landmark
        rows.append(H)
        bearing = z[i][1] - predicted[1]
        while bearing > math.pi:
            bearing -= 2 * math.pi
        while bearing <= -math.pi:
            bearing += 2 * math.pi
        y += [z[i][0] - predicted[0], bearing]
    H = np.vstack(rows)
    noise = np.zeros((len(y), len(y)))
    for i, block in enumerate(R):
        noise[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = block
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + noise)
    step = K @ np.array(y)
    w = step[2]
    # The exponential: an arc instead of a straight line.
    a, b = (math.sin(w) / w, (1 - math.cos(w)) / w) if abs(w) > 1e-9 else (1.0, w / 2)
    moved = T_world_body @ matrix(a * step[0] - b * step[1], b * step[0] + a * step[1], w)
    return moved, landmarks + step[3:].reshape(-1, 2), (np.eye(size) - K @ H) @ P
