"""Ctrl-C, and the signals with which a system ends programs, as an event that the runner looks at."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType
from typing import Any

ENDING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Ctrl-C; what batch systems send before they kill; the end of the terminal."""


@contextlib.contextmanager
def interruptions(*, raising: bool = False) -> Iterator[threading.Event]:
    """An event that the first of these signals sets, and that no further one disturbs: tables are written.

    Args:
        raising: the first one also raises KeyboardInterrupt, for work in this very process.

    Raised where work is done elsewhere, it could fall into a finaliser, where Python drops exceptions, and be
    lost. A signal that is ignored (``nohup``) stays so. Outside of the main thread nothing is caught.
    """
    stop = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return

    def note(number: int, frame: FrameType | None) -> None:  # noqa: ARG001
        first = not stop.is_set()
        stop.set()
        if first and raising:
            raise KeyboardInterrupt

    before: dict[Any, Any] = {}
    for number in ENDING:
        known = signal.getsignal(number)
        # None: a handler that Python does not know and could not put back.
        if known is not None and known != signal.SIG_IGN:
            before[number] = signal.signal(number, note)
    try:
        yield stop
    finally:
        for number, known in before.items():
            signal.signal(number, known)


def ignore_further() -> None:
    """From here on none of them disturbs this process: an ended command has yet to tell what it has."""
    for number in ENDING:
        signal.signal(number, signal.SIG_IGN)
