"""Run the code of a page, block by block, in a folder of its own: python docs/run_page.py PAGE [FOLDER]

Blocks of ``python`` share one namespace; lines of ``sh`` are bash, with the environment's commands on the
path. A paragraph that is a file's name in backticks writes the block below it to that file. A block of
``text`` below code is what the code prints: words as they stand, numbers to three percent, a line ``...`` for
any number of lines.
Other blocks are for reading only.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
import re
import shlex
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

BLOCK = re.compile(r"(?:^`([\w./-]+)`\n\n)?^(`{3,})(\w+)[^\n]*\n(.*?)^\2$", re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"[−+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
TOLERANCE = 0.03
"""Of a printed number; versions of libraries round differently."""


@dataclass(frozen=True)
class Block:
    """One fenced block."""

    kind: str
    text: str
    line: int
    """Of its first line of code, from 1."""
    file: str | None
    """Where it is written to, instead of being run."""


class PageError(Exception):
    """A block failed, or printed something else; the message says where and what."""


def blocks(text: str) -> list[Block]:
    """The fenced blocks of a page in their order."""
    return [
        Block(found[3], found[4], text[: found.start(4)].count("\n") + 1, found[1])
        for found in BLOCK.finditer(text)
    ]


def run_page(page: Path, folder: Path) -> None:
    """Run what the page shows; files that it writes are left in ``folder``.

    Raises:
        PageError: a block failed, or printed something else than the page says.
    """
    namespace: dict[str, Any] = {"__name__": "__page__"}
    printed = ""
    before = Path.cwd()
    os.chdir(folder)
    os.environ.update(COLUMNS="160", NO_COLOR="1")
    try:
        for block in blocks(page.read_text(encoding="utf-8")):
            where = f"{page.name}:{block.line}"
            if block.file is not None:
                Path(block.file).parent.mkdir(parents=True, exist_ok=True)
                Path(block.file).write_text(block.text, encoding="utf-8")
            elif block.kind == "python":
                printed = _python(block, where, namespace)
            elif block.kind == "sh":
                printed = _shell(block, where)
            elif block.kind == "text" and not same_output(block.text, printed):
                raise PageError(f"{where}: the page says\n{block.text}\nbut printed was\n{printed}")
    finally:
        os.chdir(before)


def same_output(said: str, printed: str) -> bool:
    """Whether a page's block tells what was printed."""
    pieces = [piece.split() for piece in re.split(r"(?m)^\s*\.\.\.\s*$", said)]
    words = printed.split()
    place = 0
    for i, piece in enumerate(pieces):
        last, first = i == len(pieces) - 1, i == 0
        starts = range(place, len(words) - len(piece) + 1)
        if first:
            starts = starts[:1]
        if last:
            starts = starts[-1:] if not first else (starts if len(words) == len(piece) else range(0))
        at = next((s for s in starts if _alike(piece, words[s : s + len(piece)])), None)
        if at is None:
            return False
        place = at + len(piece)
    return True


def _alike(said: list[str], printed: list[str]) -> bool:
    return all(map(_same_word, said, printed))


def _same_word(said: str, printed: str) -> bool:
    if NUMBER.sub("#", said) != NUMBER.sub("#", printed):
        return False
    pairs = zip(NUMBER.findall(said), NUMBER.findall(printed), strict=True)
    return all(_close(*(float(each.replace("−", "-")) for each in pair)) for pair in pairs)


def _close(said: float, printed: float) -> bool:
    # Of what is zero to rounding, the size is not the page's to say.
    return math.isclose(said, printed, rel_tol=TOLERANCE, abs_tol=1e-9)


def _python(block: Block, where: str, namespace: dict[str, Any]) -> str:
    out = io.StringIO()
    try:
        # The lines of a traceback are the page's.
        code = compile("\n" * (block.line - 1) + block.text, where.partition(":")[0], "exec")
        with contextlib.redirect_stdout(out):
            exec(code, namespace)
    except Exception as error:
        raise PageError(f"{where}: {type(error).__name__}: {error}") from error
    return out.getvalue()


def _shell(block: Block, where: str) -> str:
    printed = []
    for line in re.sub(r"\\\n", " ", block.text).splitlines():
        words = shlex.split(line, comments=True)
        if not words:
            continue
        # A new process of the command takes seconds to start.
        own = words[0] == "slamcmp" and not set("|&;<>$*") & set(line.partition(" #")[0])
        code, out = _slamcmp(words) if own else _bash(line)
        if code:
            raise PageError(f"{where}: {line}: exit code {code}\n{out}")
        printed.append(out)
    return "".join(printed)


def _slamcmp(words: list[str]) -> tuple[int, str]:
    from slamcmp.cli import main as command

    out, progress, before = io.StringIO(), io.StringIO(), sys.argv
    sys.argv = words
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(progress):
            command()
        code = 0
    except SystemExit as ended:
        code = int(ended.code or 0)
    finally:
        sys.argv = before
    return code, out.getvalue() + (progress.getvalue() if code else "")


def _bash(line: str) -> tuple[int, str]:
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", line],
        env={**os.environ, "PATH": path},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        stdin=subprocess.DEVNULL,
    )
    return done.returncode, done.stdout


def main() -> None:
    """The command line."""
    if not 2 <= len(sys.argv) <= 3:
        sys.exit(__doc__)
    page = Path(sys.argv[1]).resolve()
    folder = Path(sys.argv[2] if len(sys.argv) == 3 else tempfile.mkdtemp(prefix="page-"))
    folder.mkdir(parents=True, exist_ok=True)
    try:
        run_page(page, folder.resolve())
    except PageError as error:
        sys.exit(str(error))
    print(f"{page.name}: runs; its files are in {folder}")


if __name__ == "__main__":
    main()
