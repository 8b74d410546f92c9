"""Two poses stay in the system between frames: the past one is marginalised when the next frame comes."""

import numpy as np

from slamcmp.types import Estimate, Landmarks


class WindowOne(WindowOne):
    def __init__(self, problem):
        super().__init__(problem)
        self.whole, self.poses = self.Lam, 1

    def update(self, frame):
        if self.poses == 2:
            self.Lam = self._current()
        new = self.T @ frame.T_prev_body
        poses = np.stack([self.T, new]) if frame.k > 0 else new[None]
        self._join(frame, new)
        self.whole, eta = self._cost(frame, poses)
        poses, self.positions = gauss_newton_step(poses, self.positions, self.whole, eta)
        self.T, self.poses = poses[-1], len(poses)
        if self.poses == 1:
            self.Lam = self.whole

    def _current(self):
        if self.poses == 1:
            return self.whole
        keep = np.arange(3, len(self.whole))
        return marginalise(self.whole, np.zeros(len(self.whole)), keep)[0]

    def estimate(self):
        return Estimate(self.T, np.linalg.inv(self._current())[:3, :3])

    def landmarks(self):
        P = np.linalg.inv(self._current())
        return Landmarks(
            self.ids,
            self.positions,
            np.array([P[i : i + 2, i : i + 2] for i in range(3, len(P), 2)]).reshape(-1, 2, 2),
        )
