"""The same filter as a factor graph: one pose in the window, one Gauss-Newton step a frame.

Written for reading, apart from the package's own graph code: relative positions here are a factor in Python.
"""

from __future__ import annotations

from typing import Literal

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
    """Linearise, eliminate the previous pose, solve once, keep the rest as linear factors.

    ``axes``: in which axes the kept pose's error is additive. "body" is GTSAM's own way, T exp(xi) and linear
    factors kept as they are; "world" moves the position and the heading apart and reads the kept factors in
    the axes of the moved pose.
    """

    def __init__(self, problem: Problem, *, axes: Literal["world", "body"]) -> None:
        self.axes = axes
        self.sensor = problem.sensor
        self.values = gtsam.Values()
        self.values.insert(X(0), pose2(problem.T_world_body))
        prior = gtsam.PriorFactorPose2(
            X(0), pose2(problem.T_world_body), gtsam.noiseModel.Gaussian.Covariance(problem.P)
        )
        self.kept = gtsam.NonlinearFactorGraph()
        self.kept.add(prior)
        self.P = problem.P
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
        ordering = gtsam.Ordering()
        for key in (X(self.k), *(L(i) for i in self.ids)):
            ordering.push_back(key)
        information, _ = remaining.hessian(ordering)
        step = remaining.optimize()
        if self.axes == "body":
            self.values = values.retract(step)
            self.kept = gtsam.LinearContainerFactor.ConvertLinearGraph(remaining, values)
        else:
            information = self._move_in_world_axes(values, step, information)
            self._keep_about_the_mean(information)
        self.P = np.linalg.inv(information)

    def _move_in_world_axes(
        self, values: gtsam.Values, step: gtsam.VectorValues, information: np.ndarray
    ) -> np.ndarray:
        """Correct the mean; answers with the information on errors in the axes of the corrected pose."""
        old = values.atPose2(X(self.k))
        dx, dy, turn = step.at(X(self.k))
        position = old.transformFrom(np.array([dx, dy]))
        self.values = gtsam.Values()
        self.values.insert(X(self.k), gtsam.Pose2(position[0], position[1], old.theta() + turn))
        for landmark in self.ids:
            self.values.insert(L(landmark), values.atPoint2(L(landmark)) + step.at(L(landmark)))
        old_from_new = np.eye(len(information))
        old_from_new[:2, :2] = gtsam.Rot2(turn).matrix()
        return old_from_new.T @ information @ old_from_new

    def _keep_about_the_mean(self, information: np.ndarray) -> None:
        """A Gaussian on all kept variables as factors on pairs, the most that can be built from Python."""
        keys = [X(self.k), *(L(i) for i in self.ids)]
        ends = np.cumsum([3] + [2] * len(self.ids))
        states = [np.arange(end - (2 if i else 3), end) for i, end in enumerate(ends)]
        self.kept = gtsam.NonlinearFactorGraph()

        def keep(factor: gtsam.HessianFactor) -> None:
            self.kept.add(gtsam.LinearContainerFactor(factor, self.values))

        for i, own in enumerate(states):
            keep(gtsam.HessianFactor(keys[i], information[np.ix_(own, own)], np.zeros(own.size), 0.0))
            for j in range(i + 1, len(states)):
                other = states[j]
                none_i, none_j = np.zeros((own.size,) * 2), np.zeros((other.size,) * 2)
                G_ij = information[np.ix_(own, other)]
                keep(gtsam.HessianFactor(keys[i], keys[j], none_i, G_ij, none_i[0], none_j, none_j[0], 0.0))

    def pose(self) -> np.ndarray:
        return self.values.atPose2(X(self.k)).matrix()

    def positions(self) -> np.ndarray:
        """(L, 2) in the order of first sight."""
        return np.array([self.values.atPoint2(L(i)) for i in self.ids]).reshape(-1, 2)

    def joint_covariance(self) -> np.ndarray:
        """(3 + 2 L, 3 + 2 L), pose first, landmarks in the order of first sight."""
        return self.P
