"""What can be told of a submission's source without running any of it.

A source that was made to hurt its reader (150 000 opening brackets, say) ends the parser with the process it
runs in. So it is read in a process of its own, with little memory and time, which may die.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from slamcmp.grading.hand_in.submission import Submission
from slamcmp.grading.sandbox.inside import definitions

_MEMORY_BYTES, _CPU_S, _WALL_S = 384 << 20, 5, 20
_LEFT_OUT_TOLD = 5

# Runs with the text of definitions.py in front; functions asked for are its argument, the source its input.
_SCRIPT = """
import json, sys

asked = json.loads(sys.argv[1])
tree = ast.parse(sys.stdin.buffer.read())

def left_open(node):
    body = [each for each in node.body
            if not (isinstance(each, ast.Expr) and isinstance(each.value, ast.Constant))]
    if len(body) != 1 or not isinstance(body[0], ast.Raise):
        return False
    raised = body[0].exc
    raised = raised.func if isinstance(raised, ast.Call) else raised
    return isinstance(raised, ast.Name) and raised.id == "NotImplementedError"

bound, opened = set(), set()
for node in ast.walk(tree):
    if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
        bound.add(node.name)
    elif isinstance(node, ast.alias):
        bound.add(node.asname or node.name)
    elif isinstance(node, ast.Name):
        bound.add(node.id)
for node in tree.body:
    if isinstance(node, ast.FunctionDef):
        (opened.add if left_open(node) else opened.discard)(node.name)
unwritten = [name for name in asked if name in opened or not (name in bound or "*" in bound)]
left_out = [[node.lineno, node.end_lineno] for node in definitions(tree.body, asked)[1]
            if not isinstance(node, (ast.Import, ast.ImportFrom))]
json.dump({"unwritten": unwritten, "left_out": left_out}, sys.stdout)
"""


@dataclass(frozen=True)
class SourceReading:
    """What a submission's entry file holds."""

    unwritten: tuple[str, ...] = ()
    """Functions asked for that are neither defined nor imported, or of which nothing is written but
    ``raise NotImplementedError``. What a function does when it is called decides nothing."""
    left_out: tuple[str, ...] = ()
    """Where a notebook's exploration stands, which is not run: ``cell 2, lines 1 to 4``."""


def read_source(submission: Submission, asked: Sequence[str]) -> SourceReading:
    """Look at the entry file; one that cannot be read lacks nothing, loading it will tell why."""
    script = Path(definitions.__file__).read_text(encoding="utf-8") + _SCRIPT
    try:
        done = subprocess.run(
            [sys.executable, "-I", "-S", "-c", script, json.dumps(list(asked))],
            input=submission.files[submission.entry],
            capture_output=True,
            timeout=_WALL_S,
            preexec_fn=_limit,
            check=True,
        )
        found = json.loads(done.stdout)
    except (subprocess.SubprocessError, ValueError, OSError):
        return SourceReading()
    unwritten = tuple(name for name in asked if name in found["unwritten"])
    if not submission.definitions_only:
        return SourceReading(unwritten)
    places = tuple(submission.place(submission.entry, first) for first, _ in found["left_out"])
    return SourceReading(unwritten, places)


def told(left_out: Sequence[str]) -> str:
    """For the student: what of a notebook was not run, and how to have it run."""
    places = "; ".join(left_out[:_LEFT_OUT_TOLD])
    more = f" and {len(left_out) - _LEFT_OUT_TOLD} more" if len(left_out) > _LEFT_OUT_TOLD else ""
    return (
        f"Your notebook has no marked cells, so its definitions were run and these statements left out: "
        f"{places}{more}. Start a cell with '# %% submit' to have exactly the marked cells run."
    )


def _limit() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY_BYTES, _MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CPU, (_CPU_S, _CPU_S))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
