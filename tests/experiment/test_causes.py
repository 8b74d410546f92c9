"""`slamcmp check` names what is wrong with a covariance, or says that it does not know."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from slamcmp.experiment.conformance.bench import COMMON, WORLDS, Bench, make_world, run
from slamcmp.experiment.conformance.causes import AGREES, _claims, _difference, _Mistakes, cause, errorless
from slamcmp.geometry import se2
from slamcmp.registry import Plugin, back_ends
from slamcmp.types import Estimate, FloatArray, Frame, Landmarks, Problem


class WorldAxes:
    """An EKF-SLAM with its error in world axes (x, y, heading, landmarks), one observation at a time.

    It shares no line with the textbook's filter that the faults are put into, nor its chart.
    """

    def __init__(self, problem: Problem, **faults: Any) -> None:
        self.fault: Callable[[str, Any], Any] = faults.get
        self.sensor = problem.sensor
        T = problem.T_world_body
        self.x = np.array([T[0, 2], T[1, 2], np.arctan2(T[1, 0], T[0, 0])])
        D = self.turn()
        self.P: FloatArray = D @ problem.P @ D.T
        self.at: dict[int, int] = {}

    def turn(self) -> FloatArray:
        return np.asarray(se2(0.0, 0.0, self.x[2]))

    def pose(self) -> FloatArray:
        return np.asarray(se2(*self.x[:3]))

    def noise(self, R: FloatArray, new: bool) -> FloatArray:
        power = self.fault("power", 1)
        scaled: FloatArray = np.diag(np.diag(R) ** power) * self.fault("R", 1.0)
        return scaled * (self.fault("R_new", 1.0) if new else self.fault("R_known", 1.0))

    def update(self, frame: Frame) -> None:
        before = self.turn()
        T = self.pose() @ frame.T_prev_body
        step = T[:2, 2] - self.x[:2]
        F = np.eye(len(self.x))
        F[0, 2], F[1, 2] = -step[1], step[0]
        self.x[:3] = T[0, 2], T[1, 2], np.arctan2(T[1, 0], T[0, 0])
        D = before if self.fault("Q_axes", False) else self.turn()
        if self.fault("moves_cross", True):
            self.P = F @ self.P @ F.T
        else:
            self.P[:3, :3] = F[:3, :3] @ self.P[:3, :3] @ F[:3, :3].T
        self.P[:3, :3] += self.fault("Q", 1.0) * D @ frame.Q @ D.T
        for name, z, R in zip(frame.ids.tolist(), frame.z, frame.R, strict=True):
            for _ in range(self.fault("times", 1)):
                self.known(name, z, R) if name in self.at else self.new(name, z, R)

    def derivatives(self, at: FloatArray) -> tuple[FloatArray, FloatArray]:
        H_pose, H_land = self.sensor.jacobians(self.pose(), at)
        return H_pose @ self.turn().T, H_land

    def new(self, name: int, z: FloatArray, R: FloatArray) -> None:
        at = self.sensor.invert(self.pose(), z)
        H_pose, H_land = self.derivatives(at)
        B = np.linalg.inv(H_land)
        G, R = -B @ H_pose, self.noise(R, new=True)
        cross = G @ self.P[:3] if self.fault("cross", True) else np.zeros((2, len(self.P)))
        own = R if self.fault("metres", False) else B @ R @ B.T
        if self.fault("of_pose", True):
            own = own + G @ self.P[:3, :3] @ G.T
        self.at[name] = len(self.x)
        self.x, self.P = np.append(self.x, at), np.block([[self.P, cross.T], [cross, own]])

    def known(self, name: int, z: FloatArray, R: FloatArray) -> None:
        i = self.at[name]
        H = np.zeros((2, len(self.x)))
        H[:, :3], H_land = self.derivatives(self.x[i : i + 2])
        if self.fault("map", True):
            H[:, i : i + 2] = H_land
        S = H @ self.P @ H.T + self.noise(R, new=False)
        K = self.P @ H.T @ np.linalg.inv(S)
        y = self.sensor.residual(z, self.sensor.predict(self.pose(), self.x[i : i + 2]))
        self.x = self.x + self.fault("gain", 1.0) * K @ y
        self.P = self.P - K @ S @ K.T
        self.P = 0.5 * (self.P + self.P.T)

    def estimate(self) -> Estimate:
        D = self.turn()
        return Estimate(self.pose(), D.T @ self.P[:3, :3] @ D)


def bench_of(make: Any, kind: int = 0) -> Bench:
    name, settings = WORLDS[kind]
    merged = {**COMMON, **settings}
    stream, truth = make_world(merged, seed=0)
    return Bench(lambda problem, truth: make(problem), name, merged, stream, truth, True)


NAMED: dict[str, tuple[dict[str, Any], str]] = {
    "no correlation": ({"cross": False, "of_pose": False}, "without their correlation to the pose ("),
    "no correlation, marginal kept": ({"cross": False}, "to the pose, though with its uncertainty"),
    "R in metres": ({"metres": True}, "as if they were metres"),
    "twice": ({"times": 2}, "taken in twice"),
    "known ones with half of R": ({"R_known": 0.5}, "of a known landmark is taken in twice"),
    "R squared": ({"power": 2}, "R is taken for standard deviations and squared"),
    "R as its root": ({"power": 0.5}, "the root of R"),
    "new ones without R": ({"R_new": 0.0}, "a new landmark's covariance lacks R"),
    "no Q": ({"Q": 0.0}, "Q is left out"),
    "Q twice": ({"Q": 2.0}, "Q is added twice"),
    "Q too small": ({"Q": 0.3}, "Q is 0.3 times"),
    "R too small": ({"R": 0.1}, "R is 0.1 times"),
    "three times": ({"times": 3}, "R is 0.333 times"),
    "R of new ones too large": ({"R_new": 4.0}, "R of new landmarks is 4 times"),
    "the map taken as known": ({"map": False}, "taken as known"),
}
HIDING = ("no Q", "the map taken as known", "new ones without R")


@pytest.mark.parametrize("fault", list(NAMED))
def test_each_fault_has_its_name(fault: str) -> None:
    faults, words = NAMED[fault]
    told = cause(bench_of(partial(WorldAxes, **faults)))
    assert told.startswith("cause: ")
    assert words in told, told
    # These alone make a pose's covariance blind to what else is wrong.
    assert ("may stand beside it" in told) == (fault in HIDING), told


@pytest.mark.parametrize(
    "faults", [{"cross": False, "Q": 1.7}, {"R_known": 0.3, "R_new": 5.0}, {"metres": True, "Q": 2.0}]
)
def test_two_faults_at_once_are_given_no_name(faults: dict[str, Any]) -> None:
    told = cause(bench_of(partial(WorldAxes, **faults)))
    assert told.startswith("cause not found: on a stream without errors its covariance first differs"), told


@pytest.mark.parametrize(("faults", "words"), [
    ({"Q": 0.0, "times": 2}, "cause: Q is left out"),
    ({"map": False, "R_new": 0.0}, "cause: landmarks are taken as known"),
])  # fmt: skip
def test_a_fault_that_hides_another_is_named_with_that_doubt(faults: dict[str, Any], words: str) -> None:
    """Without Q a pose is as well known as at the start, whatever is made of observations."""
    told = cause(bench_of(partial(WorldAxes, **faults)))
    assert told.startswith(words), told
    assert "; another fault may stand beside it and would not show in them, such as: " in told


class TurnedMap(WorldAxes):
    """Right, but for the axes in which it reports its landmarks' covariances."""

    def landmarks(self) -> Landmarks:
        starts = list(self.at.values())
        D = self.turn()[:2, :2]
        turned = self.fault("turned", True)
        blocks = [self.P[i : i + 2, i : i + 2] for i in starts]
        covariances = np.array([D.T @ each @ D if turned else each for each in blocks])
        return Landmarks(np.array(list(self.at)), np.array([self.x[i : i + 2] for i in starts]), covariances)


def test_map_that_is_reported_wrong_is_no_fault_of_the_filter() -> None:
    assert "landmarks() and joint_covariance() report in world axes" in cause(bench_of(TurnedMap))
    right = cause(bench_of(partial(TurnedMap, turned=False)))
    assert right.startswith("its covariance is right where measurements have no errors")


def test_fault_of_the_mean_is_not_sought_in_the_covariance() -> None:
    told = cause(bench_of(partial(WorldAxes, gain=0.5)))
    assert told.startswith("its covariance is right where measurements have no errors")
    assert "cause:" not in told


@pytest.mark.parametrize("name", ["ekf_slam", "ekf_right_invariant", "ekf_fej", "iterated_ekf", "isam2"])
def test_right_estimators_of_all_charts_claim_what_the_textbook_s_does(name: str) -> None:
    """Without errors they are one: else no comparison would tell a fault."""
    plugin: Plugin = back_ends.get(name)
    bench = bench_of(plugin.target)
    stream, truth = errorless(bench)
    _, claimed = run(bench, stream, truth)
    assert _difference(claimed, _claims(stream, truth, _Mistakes())).max() < AGREES
