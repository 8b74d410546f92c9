"""A class with properties and operators instead of functions; the functions asked for hand over to it."""

import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Gaussian:
    mean: tuple
    P: tuple

    @classmethod
    def of(cls, mean, P):
        return cls(tuple(map(float, mean)), tuple(tuple(map(float, row)) for row in P))

    @property
    def covariance(self):
        return np.array(self.P)

    def __matmul__(self, observed):
        y, H, R = observed
        P = self.covariance
        L = np.linalg.cholesky(H @ P @ H.T + R)
        half = np.linalg.solve(L, H @ P)
        return Gaussian.of(np.array(self.mean) + half.T @ np.linalg.solve(L, y), P - half.T @ half)


def measurement(state, landmark):
    x, y = (float(a) - float(b) for a, b in zip(landmark, state))
    bearing = math.atan2(y, x) - float(state[2])
    return [math.sqrt(x**2 + y**2), math.atan2(math.sin(bearing), math.cos(bearing))]


def update(mean, covariance, y, H, noise):
    after = Gaussian.of(mean, covariance) @ (np.asarray(y), np.asarray(H), np.asarray(noise))
    return after.mean, [list(row) for row in after.P]
