"""Data of the sliding window's tests: windows of a robot on a bend, drives, and three other programs."""

from .drives import dial, drive, filters, long_drive, smoother
from .laws import heading_from_nothing, put_together, statements
from .some_windows import pasts, places, policies, steps, systems, windows, windows_elsewhere, windows_west

__all__ = [
    "pasts",
    "places",
    "policies",
    "steps",
    "systems",
    "windows",
    "windows_elsewhere",
    "windows_west",
    "heading_from_nothing",
    "put_together",
    "statements",
    "dial",
    "drive",
    "filters",
    "long_drive",
    "smoother",
]
