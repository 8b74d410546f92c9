"""What every back end must do, whoever wrote it: ``slamcmp check my_backend.py:MyEkf``."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from slamcmp.errors import UsageError
from slamcmp.experiment.conformance.bench import COMMON, WORLDS, Bench, make_world
from slamcmp.experiment.conformance.rules import CHECKS, ESSENTIAL, CheckFailedError
from slamcmp.protocols import BackEnd
from slamcmp.registry import Plugin, back_ends
from slamcmp.types import GroundTruth, Problem


@dataclass(frozen=True)
class Finding:
    """One property and whether the back end has it."""

    check: str
    passed: bool
    message: str


def check_back_end(back_end: str | Plugin, parameters: Mapping[str, Any] | None = None) -> list[Finding]:
    """Run every check on a registered back end, a user's ``file.py:Class``, or a plug-in itself.

    A check that cannot run because an earlier one failed is left out.

    Raises:
        UsageError: there is no such back end.
    """
    plugin = back_ends.get(back_end) if isinstance(back_end, str) else back_end
    chosen = dict(parameters or {})
    bench, finding = _open(plugin, chosen)
    findings = [finding]
    if bench is None:
        return findings
    for check in CHECKS:
        finding_of_check = _try(check, bench)
        if finding_of_check is None:
            continue
        findings.append(finding_of_check)
        if check in ESSENTIAL and not finding_of_check.passed:
            break
    return findings


def _try(check: Callable[[Bench], str | None], bench: Bench) -> Finding | None:
    title = (check.__doc__ or "").split("\n")[0].rstrip(".")
    try:
        # What overflows in a faulty filter is the check's finding, not the terminal's.
        with np.errstate(all="ignore"):
            message = check(bench)
    except CheckFailedError as error:
        return Finding(title, False, str(error))
    except Exception as error:
        return Finding(title, False, _describe(error))
    return None if message is None else Finding(title, True, message)


def _open(plugin: Plugin, parameters: Mapping[str, Any]) -> tuple[Bench | None, Finding]:
    title = "is constructed as Name(problem, **parameters)"
    refusals = []
    for kind, settings in WORLDS:
        merged = {**COMMON, **settings}
        stream, truth = make_world(merged, seed=0)

        def make(problem: Problem, truth: GroundTruth) -> BackEnd:
            told = (truth,) if plugin.traits.get("needs_truth") else ()
            made: BackEnd = plugin.target(problem, *told, **parameters)
            return made

        try:
            back_end = make(stream.problem, truth)
            missing = [method for method in ("update", "estimate") if not hasattr(back_end, method)]
            if missing:
                return None, Finding(title, False, f"has no method {' and no '.join(missing)}")
            back_end.update(stream.frames[0])
            back_end.update(stream.frames[1])
        except UsageError as error:
            refusals.append(str(error))
            continue
        except Exception as error:
            return None, Finding(title, False, _describe(error))
        closes_loops = bool(plugin.traits.get("closes_loops", True))
        bench = Bench(make, kind, merged, stream, truth, closes_loops)
        return bench, Finding(title, True, f"on a {kind} problem")
    return None, Finding(title, False, "accepts no kind of problem: " + "; ".join(refusals))


def _describe(error: Exception) -> str:
    places = traceback.extract_tb(error.__traceback__)
    # A library's own line tells less than the one that called it.
    place = next((each for each in reversed(places) if "site-packages" not in each.filename), places[-1])
    text = f"{type(error).__name__}: {error} ({place.filename}, line {place.lineno})"
    if isinstance(error, np.linalg.LinAlgError):
        text += "; look for the inverse of a singular S: H P H^T + R is not, where R is in it"
    if "read-only" in str(error):
        text += "; frames are shared by all back ends and may not be changed: copy an array before writing"
    return text
