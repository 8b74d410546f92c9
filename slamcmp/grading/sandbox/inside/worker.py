"""The process that runs a submission: closes itself, proves it, then answers requests until it is killed.

Started by ``session`` with an environment of its own and two pipes. Everything up to
the first ``load`` is trusted code; from then on, nothing this process says is.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from types import ModuleType
from typing import Any

from slamcmp.grading.sandbox.walls.proofs import Targets, attempt

_BODY_MAX = 1 << 30


def main(request: int, reply: int) -> None:
    """Serve the pipes with these two file descriptors."""
    parent, private, public, writable, tried = sys.argv[1:6]
    targets = Targets(private, public, writable, int(parent))
    # While the process is small: a fork after numpy has loaded costs ten times as much.
    control = {} if tried == "tried" else attempt(targets)
    _Worker(request, reply, targets, control).serve()


class _Worker:
    def __init__(self, request: int, reply: int, targets: Targets, control: dict[str, bool]) -> None:
        # Imports numpy, so not at the top.
        from slamcmp.grading.sandbox.inside import student
        from slamcmp.grading.sandbox.pipes import protocol

        self._protocol, self._student = protocol, student
        self._request, self._reply = request, reply
        self._targets, self._control = targets, control
        self._folder = "/nonexistent"
        self._module: ModuleType | None = None
        self._objects: list[Any] = []
        self._operations: dict[str, Callable[[dict[str, Any]], Any]] = {
            "close": self._close,
            "load": self._load,
            "construct": self._construct,
            "step": self._step,
            "call": self._call,
        }

    def serve(self) -> None:
        while True:
            prefix = self._read(self._protocol.PREFIX.size)
            header_size, body_size = self._protocol.parse_prefix(bytes(prefix), body_max=_BODY_MAX)
            message = self._protocol.decode(self._read(header_size), self._read(body_size))
            nonce = message["nonce"]
            try:
                result = self._operations[message["op"]](message)
                buffers = self._protocol.encode({"nonce": nonce, "ok": result})
            except BaseException as error:
                described = self._student.describe(error, self._folder)
                buffers = self._protocol.encode({"nonce": nonce, "error": described})
            self._write(buffers)

    def _close(self, message: dict[str, Any]) -> Any:
        import importlib

        from slamcmp.grading.sandbox.inside.inert import make_inert
        from slamcmp.grading.sandbox.policy import Policy, Readable
        from slamcmp.grading.sandbox.walls.layers import Surroundings, close_process

        policy = Policy(**message["policy"])
        around = Surroundings(**message["around"])
        for name in (*policy.preload, "slamcmp.types", *policy.modules):
            importlib.import_module(name)
        layers = close_process(policy, Readable(**message["readable"]), around)
        self._folder = around.submission
        # slamcmp itself lies there in a development install, and cannot be read any more.
        sys.path.remove(message["root"])
        make_inert(tuple(set(policy.inert) - set(policy.packages)))
        sys.argv[:] = ["submission"]
        sys.dont_write_bytecode = True
        closed = attempt(self._targets)
        return {"pid": os.getpid(), "layers": layers, "control": self._control, "closed": closed}

    def _load(self, message: dict[str, Any]) -> Any:
        self._module = self._student.load(
            self._folder,
            message["entry"],
            definitions_only=message["definitions_only"],
            wanted=message["wanted"],
        )
        return self._student.public_names(self._module)

    def _construct(self, message: dict[str, Any]) -> Any:
        arguments: list[Any] = []
        if message["problem"] is not None:
            from slamcmp.registry import sensors
            from slamcmp.types import Problem

            told = message["problem"]
            # Not through the registry's search: the other modules of the package cannot be read any more.
            target = sensors._plugins[told["sensor"]].target
            arguments.append(Problem(told["T_world_body"], told["P"], target(**told["parameters"])))
        self._objects.append(self._attribute(message["name"])(*arguments, **message["parameters"]))
        return len(self._objects) - 1

    def _step(self, message: dict[str, Any]) -> Any:
        """Update with a frame, if there is one, then ask for what is wanted."""
        from slamcmp.types import Frame

        thing = self._objects[message["handle"]]
        if message["frame"] is not None:
            thing.update(Frame(*message["frame"]))
        wanted = message["want"]
        answer: dict[str, Any] = {}
        if "estimate" in wanted:
            answer["estimate"] = _fields(thing.estimate(), "estimate()", ("T_world_body", "P"))
        if "landmarks" in wanted:
            names = ("ids", "positions", "covariances")
            answer["landmarks"] = _fields(thing.landmarks(), "landmarks()", names)
        if "joint_covariance" in wanted:
            answer["joint_covariance"] = thing.joint_covariance()
        if "trajectory" in wanted:
            names = ("t", "T_world_body", "P")
            answer["trajectory"] = _fields(thing.trajectory(), "trajectory()", names)
        return answer

    def _call(self, message: dict[str, Any]) -> Any:
        return self._attribute(message["name"])(*message["arguments"], **message["keywords"])

    def _attribute(self, name: str) -> Any:
        if not hasattr(self._module, name):
            known = ", ".join(self._student.public_names(self._module)) if self._module else ""
            raise NameError(f"the submission has no {name!r}; it defines: {known or 'nothing'}")
        return getattr(self._module, name)

    def _read(self, count: int) -> bytearray:
        data = bytearray(count)
        view = memoryview(data)
        while view:
            got = os.readv(self._request, [view])
            if got == 0:
                os._exit(0)
            view = view[got:]
        return data

    def _write(self, buffers: list[bytes | memoryview]) -> None:
        for buffer in buffers:
            view = memoryview(buffer)
            while view:
                view = view[os.write(self._reply, view) :]


def _fields(value: Any, what: str, names: tuple[str, ...]) -> dict[str, Any]:
    missing = [name for name in names if not hasattr(value, name)]
    if missing:
        raise TypeError(
            f"{what} returned {type(value).__name__}, which has no {missing[0]!r}; "
            f"an object with {', '.join(names)} is needed"
        )
    return {name: getattr(value, name) for name in names}
