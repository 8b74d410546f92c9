"""The answer of a sweep over two parameters as matrices: what each back end gains at each pair of values."""

from __future__ import annotations

from dataclasses import dataclass

from slamcmp.results.answers.against import Against, by_label, comparisons
from slamcmp.results.answers.phrases import change_text
from slamcmp.results.grid import has_values, swept_columns, value_text
from slamcmp.results.partial import comparable
from slamcmp.results.store import Results
from slamcmp.results.words import parameters_in_words

WIDEST = 8
"""Values that a row may have; more are for the figures."""


@dataclass(frozen=True)
class MatrixCell:
    """One pair of values."""

    text: str
    """``12 % [5, 19] better``; empty where the two have no run in common."""
    verdict: str
    """``better``, ``worse``, ``tie``, ``too few``, or empty."""


@dataclass(frozen=True)
class SweepMatrix:
    """One back end's error against another's, over two swept parameters."""

    title: str
    """``iSAM2 against EKF, online``."""
    down: str
    """The parameter of the rows, in words."""
    across: str
    """The parameter of the columns, in words."""
    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[MatrixCell, ...]], ...]
    """Value and cells."""


def sweep_matrices(results: Results) -> list[SweepMatrix]:
    """A matrix for each back end and each trajectory; none where not two parameters of all were swept."""
    shown = comparable(results)
    trials = shown.trials
    paths = [path for path in swept_columns(trials) if trials[path].map(value_text).nunique() > 1]
    if len(paths) != 2 or any(path.startswith("back_ends.") for path in paths):
        return []
    # The longer one goes down: a page is wider in letters than it seems.
    texts = {path: list(dict.fromkeys(trials[path].map(value_text))) for path in paths}
    across, down = sorted(paths, key=lambda path: len(texts[path]))
    if len(texts[across]) > WIDEST:
        return []
    words = parameters_in_words(paths)
    found = []
    for which, name in (("online", "online"), ("final", "with hindsight")):
        if not has_values(trials, [f"{which}_ate"]):
            continue
        for label, own in by_label(comparisons(shown, which)):
            cells = {(value_text(each.point[down]), value_text(each.point[across])): each for each in own}
            rows = tuple(
                (row, tuple(_cell(cells.get((row, column))) for column in texts[across]))
                for row in texts[down]
            )
            title = f"{label} against {own[0].other}, {name}"
            found.append(SweepMatrix(title, words[down], words[across], tuple(texts[across]), rows))
    return found


def _cell(each: Against | None) -> MatrixCell:
    if each is None:
        return MatrixCell("", "")
    if each.verdict == "too few":
        return MatrixCell("too few runs", "too few")
    return MatrixCell(change_text(each.ratio), each.verdict)
