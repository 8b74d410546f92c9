"""Start a worker process and end it: the grader's side of its life."""

from __future__ import annotations

import contextlib
import functools
import importlib.util
import os
import pkgutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import slamcmp
from slamcmp.grading import sandbox
from slamcmp.grading.sandbox.pipes.channel import Channel, widen
from slamcmp.grading.sandbox.policy import Policy, Readable
from slamcmp.grading.sandbox.walls.bubblewrap import bubblewrap_command
from slamcmp.grading.sandbox.walls.proofs import Targets

ROOT = str(Path(slamcmp.__file__).parent.parent)
# The grader's own limit of memory is not the worker's, which sets one once it has loaded its modules.
# The sites are named because a path file that leads to one may not be readable, as in bubblewrap.
_BOOT = """
import resource, sys
resource.setrlimit(resource.RLIMIT_AS, 2 * resource.getrlimit(resource.RLIMIT_AS)[1:])
sys.path.insert(0, {root!r})
sys.path += [site for site in {sites!r} if site not in sys.path]
from {module} import main
main({request}, {reply})
"""
_WORKER = "slamcmp.grading.sandbox.inside.worker"
_CORE = (
    "slamcmp",
    "slamcmp.errors",
    "slamcmp.loaded_code",
    "slamcmp.types",
    "slamcmp.protocols",
    "slamcmp.registry",
)
_ENVIRONMENT = {
    "PATH": "/usr/bin:/bin",
    "HOME": "/nonexistent",
    "LC_ALL": "C.UTF-8",
    "TZ": "UTC",
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "SLAMCMP_INSIDE_SANDBOX": "1",
    # The same order of sets in each run of the same submission.
    "PYTHONHASHSEED": "0",
}


class Worker:
    """A running worker and its channel."""

    def __init__(
        self, policy: Policy, readable: Readable, targets: Targets, *, bubblewrap: bool, tried: bool
    ) -> None:
        request_read, request_write = os.pipe()
        reply_read, reply_write = os.pipe()
        printed_read, printed_write = os.pipe()
        widen(request_write)
        widen(reply_write)
        boot = _BOOT.format(
            root=ROOT, sites=readable.listed, module=_WORKER, request=request_read, reply=reply_write
        )
        # -P and -s are what -I does besides ignoring the environment, which is ours here.
        words = [sys.executable, "-P", "-s", "-u", "-X", "utf8", "-c", boot]
        words += [str(targets.parent), targets.private_file, targets.public_file, targets.writable_folder]
        words.append("tried" if tried else "untried")
        if bubblewrap:
            words = bubblewrap_command(readable, _source_files(policy.modules)) + words
        try:
            self._process = subprocess.Popen(
                words,
                stdin=subprocess.DEVNULL,
                stdout=printed_write,
                stderr=printed_write,
                env=_ENVIRONMENT,
                cwd="/",
                pass_fds=(request_read, reply_write),
                start_new_session=True,
            )
        finally:
            for descriptor in (request_read, reply_write, printed_write):
                os.close(descriptor)
        self.pid = self._process.pid
        self.channel = Channel(
            request_write,
            reply_read,
            printed_read,
            body_max=policy.reply_bytes,
            output_max=policy.output_bytes,
        )

    def cpu_s(self) -> float:
        """Processor time of the whole process, from the kernel [s]; NaN once it has ended."""
        # The clock id of another process, as clock_getcpuclockid(3) makes it.
        try:
            return time.clock_gettime((~self.pid << 3) | 2)
        except OSError:
            return float("nan")

    def ending(self, timeout_s: float) -> int | None:
        """The exit code (negative: the signal), None when it is still running after that time."""
        try:
            return self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            return None

    def kill(self) -> None:
        """End the process with everything it may have started; safe to call twice."""
        if self._process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()


@functools.cache
def _source_files(modules: tuple[str, ...]) -> tuple[str, ...]:
    """Files of slamcmp that the worker itself imports, with their compiled twins."""
    inside = [module.name for module in pkgutil.walk_packages(sandbox.__path__, "slamcmp.grading.sandbox.")]
    names = [*_CORE, "slamcmp.geometry", "slamcmp.grading", "slamcmp.grading.sandbox", *inside]
    for module in modules:
        parts = module.split(".")
        names += [".".join(parts[: end + 1]) for end in range(len(parts))]
    files: list[str] = []
    for name in dict.fromkeys(names):
        spec = importlib.util.find_spec(name)
        if spec is not None and spec.origin is not None:
            files += [spec.origin, importlib.util.cache_from_source(spec.origin)]
    return tuple(files)
