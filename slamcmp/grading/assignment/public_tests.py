"""An assignment's public tests, run on a student's own file on the student's own machine."""

from __future__ import annotations

import importlib
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from slamcmp.errors import MissingDataError, UsageError
from slamcmp.experiment.conformance.check import Finding
from slamcmp.grading.assignment.handout import imported_modules

PUBLIC = "public_tests.py"


def run_public_tests(entry: Path) -> list[Finding]:
    """Run every test of the ``public_tests.py`` that lies beside a student's file.

    The file runs in this process, without a sandbox: it is the student's machine.

    Raises:
        MissingDataError: one of the two files is missing.
        UsageError: the tests are of a file with another name.
    """
    tests = entry.resolve().parent / PUBLIC
    if not entry.is_file():
        raise MissingDataError(f"{entry}: there is no such file")
    if not tests.is_file():
        raise MissingDataError(
            f"{entry}: there is no {PUBLIC} beside it; copy the assignment's there, or name the class of a "
            f"back end, {entry}:NAME"
        )
    source = tests.read_text(encoding="utf-8")
    wanted = imported_modules(source) - {"numpy", "slamcmp"}
    if entry.stem not in wanted:
        # They would test that file, and this one would get the praise.
        what = " or ".join(f"{name}.py" for name in sorted(wanted))
        raise UsageError(f"{entry}: the tests beside it are of {what}; give your file this name")
    with _import_path(tests.parent, entry.stem):
        names: dict[str, object] = {"__name__": "public_tests"}
        title = f"{entry.name} is imported, with all that is asked for"
        try:
            importlib.import_module(entry.stem)
            exec(compile(source, str(tests), "exec"), names)
        except Exception as error:
            return [Finding(title, False, _describe(error, tests))]
        findings = [Finding(title, True, str(entry))]
        for name, test in names.items():
            if name.startswith("test_") and callable(test):
                findings.append(_run(name.removeprefix("test_"), test, tests))
    return findings


def _run(title: str, test: Callable[[], object], tests: Path) -> Finding:
    try:
        test()
    except NotImplementedError:
        return Finding(title, False, "not implemented yet")
    except Exception as error:
        return Finding(title, False, _describe(error, tests))
    return Finding(title, True, "as worked out by hand")


def _describe(error: Exception, tests: Path) -> str:
    stack = traceback.extract_tb(error.__traceback__)
    line = next((frame.lineno for frame in stack if frame.filename == str(tests)), None)
    where = f" ({PUBLIC}, line {line})" if line is not None else ""
    lines = [line.rstrip() for line in str(error).splitlines() if line.strip()]
    return f"{type(error).__name__}{where}: " + "\n".join(lines)


@contextmanager
def _import_path(folder: Path, module: str) -> Iterator[None]:
    """Let ``import`` find the student's file, as it is now and before any other of its name."""
    sys.path.insert(0, str(folder))
    before = sys.modules.pop(module, None)
    try:
        yield
    finally:
        sys.path.remove(str(folder))
        sys.modules.pop(module, None)
        if before is not None:
            sys.modules[module] = before
