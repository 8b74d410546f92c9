"""The grader's end of the pipes: bounded in time and in memory whatever the other side does."""

from __future__ import annotations

import fcntl
import os
import select
import time
from collections.abc import Iterable

from slamcmp.grading.sandbox.pipes.protocol import PREFIX, parse_prefix

_PIPE_BYTES = 1 << 20
_F_SETPIPE_SZ = 1031
_CHUNK = 1 << 16


class Expired(Exception):
    """The deadline passed."""


class Ended(Exception):
    """The other side closed its end."""


class Capture:
    """The first bytes of a stream; the rest is only counted."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self.kept = bytearray()
        self.discarded = 0

    def add(self, data: bytes) -> None:
        room = self._limit - len(self.kept)
        self.kept += data[:room]
        self.discarded += max(0, len(data) - room)


class Channel:
    """Request and reply pipe of a worker, and what it prints.

    The printed streams are drained in the same loop that waits for the answer, so a flood can neither fill
    a pipe and block the worker nor fill the grader's memory.
    """

    def __init__(self, request: int, reply: int, printed: int, *, body_max: int, output_max: int) -> None:
        self._request, self._reply, self._printed = request, reply, printed
        self._body_max = body_max
        self.capture = Capture(output_max)
        for descriptor in (request, reply, printed):
            os.set_blocking(descriptor, False)
        self._printed_ended = False
        self._poll_to_read, self._poll_to_write = select.poll(), select.poll()
        self._poll_to_read.register(reply, select.POLLIN)
        self._poll_to_write.register(request, select.POLLOUT)
        for poll in (self._poll_to_read, self._poll_to_write):
            poll.register(printed, select.POLLIN)

    def close(self) -> None:
        for descriptor in (self._request, self._reply, self._printed):
            os.close(descriptor)

    def drain(self) -> None:
        """Take what has been printed so far."""
        for _ in range(32):
            if not self._take_printed():
                return

    def pending(self) -> bool:
        """Whether there is something in the reply pipe already."""
        watch = select.poll()
        watch.register(self._reply, select.POLLIN)
        return any(event & select.POLLIN for _, event in watch.poll(0))

    def send(self, buffers: Iterable[bytes | memoryview], deadline: float) -> None:
        """Write a whole frame.

        Raises:
            Expired, Ended
        """
        for buffer in buffers:
            view = memoryview(buffer)
            while view:
                try:
                    view = view[os.write(self._request, view) :]
                except BlockingIOError:
                    self._wait(deadline, writing=True)
                except BrokenPipeError as error:
                    raise Ended from error

    def receive(self, deadline: float) -> tuple[bytearray, bytearray]:
        """Header and body of the next frame.

        Raises:
            Expired, Ended
            FrameError: the prefix is not one of a frame, or announces more than is allowed.
        """
        prefix = self._fill(bytearray(PREFIX.size), deadline)
        header, body = parse_prefix(bytes(prefix), body_max=self._body_max)
        return self._fill(bytearray(header), deadline), self._fill(bytearray(body), deadline)

    def _fill(self, data: bytearray, deadline: float) -> bytearray:
        view = memoryview(data)
        while view:
            try:
                got = os.readv(self._reply, [view])
            except BlockingIOError:
                self._wait(deadline)
                continue
            if got == 0:
                raise Ended
            view = view[got:]
        return data

    def _wait(self, deadline: float, *, writing: bool = False) -> None:
        left = deadline - time.monotonic()
        if left <= 0:
            raise Expired
        poll = self._poll_to_write if writing else self._poll_to_read
        for descriptor, _ in poll.poll(left * 1000):
            if descriptor == self._printed:
                self._take_printed()

    def _take_printed(self) -> bool:
        """Take one piece; False when there is none at the moment."""
        if self._printed_ended:
            return False
        try:
            data = os.read(self._printed, _CHUNK)
        except BlockingIOError:
            return False
        if not data:
            # Closed by the submission: poll would report it for ever and never wait.
            self._printed_ended = True
            self._poll_to_read.unregister(self._printed)
            self._poll_to_write.unregister(self._printed)
        self.capture.add(data)
        return bool(data)


def widen(descriptor: int) -> None:
    """Ask for a pipe of 1 MB, so that a covariance of 300 states passes in one write."""
    try:
        fcntl.fcntl(descriptor, _F_SETPIPE_SZ, _PIPE_BYTES)
    except OSError:
        # A user's pipes together may be limited: slower, but right.
        return
