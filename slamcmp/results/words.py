"""Names of parameters in words: ``source.range_sigma_m`` is *range sigma [m]*."""

from __future__ import annotations

import re
from collections.abc import Iterable

UNITS = {
    "m": "m",
    "mm": "mm",
    "deg": "°",
    "rad": "rad",
    "s": "s",
    "ms": "ms",
    "px": "px",
    "mb": "MB",
    "hz": "Hz",
    "mps": "m/s",
    "m_per_s": "m/s",
    "deg_per_s": "°/s",
    "rad_per_s": "rad/s",
    "m_s": "m/s",
    "deg_s": "°/s",
    "rad_s": "rad/s",
    "m_s_sqrt_s": "m/s √s",
    "rad_s_sqrt_s": "rad/s √s",
    "m_sqrt_s": "m/√s",
    "rad_sqrt_s": "rad/√s",
    "per_m": "per m",
    "per_m2": "per m²",
}
"""What a parameter's name may end with, and how that unit is written."""
SECTIONS = {"source": "source", "front_end": "front end", "back_ends": "back end"}


def parameter_words(path: str) -> str:
    """A dotted path of the configuration as a reader says it, with the unit where its name has one.

    >>> parameter_words("source.range_sigma_m")
    'range sigma [m]'
    >>> parameter_words("back_ends.window 5.lag_frames")
    'lag frames of window 5'
    """
    section, _, rest = path.partition(".")
    owner, dot, name = rest.rpartition(".")
    if section not in SECTIONS or not name:
        return path
    text = _with_unit(name)
    return f"{text} of {owner}" if dot and section == "back_ends" else text


def parameters_in_words(paths: Iterable[str]) -> dict[str, str]:
    """The words of each path; two that would read alike also say their section."""
    known = list(paths)
    words = {path: parameter_words(path) for path in known}
    said = list(words.values())
    return {
        path: f"{text} ({SECTIONS[path.partition('.')[0]]})" if said.count(text) > 1 else text
        for path, text in words.items()
    }


def setting_in_words(words: str, value: str) -> str:
    """A parameter's words with a value, which takes the unit.

    >>> setting_in_words("range sigma [m]", "0.1")
    'range sigma = 0.1 m'
    >>> setting_in_words("turn [°] of EKF", "none")
    'turn of EKF = none'
    """
    found = re.fullmatch(r"(.*?) \[(.+?)\](.*)", words)
    if found is None:
        return f"{words} = {value}"
    gap = "" if found[2].startswith("°") else " "
    return f"{found[1]}{found[3]} = {value}" + (f"{gap}{found[2]}" if value != "none" else "")


def _with_unit(name: str) -> str:
    for ending in sorted(UNITS, key=len, reverse=True):
        stem = name.removesuffix(f"_{ending}")
        if stem != name:
            return f"{stem.replace('_', ' ')} [{UNITS[ending]}]"
    return name.replace("_", " ")
