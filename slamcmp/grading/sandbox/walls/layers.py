"""Close the worker: every layer in the one order in which they work, each reported whether it could be."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace

from slamcmp.grading.sandbox.policy import Policy, Readable
from slamcmp.grading.sandbox.walls import identity
from slamcmp.grading.sandbox.walls.identity import (
    become,
    die_with_parent,
    forbid_debugging,
    forbid_new_privileges,
)
from slamcmp.grading.sandbox.walls.landlock import apply_landlock
from slamcmp.grading.sandbox.walls.limits import apply_limits
from slamcmp.grading.sandbox.walls.private_root import enter_private_root
from slamcmp.grading.sandbox.walls.seccomp import apply_seccomp

ACTIVE = "active"


@dataclass(frozen=True)
class Surroundings:
    """What the layers need to know about this machine, found out by the grader."""

    submission: str
    """Folder that holds the submission's files."""
    mount_point: str
    """An empty folder, as root; the private root is put there, inside the worker's own namespace."""
    uid: int | None
    """The unused uid to become, None where not root."""
    reachable: bool
    """Whether that uid could read the interpreter and the submission where they lie."""
    switched_off: tuple[str, ...] = ()
    """Layers left out, to measure or test the others."""


def close_process(policy: Policy, readable: Readable, around: Surroundings) -> dict[str, str]:
    """Apply every layer that works here; ``active`` or the reason why not, by the layer's name.

    Raises:
        RuntimeError: a package has started threads, which would stay outside some of the layers.
    """
    if identity.has_threads():
        raise RuntimeError(f"an allowed package ({', '.join(policy.preload)}) starts threads on import")
    readable = replace(readable, trees=(*readable.trees, around.submission))
    report: dict[str, str] = {}
    off = around.switched_off

    if around.uid is None:
        report["private root"] = "not active: needs root"
    elif "private root" in off:
        report["private root"] = "not active: switched off"
    else:
        report["private root"] = _try(lambda: enter_private_root(readable, around.mount_point))

    own_uid = False
    if around.uid is None:
        report["own uid"] = "not active: needs root"
    elif "own uid" in off:
        report["own uid"] = "not active: switched off"
    elif not around.reachable and report["private root"] != ACTIVE:
        report["own uid"] = (
            f"not active: {sys.executable} or {around.submission} lies where other users may not read"
        )
    else:
        uid = around.uid
        report["own uid"] = _try(lambda: become(uid))
        own_uid = report["own uid"] == ACTIVE

    report["no new privileges"] = _try(forbid_new_privileges)
    _try(forbid_debugging)
    die_with_parent()
    report["limits"] = _unless_off("limits", off, lambda: apply_limits(policy, own_uid=own_uid))
    report["Landlock"] = _unless_off("Landlock", off, lambda: apply_landlock(readable))
    report["seccomp"] = _unless_off(
        "seccomp",
        off,
        lambda: apply_seccomp(open_to_write=ACTIVE in (report["Landlock"], report["private root"])),
    )
    return report


def _unless_off(name: str, off: tuple[str, ...], apply: Callable[[], object]) -> str:
    return "not active: switched off" if name in off else _try(apply)


def _try(apply: Callable[[], object]) -> str:
    try:
        apply()
    except (OSError, ValueError, NotImplementedError) as error:
        return f"not active: {error}"
    return ACTIVE
