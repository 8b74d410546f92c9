"""Layer: resource limits of the process (``setrlimit``)."""

from __future__ import annotations

import math
import resource

from slamcmp.grading.sandbox.policy import Policy


def apply_limits(policy: Policy, *, own_uid: bool) -> None:
    """Limit memory, processor time, files and threads; nothing can be raised again afterwards.

    The thread limit counts all processes of the uid, so it is set only where the uid is this process's own.

    Raises:
        OSError, ValueError: a limit is above what the grader itself may use.
    """
    cpu = math.ceil(policy.cpu_s)
    wanted = {
        resource.RLIMIT_AS: policy.memory_bytes,
        resource.RLIMIT_CPU: cpu,
        resource.RLIMIT_FSIZE: 0,
        resource.RLIMIT_CORE: 0,
        resource.RLIMIT_NOFILE: policy.open_files,
        resource.RLIMIT_MEMLOCK: 0,
        resource.RLIMIT_MSGQUEUE: 0,
        resource.RLIMIT_SIGPENDING: 64,
    }
    if own_uid:
        wanted[resource.RLIMIT_NPROC] = policy.threads
    for which, value in wanted.items():
        _, hard = resource.getrlimit(which)
        if hard != resource.RLIM_INFINITY:
            value = min(value, hard)
        resource.setrlimit(which, (value, value))
