"""One experiment with a submission: construct, feed frame by frame, call, and be sure of the walls.

with SandboxSession(submission, Policy()) as session:
    handle = session.construct("EkfSlam", problem, {"gate": 5.99})
    for frame in stream.frames:
        answer = session.step(handle, frame, landmarks=True)
"""

from __future__ import annotations

import functools
import os
import secrets
import signal
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict, replace
from types import TracebackType
from typing import Any, NewType, Self

from slamcmp.grading.hand_in.submission import Submission
from slamcmp.grading.sandbox.errors import (
    ProtocolViolation,
    SandboxError,
    SandboxUnavailable,
    StudentCrashed,
    StudentTimeout,
)
from slamcmp.grading.sandbox.pipes.answers import Answer, read_answer, student_error
from slamcmp.grading.sandbox.pipes.channel import Ended, Expired
from slamcmp.grading.sandbox.pipes.protocol import FrameError, decode, encode
from slamcmp.grading.sandbox.policy import Policy, Readable
from slamcmp.grading.sandbox.process import ROOT, Worker
from slamcmp.grading.sandbox.staging import Staging
from slamcmp.grading.sandbox.walls import identity
from slamcmp.grading.sandbox.walls.bubblewrap import bubblewrap_works
from slamcmp.grading.sandbox.walls.layers import ACTIVE, Surroundings
from slamcmp.grading.sandbox.walls.proofs import (
    IN_THE_GRADER,
    MEANING,
    Level,
    Outcome,
    attempt,
    judge,
    level_of,
)
from slamcmp.grading.sandbox.walls.readable import readable_for, world_reachable
from slamcmp.support.messages import printable
from slamcmp.types import Estimate, Frame, Landmarks, Problem, Trajectory

Handle = NewType("Handle", int)
"""An object that lives in the worker."""


class SandboxSession:
    """A worker process with one submission loaded.

    Every request raises one of :class:`StudentError` (the session lives on), :class:`StudentTimeout`,
    :class:`StudentCrashed` or :class:`ProtocolViolation` (the process is gone, and each later request raises
    the same again). A session belongs to the thread that made it.

    Raises:
        SandboxUnavailable: the machine cannot protect the grader's files and ``accept_weak`` is not given,
            or the worker does not start.
        StudentError, StudentTimeout, StudentCrashed, ProtocolViolation: importing the submission did.
    """

    layers: Mapping[str, str]
    """``active`` or the reason why not, by layer."""
    proofs: Mapping[str, Outcome]
    """The outcome of every attempt in ``proofs.MEANING``."""
    level: Level
    names: tuple[str, ...]
    """Functions and classes that the submission defines."""

    def __init__(
        self,
        submission: Submission,
        policy: Policy | None = None,
        *,
        accept_weak: bool = False,
        without: tuple[str, ...] = (),
    ) -> None:
        if not sys.platform.startswith("linux"):
            raise SandboxUnavailable(
                "the sandbox needs Linux; run the grader in a container or a virtual machine"
            )
        self.policy = policy or Policy()
        self._broken: SandboxError | None = None
        self._closed = False
        self.last_wall_s = float("nan")
        """Wall time of the last request as the grader saw it, the pipe included [s]."""
        readable = readable_for(self.policy.packages)
        uid = identity.unused_uid()
        self._staging = Staging(submission.files, uid)
        targets = self._staging.targets
        tried = set(_controls) == set(MEANING)
        if not _controls:
            _controls.update(attempt(targets, IN_THE_GRADER))
        identity.hold_undumpable()
        try:
            bubblewrap = uid is None and "bubblewrap" not in without and bubblewrap_works()
            if bubblewrap:
                submission_tree = str(self._staging.submission)
                readable = replace(readable, trees=(*readable.trees, submission_tree))
            self._worker = Worker(self.policy, readable, targets, bubblewrap=bubblewrap, tried=tried)
        except BaseException:
            self._release()
            raise
        try:
            self._start(readable, uid, bubblewrap, without)
            if self.level in ("reads unprotected", "weak") and not accept_weak:
                raise SandboxUnavailable(self._refusal())
            loaded = self._request(
                {
                    "op": "load",
                    "entry": submission.entry,
                    "definitions_only": submission.definitions_only,
                    "wanted": list(submission.wanted),
                },
                f"importing {submission.entry}",
                self.policy.load_s,
            )
            self.names = tuple(str(name) for name in loaded) if isinstance(loaded, list) else ()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Kill the worker and remove its files; what it printed stays readable."""
        if self._closed:
            return
        self._closed = True
        self._worker.kill()
        self._worker.channel.drain()
        self._worker.channel.close()
        self._release()

    def construct(
        self, name: str, problem: Problem | None = None, parameters: Mapping[str, Any] | None = None
    ) -> Handle:
        """``name(problem, **parameters)`` in the worker; without a problem ``name(**parameters)``."""
        told = None
        if problem is not None:
            told = {
                "T_world_body": problem.T_world_body,
                "P": problem.P,
                "sensor": problem.sensor.name,
                "parameters": dict(problem.sensor.parameters()),
            }
        message = {"op": "construct", "name": name, "problem": told, "parameters": dict(parameters or {})}
        handle = self._request(message, f"{name}(…)")
        if type(handle) is not int:
            raise self._violation("the answer is no handle")
        return Handle(handle)

    def step(
        self,
        handle: Handle,
        frame: Frame | None,
        *,
        estimate: bool = True,
        landmarks: bool = False,
        joint_covariance: bool = False,
        trajectory: bool = False,
        deadline_s: float | None = None,
    ) -> Answer:
        """``update(frame)``, if there is a frame, and what is asked for, in one round trip."""
        asked = {
            "estimate": estimate,
            "landmarks": landmarks,
            "joint_covariance": joint_covariance,
            "trajectory": trajectory,
        }
        want = [name for name, wanted in asked.items() if wanted]
        told, what = None, [f"{name}()" for name in want]
        if frame is not None:
            told = (frame.k, frame.t, frame.T_prev_body, frame.Q, frame.ids, frame.z, frame.R)
            what.insert(0, f"update(frame {frame.k})")
        message = {"op": "step", "handle": int(handle), "frame": told, "want": want}
        return read_answer(self._request(message, " and ".join(what), deadline_s), want)

    def update(self, handle: Handle, frame: Frame) -> None:
        """``update(frame)`` of the object."""
        self.step(handle, frame, estimate=False)

    def estimate(self, handle: Handle) -> Estimate:
        """``estimate()`` of the object."""
        answer = self.step(handle, None).estimate
        assert answer is not None
        return answer

    def landmarks(self, handle: Handle) -> Landmarks:
        """``landmarks()`` of the object."""
        answer = self.step(handle, None, estimate=False, landmarks=True).landmarks
        assert answer is not None
        return answer

    def trajectory(self, handle: Handle) -> Trajectory:
        """``trajectory()`` of the object."""
        answer = self.step(handle, None, estimate=False, trajectory=True).trajectory
        assert answer is not None
        return answer

    def call(self, name: str, *arguments: Any, deadline_s: float | None = None, **keywords: Any) -> Any:
        """A plain function of the submission.

        Arguments and answer are arrays (float, integer, bool), numbers, text, None, and lists, tuples and
        dictionaries of these.
        """
        message = {"op": "call", "name": name, "arguments": arguments, "keywords": keywords}
        return self._request(message, f"{name}(…)", deadline_s)

    @property
    def output(self) -> str:
        """What the submission printed up to now, standard output and error as they came, at most
        ``policy.output_bytes`` of it."""
        if not self._closed:
            self._worker.channel.drain()
        capture = self._worker.channel.capture
        text = printable(capture.kept.decode("utf-8", errors="replace"))
        return text + (f"\n[{capture.discarded} more bytes not kept]" if capture.discarded else "")

    def cpu_s(self) -> float:
        """Processor time that the process has used, from the kernel and so beyond its influence [s]."""
        return self._worker.cpu_s()

    def _start(
        self,
        readable: Readable,
        uid: int | None,
        bubblewrap: bool,
        without: tuple[str, ...],
    ) -> None:
        around = Surroundings(
            submission=str(self._staging.submission),
            mount_point=str(self._staging.mount_point),
            uid=uid,
            reachable=_interpreter_reachable() and world_reachable(self._staging.targets.public_file),
            switched_off=without,
        )
        message = {
            "op": "close",
            "policy": asdict(self.policy),
            "readable": asdict(readable),
            "around": asdict(around),
            "root": ROOT,
        }
        try:
            report = self._request(message, "starting", self.policy.start_s)
        except SandboxError as error:
            raise SandboxUnavailable(f"the sandbox did not start: {error}\n{self.output}".strip()) from error
        # In bubblewrap the process that was started is not the one that works.
        self._worker.pid = int(report["pid"])
        layers = dict(report["layers"])
        if uid is None:
            layers["bubblewrap"] = (
                ACTIVE if bubblewrap else "not active: not installed, or not allowed to work"
            )
        for name, succeeded in report["control"].items():
            _controls[name] = _controls.get(name, False) or succeeded
        self.proofs = judge(_controls, report["closed"])
        self.layers = layers
        self.level = level_of(self.proofs)

    def _refusal(self) -> str:
        reasons = [f"{name}: {state}" for name, state in self.layers.items() if state != ACTIVE]
        missing = [name for name, outcome in self.proofs.items() if outcome != "proved"]
        return (
            f"this machine cannot keep hidden tests from a submission (level {self.level!r}; "
            f"not proved: {', '.join(missing)}; {'; '.join(reasons)}). Run as root on Linux 5.13 or later "
            "with Landlock, install bubblewrap, or accept the risk explicitly"
        )

    def _request(self, message: dict[str, Any], what: str, deadline_s: float | None = None) -> Any:
        if self._broken is not None:
            raise self._broken
        if self._closed:
            raise SandboxError("the session is closed")
        nonce = secrets.token_hex(16)
        channel = self._worker.channel
        limit = self.policy.request_s if deadline_s is None else deadline_s
        buffers = encode({"nonce": nonce, **message})
        started = time.monotonic()
        try:
            if channel.pending():
                raise FrameError("speaks without being asked")
            channel.send(buffers, started + limit)
            header, body = channel.receive(started + limit)
            answer = decode(header, body)
            if answer.pop("nonce", None) != nonce or len(answer) != 1:
                raise FrameError("does not answer this request")
        except Expired:
            raise self._break(StudentTimeout(f"{what}: no answer within {limit:g} s")) from None
        except Ended:
            raise self._break(self._crash(what)) from None
        except FrameError as error:
            raise self._violation(str(error)) from error
        self.last_wall_s = time.monotonic() - started
        if "ok" in answer:
            return answer["ok"]
        raise student_error(answer.get("error"))

    def _crash(self, what: str) -> StudentCrashed:
        code = self._worker.ending(1.0)
        if code is None:
            return StudentCrashed(f"{what}: closed its pipes", signal_name=None, status=None)
        if code < 0:
            try:
                name = signal.Signals(-code).name
            except ValueError:
                name = f"signal {-code}"
            reason = {
                "SIGXCPU": "used up its processor time",
                "SIGKILL": "was killed (memory or processor time)",
            }
            text = f"{what}: the process {reason.get(name, f'crashed with {name}')}"
            return StudentCrashed(text, signal_name=name, status=None)
        return StudentCrashed(
            f"{what}: the process ended itself with exit code {code}", signal_name=None, status=code
        )

    def _violation(self, reason: str) -> SandboxError:
        return self._break(ProtocolViolation(f"the process wrote what is no answer: {reason}"))

    def _break(self, error: SandboxError) -> SandboxError:
        self._broken = error
        self._worker.kill()
        return error

    def _release(self) -> None:
        self._staging.close()
        identity.release_undumpable()


@functools.cache
def _interpreter_reachable() -> bool:
    return world_reachable(os.__file__)


_controls: dict[str, bool] = {}
"""What an unprotected process may do on this machine. Tried once, partly before the grader itself is closed,
partly by the first worker before it closes."""
