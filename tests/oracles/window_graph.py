"""The same filter as a factor graph: one pose in the window, one Gauss-Newton step a frame.

Written for reading, apart from the package's own graph code: relative positions here are a factor in Python.
"""

from __future__ import annotations

from typing import Literal

import gtsam
import numpy as np

from slamcmp.backends.filters.ekf_slam import EkfSlam
from slamcmp.models.camera import Camera, MonoCamera
from slamcmp.models.sensors import entry_sensor
from slamcmp.types import Frame, MeasurementStream, Problem, SensorModel

X, L = gtsam.symbol_shorthand.X, gtsam.symbol_shorthand.L


def to_gtsam(T: np.ndarray) -> gtsam.Pose2 | gtsam.Pose3:
    return gtsam.Pose2(T[0, 2], T[1, 2], np.arctan2(T[1, 0], T[0, 0])) if len(T) == 3 else gtsam.Pose3(T)


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


def camera_factor(
    sensor: Camera, pose_key: int, point_key: int, z: np.ndarray, R: np.ndarray
) -> gtsam.GenericProjectionFactorCal3_S2 | gtsam.GenericStereoFactor3D:
    noise, mounting = gtsam.noiseModel.Gaussian.Covariance(R), gtsam.Pose3(sensor.T_body_camera)
    numbers = sensor.fx_px, sensor.fy_px, 0.0, sensor.cx_px, sensor.cy_px
    if isinstance(sensor, MonoCamera):
        K = gtsam.Cal3_S2(*numbers)
        return gtsam.GenericProjectionFactorCal3_S2(z, noise, pose_key, point_key, K, mounting)
    K = gtsam.Cal3_S2Stereo(*numbers, sensor.baseline_m)
    point = gtsam.StereoPoint2(z[0], z[1], z[2])
    return gtsam.GenericStereoFactor3D(point, noise, pose_key, point_key, K, mounting)


def observation_factor(
    sensor: SensorModel, pose_key: int, point_key: int, z: np.ndarray, R: np.ndarray
) -> object:
    if isinstance(sensor, Camera):
        return camera_factor(sensor, pose_key, point_key, z, R)
    make = range_bearing_factor if sensor.name == "range_bearing" else relative_position_factor
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
        self.p, self.n = len(problem.P), problem.sensor.space_dim
        planar = self.n == 2
        self.between = gtsam.BetweenFactorPose2 if planar else gtsam.BetweenFactorPose3
        make_prior = gtsam.PriorFactorPose2 if planar else gtsam.PriorFactorPose3
        start, noise = to_gtsam(problem.T_world_body), gtsam.noiseModel.Gaussian.Covariance(problem.P)
        self.values = gtsam.Values()
        self.values.insert(X(0), start)
        self.kept = gtsam.NonlinearFactorGraph()
        self.kept.add(make_prior(X(0), start, noise))
        self.P = problem.P
        self.ids: list[int] = []
        self.k = 0

    def pose_in(self, values: gtsam.Values, k: int) -> gtsam.Pose2 | gtsam.Pose3:
        return values.atPose2(X(k)) if self.n == 2 else values.atPose3(X(k))

    def point_in(self, values: gtsam.Values, landmark: int) -> np.ndarray:
        return values.atPoint2(L(landmark)) if self.n == 2 else values.atPoint3(L(landmark))

    def update(self, frame: Frame) -> None:
        self.k = frame.k
        graph, values = gtsam.NonlinearFactorGraph(self.kept), gtsam.Values(self.values)
        if frame.k:
            increment = to_gtsam(frame.T_prev_body)
            values.insert(X(frame.k), self.pose_in(values, frame.k - 1).compose(increment))
            model = gtsam.noiseModel.Gaussian.Covariance(frame.Q)
            graph.add(self.between(X(frame.k - 1), X(frame.k), increment, model))
        T = self.pose_in(values, frame.k).matrix()
        parts = [(self.sensor, frame)]
        if frame.entries is not None:
            parts = [(entry_sensor(self.sensor), frame.entries), *parts]
        for sensor, sights in parts:
            for landmark, z, R in zip(sights.ids.tolist(), sights.z, sights.R, strict=True):
                if landmark not in self.ids:
                    self.ids.append(landmark)
                    values.insert(L(landmark), sensor.invert(T, z))
                graph.add(observation_factor(sensor, X(frame.k), L(landmark), z, R))
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
        p, n = self.p, self.n
        old, delta = self.pose_in(values, self.k), step.at(X(self.k))
        shift, turn = (
            (delta[:2], gtsam.Rot2(delta[2])) if n == 2 else (delta[3:], gtsam.Rot3.Expmap(delta[:3]))
        )
        make = gtsam.Pose2 if n == 2 else gtsam.Pose3
        self.values = gtsam.Values()
        self.values.insert(X(self.k), make(old.rotation().compose(turn), old.transformFrom(shift)))
        for landmark in self.ids:
            self.values.insert(L(landmark), self.point_in(values, landmark) + step.at(L(landmark)))
        old_from_new = np.eye(len(information))
        for first in range(0, p - n + 1, n):
            old_from_new[first : first + n, first : first + n] = turn.matrix()
        return old_from_new.T @ information @ old_from_new

    def _keep_about_the_mean(self, information: np.ndarray) -> None:
        """A Gaussian on all kept variables as factors on pairs, the most that can be built from Python."""
        keys = [X(self.k), *(L(i) for i in self.ids)]
        ends = np.cumsum([self.p] + [self.n] * len(self.ids))
        states = [np.arange(end - (self.n if i else self.p), end) for i, end in enumerate(ends)]
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
        return self.pose_in(self.values, self.k).matrix()

    def positions(self) -> np.ndarray:
        """(L, n) in the order of first sight."""
        return np.array([self.point_in(self.values, i) for i in self.ids]).reshape(-1, self.n)

    def joint_covariance(self) -> np.ndarray:
        """(p + n L, p + n L), pose first, landmarks in the order of first sight."""
        return self.P


def assert_same_all_along(stream: MeasurementStream, ekf: EkfSlam, graph: WindowOneGraph) -> None:
    """Mean, map and joint covariance of both after every frame, to 1e-9."""
    for frame in stream.frames:
        ekf.update(frame)
        graph.update(frame)
        np.testing.assert_allclose(ekf.estimate().T_world_body, graph.pose(), rtol=0, atol=1e-9)
        np.testing.assert_allclose(ekf.landmarks().positions, graph.positions(), rtol=0, atol=1e-9)
        np.testing.assert_allclose(ekf.joint_covariance(), graph.joint_covariance(), rtol=0, atol=1e-9)
    assert ekf.landmarks().ids.tolist() == graph.ids
