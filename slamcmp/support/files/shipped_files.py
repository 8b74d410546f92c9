"""Where the shipped experiments and assignments lie: beside the package in a checkout, else inside it."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[2]


def shipped_folder() -> Path:
    """``slamcmp/shipped`` of an installation (setup.py puts it there), or ``experiments`` of a checkout."""
    installed = _PACKAGE / "shipped"
    return installed if installed.is_dir() else _PACKAGE.parent / "experiments"
