"""Jobs on a Dask cluster: on machines that share nothing with this one but the network.

The user's machine plans, keeps the store and makes the tables; a job goes out with the files that it reads
and comes back as the files that it left. A worker that is lost has its jobs done by another; where the
scheduler is lost what came back is kept, and the same command does the rest. Jobs whose plug-in or data is a
file that a worker does not have are done here.
"""

from __future__ import annotations

import contextlib
import queue
import time
from collections import OrderedDict
from collections.abc import Collection, Mapping
from typing import Any

from slamcmp.errors import UsageError
from slamcmp.experiment.executors.processes import Ended, ExecutorLostError, Processes
from slamcmp.experiment.executors.remote_job import Sent, do, for_elsewhere, package_version
from slamcmp.experiment.job.task import Task, stream_path, truth_path
from slamcmp.registry import executors
from slamcmp.results.runs.run_file import load_truth
from slamcmp.support.files.atomic import write_atomically
from slamcmp.support.files.packed_files import content
from slamcmp.support.messages import describe

CONNECT_S = 10.0
WORKERS_S = 60.0
"""How long to wait for the first worker; a batch system may take its time to start one."""
AHEAD = 2
"""Jobs a thread of a worker has: one to do, and one that waits beside it."""
STREAMS_KEPT = 64
"""Streams that stay with the cluster for runs to come."""
ASK_EVERY_S = 2.0
HEARTBEAT_S = 1.0
"""In which a scheduler notices that a worker on its machine was killed."""
TRIES = 3
"""Times that a job is sent out again after it was lost; one that ends its machine is not sent for ever."""


@executors.register("dask", scheduler=True)
class DaskCluster:
    """The workers of a scheduler; without an address a cluster of this machine's own.

    Args:
        slots: workers of such a cluster.
        scheduler: ``tcp://host:port``, or the path of a scheduler's file.

    Raises:
        UsageError: the package distributed is not installed, nobody answers, or a worker has another slamcmp.
    """

    def __init__(self, *, slots: int = 1, scheduler: str | None = None) -> None:
        try:
            import distributed  # type: ignore[import-not-found,unused-ignore]
        except ImportError as error:
            raise UsageError(
                "executor 'dask' needs the package distributed: pip install 'slamcmp[dask]'"
            ) from error
        self._cluster: Any = None
        if scheduler is None:
            self._cluster = distributed.LocalCluster(  # type: ignore[no-untyped-call,unused-ignore]
                n_workers=slots, threads_per_worker=1, dashboard_address=None, silence_logs=50
            )
            self.address = str(self._cluster.scheduler_address)
        else:
            self.address = scheduler
        self._client = _connected(distributed, self.address)
        self._version = package_version()
        self._here = Processes(slots=1)
        self._waiting_here: list[Task] = []
        self._busy_here = False
        self._ended: queue.SimpleQueue[tuple[Task, Any]] = queue.SimpleQueue()
        self._running: dict[str, Task] = {}
        self._tries: dict[str, int] = {}
        self._streams: OrderedDict[str, Any] = OrderedDict()
        """By digest: the files of streams that are with the cluster."""
        self._asked, self._threads, self._count = 0.0, 1, 0
        self._is_closed = False
        self._await_workers()

    @property
    def slots(self) -> int:
        """Workers may come and go."""
        if not self._is_closed and time.monotonic() > self._asked + ASK_EVERY_S:
            try:
                self._threads = sum(self._client.nthreads().values())
            except Exception as error:
                raise _lost(self.address) from error
            self._asked = time.monotonic()
        return max(1, AHEAD * self._threads)

    def start(self, task: Task) -> None:
        self._count += 1
        inputs, frames = [], 0
        if task.kind == "run":
            known = load_truth(truth_path(task.folder, task.stream_key))
            frames = 0 if known is None else known.frames
            inputs = [self._stream(task)]
        future = self._client.submit(
            do,
            for_elsewhere(task),
            self._version,
            frames,
            *inputs,
            pure=False,
            key=f"slamcmp-{task.kind}-{task.key}-{self._count}",
        )
        self._running[task.key] = task
        future.add_done_callback(lambda done: self._ended.put((task, done)))

    def wait(self, timeout_s: float) -> list[Ended]:
        found = self._look_here()
        deadline = time.monotonic() + (0.0 if found else timeout_s)
        while True:
            try:
                left = max(0.0, deadline - time.monotonic())
                task, future = self._ended.get(timeout=left) if left else self._ended.get_nowait()
            except queue.Empty:
                return found + self._look_here()
            ended = self._taken(task, future)
            if ended is not None:
                found.append(ended)
                deadline = 0.0

    def frames_done(self) -> dict[str, int]:
        return self._here.frames_done()

    def at_hand(self) -> Collection[str]:
        return ()

    def close(self) -> None:
        self._is_closed = True
        self._here.close()
        self._streams.clear()
        for each in (self._client, self._cluster):
            if each is not None:
                # Whoever is gone needs no farewell.
                with contextlib.suppress(Exception):
                    each.close(timeout=5)

    def _await_workers(self) -> None:
        try:
            self._client.wait_for_workers(1, timeout=WORKERS_S)
            found: Mapping[str, str] = self._client.run(package_version)
        except Exception as error:
            self.close()
            raise UsageError(
                f"the Dask scheduler {self.address} has no worker that knows slamcmp ({describe(error)}): "
                "start some ('dask worker ADDRESS') where slamcmp is installed as it is here"
            ) from error
        other = sorted(address for address, version in found.items() if version != self._version)
        if other:
            self.close()
            raise UsageError(
                f"{', '.join(other[:3])}: another version of slamcmp is installed there; install the same one"
            )

    def _stream(self, task: Task) -> Any:
        """The files that a run reads, with the cluster already or on their way."""
        kept = self._streams.get(task.digest)
        if kept is None or kept.status in ("cancelled", "lost", "error"):
            files = {}
            for path in (stream_path(task.folder, task.digest), truth_path(task.folder, task.stream_key)):
                try:
                    files[f"streams/{path.name}"] = content(path)
                except OSError:
                    # The job itself says what it lacks.
                    continue
            kept = self._scattered(files)
        self._streams[task.digest] = kept
        self._streams.move_to_end(task.digest)
        while len(self._streams) > STREAMS_KEPT:
            self._streams.popitem(last=False)
        return kept

    def _scattered(self, files: Mapping[str, bytes]) -> Any:
        """Files handed to a worker; to another where the first was lost and the scheduler did not know yet.

        Raises:
            ExecutorLostError: nobody is there any more to take them.
        """
        for _ in range(TRIES):
            try:
                # In a list: a mapping would be scattered value by value.
                (kept,) = self._client.scatter([files], hash=False)
            except (OSError, TimeoutError) as error:
                if self._client.status != "running":
                    raise _lost(self.address) from error
                time.sleep(HEARTBEAT_S)
            else:
                return kept
        raise _lost(self.address)

    def _taken(self, task: Task, future: Any) -> Ended | None:
        """How a job ended, its files put where they belong; None where it goes on here."""
        if self._running.pop(task.key, None) is None:
            return None
        fault = ""
        if future.status in ("cancelled", "lost"):
            fault = "its result was lost with a worker"
        else:
            try:
                sent: Sent = future.result(timeout=CONNECT_S)
            except (TimeoutError, OSError) as error:
                raise _lost(self.address) from error
            except BaseException as error:
                # A cancelled one is no Exception in every version.
                if isinstance(error, KeyboardInterrupt):
                    raise
                fault = f"its Dask workers were lost: {describe(error)}"
        if fault:
            return self._again(task, fault)
        if sent.not_here:
            self._waiting_here.append(task)
            return None
        for name, text in sent.files.items():
            _put(task, name, text)
        return Ended(
            task,
            sent.fault,
            sent.status,
            outdated=sent.outdated,
            frames_done=sent.frames_done,
            note=sent.note,
        )

    def _again(self, task: Task, fault: str) -> Ended | None:
        """Have a job done once more whose worker was lost, a few times.

        Raises:
            ExecutorLostError: nobody is there any more to do it.
        """
        if self._client.status != "running":
            raise _lost(self.address)
        self._tries[task.key] = tries = self._tries.get(task.key, 0) + 1
        if tries > TRIES:
            return Ended(task, f"{fault}, {tries} times", "killed")
        self.start(task)
        return None

    def _look_here(self) -> list[Ended]:
        ended = self._here.wait(0.0) if self._busy_here else []
        self._busy_here = self._busy_here and not ended
        if self._waiting_here and not self._busy_here:
            self._here.start(self._waiting_here.pop(0))
            self._busy_here = True
        return ended


def _lost(address: str) -> ExecutorLostError:
    return ExecutorLostError(
        f"the Dask scheduler {address} is gone; what finished is kept: run the same command again"
    )


def _put(task: Task, name: str, text: bytes) -> None:
    path = task.folder / name
    write_atomically(path, lambda file: file.write(text))


def _connected(distributed: Any, address: str) -> Any:
    """A client of the scheduler.

    Raises:
        UsageError: nobody answers at that address.
    """
    named = {"address": address} if "://" in address else {"scheduler_file": address}
    try:
        return distributed.Client(**named, timeout=CONNECT_S, set_as_default=False, direct_to_workers=False)
    except (OSError, TimeoutError, ValueError, KeyError) as error:
        raise UsageError(
            f"--scheduler {address}: no Dask scheduler answers there ({describe(error)}); its address looks "
            "like tcp://host:8786"
        ) from error
