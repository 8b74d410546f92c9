"""A drive in plain files, and the same with something wrong."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slamcmp import geometry as g

FloatArray = np.ndarray


@dataclass
class Drive:
    """Odometry at 10 Hz, detections at 2.5 Hz off its beat, truth at 20 Hz; a path of changing curvature."""

    seed: int = 0
    seconds: float = 60.0
    odometry_late_s: float = 0.0
    """How much later than the motion its stamps are."""
    distance_scale: float = 1.0
    turn_scale: float = 1.0
    bearing_bias: float = 0.0
    outliers: int = 0

    def __post_init__(self) -> None:
        fine = np.arange(0, self.seconds + 3, 0.01)
        self.fine = fine
        self.v = 0.5 + 0.2 * np.sin(0.7 * fine)
        self.omega = 0.3 * np.sin(0.4 * fine) + 0.2 * np.sin(1.3 * fine)
        steps = g.exp(np.stack([self.v, 0 * self.v, self.omega], axis=1)[:-1] * 0.01)
        poses = [np.eye(3)]
        for step in steps:
            poses.append(poses[-1] @ step)
        self.poses = np.array(poses)
        rng = np.random.default_rng(self.seed)
        self.rng = rng
        self.landmarks = {3 * k: rng.uniform(-8, 8, 2) for k in range(8)}

    def at(self, t: FloatArray) -> FloatArray:
        return self.poses[np.round(t / 0.01).astype(int)]

    def odometry(self) -> list[str]:
        t = np.arange(0, self.seconds + 0.05, 0.1)
        at = np.round(t / 0.01).astype(int)
        # Means over the time for which they hold.
        v, omega = (np.array([each[k : k + 10].mean() for k in at]) for each in (self.v, self.omega))
        v, omega = v / self.distance_scale, np.degrees(omega) / self.turn_scale
        stamps = t + self.odometry_late_s
        rows = [f"{a:.3f},{b:.9f},{c:.9f}" for a, b, c in zip(stamps, v, omega, strict=True)]
        return ["t_s,v_m_s,omega_deg_s", *rows]

    def detections(self) -> list[str]:
        rows = ["t_ms,id,range_m,bearing_rad"]
        wrong = 0
        for t in np.arange(0.42, self.seconds, 0.4):
            T = self.at(np.array([t]))[0]
            for name, place in self.landmarks.items():
                x, y = T[:2, :2].T @ (place - T[:2, 2])
                distance = np.hypot(x, y) + self.rng.normal(0, 0.05)
                if wrong < self.outliers:
                    distance, wrong = distance + 5, wrong + 1
                bearing = np.arctan2(y, x) + self.rng.normal(0, 0.01) + self.bearing_bias
                rows.append(f"{1000 * t:.1f},{name},{distance:.6f},{bearing:.6f}")
        return rows

    def truth(self) -> list[str]:
        t = np.arange(0, self.seconds + 2, 0.05)
        columns = (t, *g.se2_coordinates(self.at(t)).T)
        rows = [f"{a:.3f},{b:.9f},{c:.9f},{d:.9f}" for a, b, c, d in zip(*columns, strict=True)]
        return ["t_s,x_m,y_m,theta_rad", *rows]

    def sites(self) -> list[str]:
        return ["id,x_m,y_m", *(f"{name},{p[0]:.9f},{p[1]:.9f}" for name, p in self.landmarks.items())]

    def write(self, folder: Path) -> dict[str, Path]:
        files = {}
        contents = {
            "odometry": self.odometry(),
            "detections": self.detections(),
            "truth": self.truth(),
            "landmarks": self.sites(),
        }
        for name, rows in contents.items():
            files[name] = folder / f"{name}.csv"
            files[name].write_text("\n".join(rows) + "\n")
        return files
