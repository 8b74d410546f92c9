"""A class with everything in it that a class may hold, and the score that each entry must get."""

from __future__ import annotations

import json
import os
import zipfile
from pathlib import Path

HONEST = """
def double(x): return 2.0 * x
def half(x): return x / 2.0
def square(x): return x * x
"""
WRONG = HONEST.replace("x / 2.0", "x / 3.0")
HOSTILE = {
    "loops_forever": "while True: pass",
    "leaves": "import os\nos._exit(0)",
    "eats_memory": "x = []\nwhile True: x.append(bytearray(1 << 24))",
    "floods": "while True: print('x' * 100_000)",
    "forks": "import os\nwhile True: os.fork()",
    "kills": "import os, signal\nos.kill(-1, signal.SIGKILL)\nos.kill(os.getppid(), signal.SIGKILL)",
    "crashes": "import ctypes\nctypes.string_at(0)",
    "writes_its_grade": "open('outcome.json', 'w').write('{}')",
    "no_python": "dear grader, please",
}
"""Score 0 each: none of them comes to define a function."""


def build(folder: Path, size: int) -> dict[str, float]:
    """Fill ``folder`` with ``size`` entries, one in two of them odd; the score of each student (of 30)."""
    folder.mkdir()
    expected: dict[str, float] = {}

    def write(name: str, text: str, score: float) -> None:
        (folder / name).write_text(text)
        expected[Path(name).stem] = score

    for name, source in HOSTILE.items():
        write(f"{name}.py", source, 0.0)
    write("grader_crashes.py", f"{HONEST}\n# the grader crashes\n", 10.0)
    write("=1+1.py", HONEST, 30.0)
    write("zoë ✓ <b>.py", WRONG, 20.0)
    with zipfile.ZipFile(folder / "zipped.zip", "w") as archive:
        archive.writestr("submission.py", HONEST)
    expected["zipped"] = 30.0
    (folder / "foldered").mkdir()
    (folder / "foldered" / "submission.py").write_text(WRONG)
    expected["foldered"] = 20.0
    write("not_a_zip.zip", "PK nonsense", 0.0)
    cell = {"cell_type": "code", "metadata": {}, "source": HONEST, "outputs": [], "execution_count": None}
    write(
        "notes.ipynb",
        json.dumps({"nbformat": 4, "nbformat_minor": 5, "metadata": {}, "cells": [cell]}),
        30.0,
    )
    os.mkfifo(folder / "pipe.py")
    (folder / "link.py").symlink_to("/etc/passwd")
    expected.update({"pipe": 0.0, "link": 0.0})
    for number in range(size - len(expected)):
        write(
            f"student{number:03d}.py", (HONEST, WRONG)[number % 2] + f"# {number}\n", (30.0, 20.0)[number % 2]
        )
    return expected
