"""Plug-ins as a user writes them: in a file of their own. Most of them misbehave on purpose."""

import ctypes
import os
import resource
import signal
import time
from typing import Any

import numpy as np

from slamcmp.errors import DivergedError, MissingDataError, UsageError
from slamcmp.geometry import adjoint_of_inverse, se2
from slamcmp.models.sensors import make_sensor
from slamcmp.types import Detections, Estimate, GroundTruth, Landmarks, Log, Problem, Trajectory


def straight(seed: int, *, steps: int = 40, sigma_m: float = 0.01, truth: bool = True) -> Log:
    """A robot that drives along x by noisy steps of a metre and sees nothing."""
    rng = np.random.default_rng(seed)
    Q = np.diag([sigma_m**2, sigma_m**2, 1e-6])
    increments = np.stack([np.eye(3)] + [se2(1 + sigma_m * rng.normal(), 0.0, 0.0) for _ in range(steps - 1)])
    poses = np.stack([se2(float(k), 0.0, 0.0) for k in range(steps)])
    t = np.arange(steps, dtype=float)
    nothing = Detections(np.empty((0, 2)), np.empty((0, 2, 2)), np.empty(0, dtype=int))
    return Log(
        "straight",
        Problem(np.eye(3), np.zeros((3, 3)), make_sensor("relative_position", {"space_dim": 2})),
        t,
        increments,
        np.concatenate([np.zeros((1, 3, 3)), np.broadcast_to(Q, (steps - 1, 3, 3))]),
        (nothing,) * steps,
        GroundTruth(t, poses, np.empty(0, dtype=int), np.empty((0, 2))) if truth else None,
    )


def broken_source(seed: int) -> Log:
    """A source with a mistake in it."""
    raise ZeroDivisionError(f"seed {seed}")


def only_even(seed: int, *, steps: int = 4) -> Log:
    """A source that some settings are impossible for."""
    if steps % 2:
        raise UsageError(f"steps is {steps}: an even number is needed")
    return straight(seed, steps=steps)


def endless_source(seed: int) -> Log:
    """A source that never comes to an end."""
    while True:
        pass


def sourceless(seed: int) -> Log:
    """A source whose file is not there."""
    raise MissingDataError("park.txt: there is no such file")


class DeadReckoning:
    """Odometry only."""

    def __init__(self, problem: Problem, *, at: int = 20, pause_s: float = 0.0) -> None:
        self.T, self.P, self.at, self.pause_s = problem.T_world_body, problem.P, at, pause_s
        self.poses = []

    def update(self, frame) -> None:
        if self.pause_s:
            time.sleep(self.pause_s)
        if frame.k == self.at:
            self.misbehave()
        A = adjoint_of_inverse(frame.T_prev_body)
        self.T, self.P = self.T @ frame.T_prev_body, A @ self.P @ A.T + frame.Q
        self.poses.append(self.T)

    def misbehave(self) -> None:
        pass

    def estimate(self) -> Estimate:
        return Estimate(self.T, self.P)


class Anything(DeadReckoning):
    """Takes a value of any kind."""

    def __init__(self, problem: Problem, *, value: Any = None) -> None:
        super().__init__(problem)


class TellsItsSeed(DeadReckoning):
    def diagnostics(self) -> dict[str, float]:
        return dict.fromkeys(("seed", "trial", "label", "digest", "back_end", "source.steps"), -1.0)


class Hindsight(DeadReckoning):
    """The same with a trajectory in the end."""

    def trajectory(self) -> Trajectory:
        poses = np.stack(self.poses)
        return Trajectory(np.arange(len(poses), dtype=float), poses)


class OtherStamps(Hindsight):
    def trajectory(self) -> Trajectory:
        return Trajectory(0.1 * np.arange(len(self.poses)), np.stack(self.poses))


class SpatialPoses(Hindsight):
    def trajectory(self) -> Trajectory:
        return Trajectory(np.arange(40.0), np.stack([np.eye(4)] * 40))


class SpatialMap(Hindsight):
    def landmarks(self) -> Landmarks:
        return Landmarks([1], [[1.0, 2.0, 3.0]], [np.eye(3)])


class NoMap(Hindsight):
    def landmarks(self) -> dict:
        return {}


class SlowFramesAndMap(DeadReckoning):
    """Frames and map each stay below the hard limit, both together do not."""

    def misbehave(self) -> None:
        time.sleep(1.4)

    def landmarks(self) -> Landmarks:
        time.sleep(2.5)
        return Landmarks(np.empty(0, dtype=int), np.empty((0, 2)), np.empty((0, 2, 2)))


class EndlessMap(DeadReckoning):
    def landmarks(self) -> Landmarks:
        while True:
            pass


def hang_as_a_library() -> None:
    """Inside C with the interpreter's lock held, as GTSAM computes marginals: no signal handler runs."""
    ctypes.PyDLL(None).sleep(600)


class FinalCovariancesHang(Hindsight):
    def trajectory(self) -> Trajectory:
        hang_as_a_library()
        return super().trajectory()


class JointCovarianceHangs(Hindsight):
    def landmarks(self) -> Landmarks:
        return Landmarks(np.empty(0, dtype=int), np.empty((0, 2)), np.empty((0, 2, 2)))

    def joint_covariance(self) -> np.ndarray:
        hang_as_a_library()
        return self.P


class CovarianceHangsAt(DeadReckoning):
    """The pose's own, asked for after every frame."""

    def __init__(self, problem: Problem, *, frame: int = 30) -> None:
        super().__init__(problem)
        self.frame = frame

    def estimate(self) -> Estimate:
        if len(self.poses) == self.frame + 1:
            hang_as_a_library()
        return super().estimate()


class MapSegfaults(DeadReckoning):
    def landmarks(self) -> Landmarks:
        os.kill(os.getpid(), signal.SIGSEGV)


class DiesInTheEnd(DeadReckoning):
    """Its process ends by a signal when the interpreter is torn down, with everything written."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem)
        import multiprocessing.util

        multiprocessing.util.Finalize(None, os.kill, (os.getpid(), signal.SIGSEGV), exitpriority=0)


class Raises(DeadReckoning):
    def misbehave(self) -> None:
        raise ValueError("no such landmark")


class Diverges(DeadReckoning):
    def misbehave(self) -> None:
        raise DivergedError("wrong basin")


class DivergesAndSaysWhere(DeadReckoning):
    def misbehave(self) -> None:
        raise DivergedError("frame 200: wrong basin")


class TurnsNan(DeadReckoning):
    def misbehave(self) -> None:
        self.T = self.T * np.nan


class TurnsIndefinite(DeadReckoning):
    def misbehave(self) -> None:
        self.P = self.P - 1.0 * np.eye(3)


class IsKilled(DeadReckoning):
    def misbehave(self) -> None:
        os.kill(os.getpid(), signal.SIGKILL)


class Segfaults(DeadReckoning):
    def misbehave(self) -> None:
        os.kill(os.getpid(), signal.SIGSEGV)


class Exits(DeadReckoning):
    def misbehave(self) -> None:
        os._exit(0)


class Loops(DeadReckoning):
    def misbehave(self) -> None:
        while True:
            pass


class Hog(DeadReckoning):
    def misbehave(self) -> None:
        self.hoard = [np.ones(1_000_000) for _ in range(10_000)]


class MeetsAFullDisk(DeadReckoning):
    """From then on no file of its process can grow beyond 1000 bytes."""

    def misbehave(self) -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))


class LooksForTruth(DeadReckoning):
    """Raises where any object of its process is a ground truth."""

    def misbehave(self) -> None:
        import gc

        found = [each for each in gc.get_objects() if type(each).__name__ == "GroundTruth"]
        if found:
            raise ValueError("found the truth")
