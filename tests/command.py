"""The command line in this process: a tenth of the time that a new one takes to start."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from slamcmp.cli import main


class Command:
    """The command line in this process: exit code, standard output and error."""

    def __init__(self, folder: Path, patch: pytest.MonkeyPatch, capture: pytest.CaptureFixture[str]) -> None:
        self._patch, self._capture = patch, capture
        patch.chdir(folder)

    def __call__(self, *arguments: str) -> tuple[int, str, str]:
        self._patch.setattr(sys, "argv", ["slamcmp", *arguments])
        with pytest.raises(SystemExit) as ended:
            main()
        return (int(ended.value.code or 0), *self._capture.readouterr())
