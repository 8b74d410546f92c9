"""The folder of one session: the submission's files, and what the proofs are tried on."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

from slamcmp.grading.sandbox.errors import SandboxUnavailable
from slamcmp.grading.sandbox.walls.proofs import Targets

_PREFIX = "slamcmp-"
_STALE_S = 3600.0


class Staging:
    """A temporary folder, removed by :meth:`close`; the submission in it is readable for one group only.

    Without a group (not root) it is the grader's own, as the worker runs as the same user.
    """

    def __init__(self, files: Mapping[str, bytes], group: int | None) -> None:
        try:
            remove_stale()
            self._base = Path(tempfile.mkdtemp(prefix=own_prefix())).resolve()
        except OSError as error:
            raise SandboxUnavailable(f"no temporary folder for the sandbox: {error}") from error
        self._base.chmod(0o755)
        self.submission = self._folder("submission", 0o750)
        self.mount_point = self._folder("root")
        private = self._folder("private", 0o700)
        public = self._folder("public")
        writable = self._folder("writable", 0o777)
        self._write(private / "canary", b"private", 0o600)
        self._write(public / "canary", b"public", 0o644)
        self.targets = Targets(str(private / "canary"), str(public / "canary"), str(writable), os.getpid())
        for name, content in files.items():
            path = self.submission / name
            for folder in reversed(path.parents[: len(path.relative_to(self.submission).parts) - 1]):
                folder.mkdir(exist_ok=True)
                folder.chmod(0o755)
            self._write(path, content, 0o444)
        if group is not None:
            os.chown(self.submission, 0, group)

    def close(self) -> None:
        """Remove everything."""
        shutil.rmtree(self._base, ignore_errors=True)

    def _folder(self, name: str, mode: int = 0o755) -> Path:
        path = self._base / name
        path.mkdir()
        # Not by mkdir itself, where the umask would have its say.
        path.chmod(mode)
        return path

    @staticmethod
    def _write(path: Path, content: bytes, mode: int) -> None:
        path.write_bytes(content)
        path.chmod(mode)


def own_prefix() -> str:
    """How temporary folders of this process begin, so that :func:`remove_stale` knows them."""
    return f"{_PREFIX}{os.getpid()}-"


def remove_of(pid: int) -> None:
    """Remove the folders of a process of ours that was killed."""
    with os.scandir(tempfile.gettempdir()) as entries:
        for entry in entries:
            if entry.name.startswith(f"{_PREFIX}{pid}-"):
                shutil.rmtree(entry.path, ignore_errors=True)


def remove_stale() -> None:
    """Remove what a grader that was killed has left, once it is old and its process is gone."""
    with os.scandir(tempfile.gettempdir()) as entries:
        for entry in entries:
            pid = entry.name.removeprefix(_PREFIX).partition("-")[0]
            if not entry.name.startswith(_PREFIX) or not pid.isdigit() or Path("/proc", pid).exists():
                continue
            # Folders of others cannot be looked at or removed, and are none of our business.
            with contextlib.suppress(OSError):
                info = entry.stat(follow_symlinks=False)
                if info.st_uid == os.getuid() and time.time() - info.st_mtime > _STALE_S:
                    shutil.rmtree(entry.path, ignore_errors=True)
