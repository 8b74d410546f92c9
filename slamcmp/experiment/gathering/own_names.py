"""Landmarks by the names that their file gave them: back ends know them as numbers from 0 on."""

from __future__ import annotations

import re

from slamcmp.types import IntArray

IN_WORDS = re.compile(r"\b(landmarks?(?: ids?)?) (-?\d+)(?![\d.])")


def own_names(numbers: IntArray, names: IntArray | None) -> IntArray:
    """The names of landmarks ``numbers`` (any,); a number that no landmark has stays as it is."""
    if names is None:
        return numbers
    known = (numbers >= 0) & (numbers < names.size)
    renamed = numbers.copy()
    renamed[known] = names[numbers[known]]
    return renamed


def with_own_names(text: str, names: IntArray | None) -> str:
    """What a back end said about ``landmark 3``, by that landmark's name."""
    if names is None:
        return text

    def renamed(found: re.Match[str]) -> str:
        number = int(found[2])
        return f"{found[1]} {names[number]}" if 0 <= number < names.size else found[0]

    return IN_WORDS.sub(renamed, text)
