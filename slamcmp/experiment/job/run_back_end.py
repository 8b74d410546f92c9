"""One back end over one stream, frame by frame, timed and watched."""

from __future__ import annotations

import contextlib
import time
import traceback
from collections.abc import Callable, Mapping, MutableSequence
from typing import Any

import numpy as np

from slamcmp.errors import DivergedError, SlamcmpError
from slamcmp.experiment.job.collected import Collected, first_fault
from slamcmp.experiment.job.task import BEATS
from slamcmp.protocols import BackEnd, Diagnosed, JointEstimator, Mapper, Selective, Smoother
from slamcmp.support.memory import PeakMemory
from slamcmp.support.messages import describe, told
from slamcmp.support.provenance.unseen_reads import paused
from slamcmp.support.shared_arrays import SharedArrays
from slamcmp.types import (
    TANGENT_DIM,
    Estimate,
    Landmarks,
    MeasurementStream,
    Problem,
    Run,
    Status,
    Trajectory,
)

AfterFrame = Callable[[int, BackEnd, Estimate], Mapping[str, float]]

CHECK_EVERY = 128
"""Frames between two looks at what was collected: a run that diverged stops at most this much later."""
JOINT_DIM_MAX = 1500
"""Above it the joint covariance (18 MB here) is not asked for."""


def run_back_end(
    make: Callable[[Problem], BackEnd],
    stream: MeasurementStream,
    *,
    label: str,
    parameters: Mapping[str, Any],
    seed: int | None = None,
    time_limit_s: float = float("inf"),
    heartbeat: MutableSequence[float] | None = None,
    shared: SharedArrays | None = None,
    after_frame: AfterFrame | None = None,
) -> Run:
    """Feed every frame to a new back end and keep all it says.

    Never raises for what the back end does: a failure is the run's status and message, and the frames
    before it are kept. ``make`` gets the problem and nothing else; the back end never sees truth.
    ``heartbeat[0]`` is set to the monotonic time [s] of the start, ``heartbeat[1]`` to the frames done,
    ``heartbeat[2]`` to the time when all of them were, ``heartbeat[3]`` to the time when all was answered.
    What is said goes into ``shared`` arrays frame by frame, where :func:`recovered` finds it if this process
    is ended. ``after_frame`` is called between frames, and what it answers becomes series of the run; such a
    run tells neither times nor memory, for both are disturbed.
    """
    collected = Collected(stream, shared)
    beat = [0.0] * BEATS if heartbeat is None else heartbeat
    memory = PeakMemory()
    beat[0] = time.monotonic()
    began = time.perf_counter(), time.process_time()
    took = [float("nan")] * 2
    back_end: BackEnd | None = None

    def feed() -> str:
        nonlocal back_end
        back_end = make(stream.problem)
        return _feed(back_end, stream, collected, time.perf_counter() + time_limit_s, beat, after_frame)

    def run(hindsight: Mapping[str, Any]) -> Run:
        return Run(
            back_end=label,
            parameters=parameters,
            digest=stream.digest,
            seed=seed,
            frames=len(stream.frames),
            status=status,
            message=message,
            **collected.fields(),
            **hindsight,
            peak_memory_mb=memory.growth_mb() if after_frame is None else float("nan"),
            wall_s=took[0],
            processor_s=took[1],
        )

    hindsight: dict[str, Any] = {}
    status, message = _guarded(feed, collected)
    if status == "ok" and message:
        status = "timed_out"
    # The root of a late exception is often an earlier result that was not a number.
    bad = collected.first_bad()
    if bad is not None:
        status, message = "diverged", bad
    if status == "ok" and back_end is not None:
        beat[2] = time.monotonic()
        finished = back_end
        status, message = _guarded(lambda: _ask_at_end(finished, stream, hindsight), collected)
        fault = _final_fault(hindsight) if status == "ok" else ""
        if fault:
            status, message = "diverged", fault
            hindsight = {"final_s": hindsight.get("final_s", 0.0)}
        if after_frame is not None and "final_s" in hindsight:
            hindsight["final_s"] = float("nan")
    beat[3] = time.monotonic()
    if after_frame is None:
        took[:] = time.perf_counter() - began[0], time.process_time() - began[1]
    return run(hindsight)


def _guarded(action: Callable[[], str | None], collected: Collected) -> tuple[Status, str]:
    """``ok`` with what the action says, or the status and message of what it raised."""
    try:
        return "ok", action() or ""
    except DivergedError as error:
        # Some say themselves at which frame.
        text, where = str(error), f"{collected.where()}: "
        return "diverged", told(text if text.startswith(where) else f"{where}{text}")
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        # The lines of a traceback are read from the files.
        with paused():
            message = told(f"{collected.where()}: {describe(error)}")
            # Where output goes to a log, its reader finds the way to the fault there; at the limit of memory
            # or on a full disk there may be no log to write.
            # What is expected, such as a closure that a filter refuses, says all in its line.
            if not isinstance(error, SlamcmpError):
                with contextlib.suppress(Exception):
                    traceback.print_exc()
        return "crashed", message


def _feed(
    back_end: BackEnd,
    stream: MeasurementStream,
    collected: Collected,
    deadline: float,
    beat: MutableSequence[float],
    after_frame: AfterFrame | None,
) -> str:
    """The loop. Answers with the message of a time-out, or with nothing."""
    clock = time.perf_counter
    update, estimate = back_end.update, back_end.estimate
    diagnostics = back_end.diagnostics if isinstance(back_end, Diagnosed) else None
    if isinstance(back_end, Selective):
        collected.keep_masks(stream)
    poses, covariances = collected.poses, collected.covariances
    update_s, estimate_s = collected.update_s, collected.estimate_s
    last = len(stream.frames) - 1
    for k, frame in enumerate(stream.frames):
        before = clock()
        update(frame)
        between = clock()
        answer = estimate()
        after = clock()
        poses[k] = answer.T_world_body
        covariances[k] = answer.P
        if after_frame is None:
            update_s[k] = between - before
            estimate_s[k] = after - between
        else:
            update_s[k] = estimate_s[k] = np.nan
            collected.note(k, after_frame(k, back_end, answer))
        if diagnostics is not None:
            collected.note(k, diagnostics())
        if collected.kept is not None:
            collected.keep(k, frame, back_end)
        collected.done = k + 1
        beat[1] = k + 1
        if k % CHECK_EVERY == CHECK_EVERY - 1 and collected.first_bad() is not None:
            break
        if after > deadline and k < last:
            return f"the time limit passed after frame {k} of {last}"
    return ""


def _ask_at_end(back_end: BackEnd, stream: MeasurementStream, hindsight: dict[str, Any]) -> None:
    """Fill in what the back end can tell after the last frame."""
    p = TANGENT_DIM[stream.problem.sensor.space_dim]
    if isinstance(back_end, Smoother):
        before = time.perf_counter()
        final = back_end.trajectory()
        hindsight["final_s"] = time.perf_counter() - before
        _require_trajectory(final, stream)
        hindsight["final"] = final
    if isinstance(back_end, Mapper):
        landmarks = back_end.landmarks()
        _require_map(landmarks, stream)
        hindsight["landmarks"] = landmarks
        if isinstance(back_end, JointEstimator) and p + landmarks.positions.size <= JOINT_DIM_MAX:
            joint = np.asarray(back_end.joint_covariance())
            size = p + landmarks.positions.size
            if joint.shape != (size, size):
                raise ValueError(f"joint_covariance() has shape {joint.shape}; ({size}, {size}) is needed")
            hindsight["joint_covariance"] = joint
    if isinstance(back_end, Diagnosed):
        hindsight["final_diagnostics"] = {name: float(v) for name, v in back_end.diagnostics().items()}


def _require_trajectory(final: object, stream: MeasurementStream) -> None:
    """Check what metrics and tables take for granted."""
    if not isinstance(final, Trajectory):
        raise TypeError(f"trajectory() gave {type(final).__name__} where a Trajectory is needed")
    if final.t.size != len(stream.frames):
        raise ValueError(f"trajectory() has {final.t.size} poses for {len(stream.frames)} frames")
    size = stream.problem.sensor.space_dim + 1
    if final.T_world_body.shape[1:] != (size, size):
        have = final.T_world_body.shape[1:]
        raise ValueError(f"trajectory() has poses of shape {have} where ({size}, {size}) is needed")
    stamps = np.array([frame.t for frame in stream.frames])
    wrong = np.flatnonzero(~(np.abs(final.t - stamps) <= 1e-9))
    if wrong.size:
        k = wrong[0]
        raise ValueError(f"trajectory() has t[{k}] = {final.t[k]} s where frame {k} is at {stamps[k]} s")


def _require_map(landmarks: object, stream: MeasurementStream) -> None:
    if not isinstance(landmarks, Landmarks):
        raise TypeError(f"landmarks() gave {type(landmarks).__name__} where Landmarks are needed")
    n = stream.problem.sensor.space_dim
    if landmarks.positions.shape[1] != n:
        raise ValueError(
            f"landmarks() has positions of shape {landmarks.positions.shape} where (any, {n}) is needed"
        )


def _final_fault(hindsight: Mapping[str, Any]) -> str:
    """What is not usable in the answers after the last frame, or nothing."""
    final: Trajectory | None = hindsight.get("final")
    if final is not None:
        blank = np.zeros((final.t.size, 1, 1))
        fault = first_fault(final.T_world_body, blank if final.P is None else final.P)
        if fault is not None:
            return f"final trajectory, frame {fault[0]}: {fault[1]}"
    landmarks: Landmarks | None = hindsight.get("landmarks")
    if landmarks is not None and landmarks.ids.size:
        fault = first_fault(landmarks.positions[:, :, None], landmarks.covariances)
        if fault is not None:
            what = fault[1].replace("pose", "position")
            return f"map, landmark {landmarks.ids[fault[0]]}: {what}"
    joint = hindsight.get("joint_covariance")
    if joint is not None and not np.isfinite(joint).all():
        return "the joint covariance is not finite"
    return ""
