"""The folder of one session: the submission's files, and what the proofs are tried on."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path

from slamcmp.grading.sandbox.errors import SandboxUnavailable
from slamcmp.grading.sandbox.proofs import Targets


class Staging:
    """A temporary folder, removed by :meth:`close`; the submission in it is readable for one group only.

    Without a group (not root) it is the grader's own, as the worker runs as the same user.
    """

    def __init__(self, files: Mapping[str, bytes], group: int | None) -> None:
        try:
            self._base = Path(tempfile.mkdtemp(prefix="slamcmp-")).resolve()
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
            path.parent.mkdir(parents=True, exist_ok=True)
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
