"""The same filter as a factor graph: one pose in the window, one Gauss-Newton step a frame.

Written for reading, apart from the package's own graph code: relative positions here are a factor in Python.
"""

from __future__ import annotations

import gtsam
import numpy as np

from slamcmp.types import Frame, Problem

X, L = gtsam.symbol_shorthand.X, gtsam.symbol_shorthand.L


def pose2(T: np.ndarray) -> gtsam.Pose2:
    return gtsam.Pose2(T[0, 2], T[1, 2], np.arctan2(T[1, 0], T[0, 0]))


def relative_position_factor(
    pose_key: int, point_key: int, z: np.ndarray, R: np.ndarray
) -> gtsam.CustomFactor:
    def error(_: gtsam.CustomFactor, values: gtsam.Values, H: list[np.ndarray] | None) -> np.ndarray:
        H_pose, H_point = np.zeros((2, 3), order="F"), np.zeros((2, 2), order="F")
        q = values.atPose2(pose_key).transformTo(values.atPoint2(point_key), H_pose, H_point)
        if H is not None:
            H[0], H[1] = H_pose, H_point
        return q - z

    return gtsam.CustomFactor(gtsam.noiseModel.Gaussian.Covariance(R), [pose_key, point_key], error)


def range_bearing_factor(
    pose_key: int, point_key: int, z: np.ndarray, R: np.ndarray
) -> gtsam.BearingRangeFactor2D:
    model = gtsam.noiseModel.Gaussian.Covariance(R[::-1, ::-1])
    return gtsam.BearingRangeFactor2D(pose_key, point_key, gtsam.Rot2(z[1]), z[0], model)


def observation_factor(
    sensor_name: str, pose_key: int, point_key: int, z: np.ndarray, R: np.ndarray
) -> object:
    make = range_bearing_factor if sensor_name == "range_bearing" else relative_position_factor
    return make(pose_key, point_key, z, R)


class WindowOneGraph:
    """Linearise, eliminate the previous pose, solve once, keep the rest as linear factors."""

    def __init__(self, problem: Problem) -> None:
        self.sensor = problem.sensor
        self.values = gtsam.Values()
        self.values.insert(X(0), pose2(problem.T_world_body))
        prior = gtsam.PriorFactorPose2(
            X(0), pose2(problem.T_world_body), gtsam.noiseModel.Gaussian.Covariance(problem.P)
        )
        self.kept = gtsam.NonlinearFactorGraph()
        self.kept.add(prior)
        self.remaining: gtsam.GaussianFactorGraph | None = None
        self.ids: list[int] = []
        self.k = 0

    def update(self, frame: Frame) -> None:
        self.k = frame.k
        graph, values = gtsam.NonlinearFactorGraph(self.kept), gtsam.Values(self.values)
        if frame.k:
            increment = pose2(frame.T_prev_body)
            values.insert(X(frame.k), values.atPose2(X(frame.k - 1)).compose(increment))
            model = gtsam.noiseModel.Gaussian.Covariance(frame.Q)
            graph.add(gtsam.BetweenFactorPose2(X(frame.k - 1), X(frame.k), increment, model))
        T = values.atPose2(X(frame.k)).matrix()
        for landmark, z, R in zip(frame.ids.tolist(), frame.z, frame.R, strict=True):
            if landmark not in self.ids:
                self.ids.append(landmark)
                values.insert(L(landmark), self.sensor.invert(T, z))
            graph.add(observation_factor(self.sensor.name, X(frame.k), L(landmark), z, R))
        remaining = graph.linearize(values)
        if frame.k:
            ordering = gtsam.Ordering()
            ordering.push_back(X(frame.k - 1))
            _, remaining = remaining.eliminatePartialSequential(ordering)
            values.erase(X(frame.k - 1))
        self.values = values.retract(remaining.optimize())
        self.kept = gtsam.LinearContainerFactor.ConvertLinearGraph(remaining, values)
        self.remaining = remaining

    def pose(self) -> np.ndarray:
        return self.values.atPose2(X(self.k)).matrix()

    def positions(self) -> np.ndarray:
        """(L, 2) in the order of first sight."""
        return np.array([self.values.atPoint2(L(i)) for i in self.ids]).reshape(-1, 2)

    def joint_covariance(self) -> np.ndarray:
        """(3 + 2 L, 3 + 2 L), pose first, landmarks in the order of first sight."""
        ordering = gtsam.Ordering()
        for key in (X(self.k), *(L(i) for i in self.ids)):
            ordering.push_back(key)
        information, _ = self.remaining.hessian(ordering)
        return np.linalg.inv(information)
