"""Recorded data for tests lies in the folder that SLAMCMP_DATA names; it is not part of the project."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


def recorded(name: str) -> Path:
    """The folder of one data set; without it the test is skipped, in CI it fails."""
    root = os.environ.get("SLAMCMP_DATA")
    if root and (Path(root) / name).is_dir():
        return Path(root) / name
    reason = f"SLAMCMP_DATA does not name a folder with {name}"
    if os.environ.get("CI"):
        pytest.fail(reason)
    pytest.skip(reason)
