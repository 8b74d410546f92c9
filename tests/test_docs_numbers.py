"""Every number that a page of the documentation quotes is derived anew from ``results/reference/``.

A page is taken apart: what is measured must stand there as computed here, what is a setting or a definition
is listed as such, and no other number may be left. A difference that a page speaks of must be one.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from slamcmp.metrics.statistics import ratio_interval
from slamcmp.results.numbers import interval_text, number_text
from tests.anchors.reference import read
from tests.quoted import Quoted

DOCS = Path(__file__).resolve().parents[1] / "docs"
ATE, NEES = "online_ate", "online_pose_nees"


def from_filter_to_smoother() -> Iterator[str]:
    dial = Quoted("dial")
    for name, label in (
        ("EKF", "EKF"),
        ("the same pose, iterated", "iterated EKF"),
        ("10 poses, iterated", "latest 10"),
        ("50 poses, iterated", "latest 50"),
        ("full smoothing", "full smoothing"),
        ("right-invariant EKF", "right-invariant EKF"),
    ):
        if label == "EKF":
            cells = ["", ""]
        else:
            ratios = [dial.times(label, "EKF", column, differs=True) for column in (ATE, NEES)]
            cells = [ratio.replace(" times", "") for ratio in ratios]
        row = [name, f"{dial.median(label, ATE)} m", dial.median(label, NEES), *cells]
        yield f"| {' | '.join(row)} |".replace("  ", " ")
    iterated = dial.times("iterated EKF", "EKF", ATE, differs=True)
    yield f"has {iterated.split(' (')[0]} the EKF's error"
    for label, other, column, differs, text in (
        ("latest 10", "iterated EKF", ATE, False, "not told apart from it in error: {}"),
        ("latest 10", "iterated EKF", NEES, True, "Ten poses have {} the NEES of the iterated filter"),
        ("latest 10", "full smoothing", NEES, False, "ten poses have {} its NEES"),
        ("fej 2", "latest 2", ATE, False, "with two poses {} the error"),
        ("fej 2", "latest 2", NEES, False, "and {} the NEES of the same window without"),
        ("right-invariant EKF", "full smoothing", ATE, False, "has {} full smoothing's online error"),
        ("right-invariant EKF", "full smoothing", NEES, False, "and {} its NEES. The ideal filter"),
        ("ideal EKF", "right-invariant EKF", ATE, False, "(Jacobians at the truth) has {} its error"),
        ("ideal EKF", "right-invariant EKF", NEES, True, "and {} its NEES. What it lacks"),
    ):
        yield text.format(dial.times(label, other, column, differs=differs))
    for window in (1, 2, 5, 10, 20, 50):
        for column in (ATE, NEES):
            dial.times(f"fej {window}", f"latest {window}", column, differs=False)
    hindsight = dial.times("full smoothing", "full smoothing", "final_ate", ATE, differs=True)
    yield f"takes full smoothing's error to {hindsight} of its own online error"


def consistency() -> Iterator[str]:
    low, high = (Quoted("filter_vs_smoother", {"source.noise_scale": scale}) for scale in (0.5, 4.0))
    yield f"has {low.times('EKF', 'iSAM2', ATE, differs=False)} iSAM2's error"
    yield f"and {low.times('EKF', 'iSAM2', NEES, differs=False)} its NEES"
    nees, beside = high.median("EKF", NEES), high.median("iSAM2", NEES)
    yield f"({nees} at four times the noise, where iSAM2 stays at {beside})"
    yield f"{high.times('EKF', 'iSAM2', NEES, differs=True)} iSAM2's NEES"
    yield f"and {high.times('EKF', 'iSAM2', ATE, differs=True)} its error"
    assert high.median("EKF", "nis_per_dof") == low.median("EKF", "nis_per_dof") == "1.01"
    yield "NIS per degree of freedom is 1.01"

    seen = Quoted("observability")
    three = ("ideal EKF", "FEJ EKF", "OC EKF", "right-invariant EKF", "robocentric EKF")
    nullity = dict.fromkeys((*three, "window 10 FEJ", "batch"), 3)
    nullity |= dict.fromkeys(("EKF", "iterated EKF", "UKF", "window 10"), 2) | {"EKF body error": 0}
    turn, drift, kl = "spurious_turn_per_rad2", "linearisation_drift", "kl_from_batch_median"
    for label, directions in nullity.items():
        assert (seen.of(label, "nullity") == directions).all(), label
        assert directions < 3 or (seen.of(label, turn) < 1e-21).all(), label
    for label, text in (("EKF", "a compass of {}° that"), ("window 10", "in one of {}°")):
        yield text.format(number_text(math.degrees(seen.of(label, turn).median() ** -0.5)))
    yield f"({seen.times('window 10', 'EKF', turn, differs=True)} the EKF's information"
    yield "(below 1e-21 rad⁻²)"
    yield f"which lie {seen.median('FEJ EKF', drift)} m"
    yield f"keeps them at {seen.median('right-invariant EKF', drift)} m"
    yield f"(FEJ: {seen.times('FEJ EKF', 'right-invariant EKF', drift, differs=True)} as"
    for name, label, differs in (
        ("window of ten poses", "window 10", True),
        ("right-invariant EKF", "right-invariant EKF", True),
        ("iterated EKF", "iterated EKF", False),
        ("FEJ-EKF", "FEJ EKF", True),
    ):
        ratio = seen.times(label, "EKF", kl, differs=differs).replace(" times", "")
        yield f"| {name} | {seen.median(label, kl)} nat | {ratio} |"
    yield f"| EKF | {seen.median('EKF', kl)} nat |"
    yield f"({seen.times('window 10', 'right-invariant EKF', kl, differs=False)})"

    published = {(value["label"], value["metric"]): value for value in read("anchors_p1")["values"]}
    for label in ("EKF", "right-invariant EKF"):
        cells = []
        for metric, unit, digits in (
            ("ensemble_heading_rmse_deg", "°", 2),
            ("ensemble_position_rmse", " m", 3),
            ("ensemble_nees_heading", "", 2),
            ("ensemble_nees_position", "", 2),
        ):
            value = published[label, metric]
            assert value["verdict"] == "inside"
            assert value["measured"] < value["published"]
            assert value["tolerance"] == (0.25 if "nees" in metric else 0.15)
            cells.append(f"{value['measured']:.{digits}f}{unit} ({value['published']:g})")
        yield f"| {label} | {' | '.join(cells)} |"
    yield f"over {read('anchors_p1')['seeds']} runs"


def association() -> Iterator[str]:
    share = "source.outlier_fraction"
    none, some, many = (Quoted("association", {share: outliers}) for outliers in (0.0, 0.05, 0.1))
    shared = Quoted("association_shared", {share: 0.05})
    recall = "gate_recall"

    def passed(runs: Quoted, label: str) -> str:
        return f"{100 * runs.of(label, recall).median():.1f} %"

    for name, label, differs in (
        ("EKF", "EKF", ()),
        ("FEJ-EKF", "FEJ-EKF", (False, False)),
        ("ideal EKF (Jacobians at the truth)", "ideal EKF", (True, True)),
        ("right-invariant EKF", "right-invariant EKF", (True, True)),
        ("iSAM2", "iSAM2", (True, True)),
    ):
        row = [name, passed(none, label), none.median(label, NEES), f"{none.median(label, ATE)} m"]
        for column, different in zip((NEES, ATE), differs, strict=False):
            row.append(none.times(label, "EKF", column, differs=different).replace(" times", ""))
        yield f"| {' | '.join(row)} |"
    yield f"The EKF's keeps {passed(none, 'EKF')} of the correct"
    yield f"iSAM2's keeps {passed(none, 'iSAM2')}"
    labels = ("EKF", "FEJ-EKF", "right-invariant EKF", "ideal EKF", "iSAM2")
    ranks = []
    for runs in (none, some, many):
        both = pd.concat([pd.concat([runs.of(x, recall), runs.of(x, NEES)], axis=1) for x in labels])
        ranks.append(f"{both.corr('spearman').iloc[0, 1]:.2f}".replace("-", "−"))
    yield f"correlation {ranks[0]}; {ranks[1]} and {ranks[2]} with 5 and 10 % outliers"
    assert none.median("EKF", "nis_per_dof") == "1.02"
    yield "it is 1.02 for the EKF"
    lost = {label: none.of(label, recall)[none.of(label, recall) < 0.8] for label in labels}
    worse = (none.of("ideal EKF", recall) < none.of("EKF", recall)).sum()
    assert lost["EKF"].size == lost["ideal EKF"].size
    assert not lost["iSAM2"].size
    yield f"is lost in {lost['ideal EKF'].size} of 20 runs (below 80 %), as the EKF is"
    yield f"rejects more than it in {worse}."
    yield f"The right-invariant filter is lost in {lost['right-invariant EKF'].size},"
    yield f"filter is {none.times('ideal EKF', 'right-invariant EKF', NEES, differs=True)} that"
    yield f"and that {none.times('right-invariant EKF', 'iSAM2', NEES, differs=True)} iSAM2's"
    yield f"lost run keeps {100 * lost['right-invariant EKF'].median():.0f} % in all"
    assert all(some.of(label, recall).median() < none.of(label, recall).median() - 0.05 for label in labels)
    for label, text in (
        ("EKF", "{} pass the EKF's"),
        ("right-invariant EKF", "{} the"),
        ("iSAM2", "{} iSAM2's."),
    ):
        yield text.format(passed(some, label))
    for name, label, which, differs in (
        ("EKF", "EKF", "online", (True, False)),
        ("right-invariant EKF", "right-invariant EKF", "online", (False, False)),
        ("iSAM2, online", "iSAM2", "online", (True, False)),
        ("iSAM2, final", "iSAM2", "final", (True, True)),
    ):
        columns = (f"{which}_pose_nees", f"{which}_ate")
        row = [name]
        for runs in (some, shared):
            row.append(f"{runs.median(label, columns[0])}, {runs.median(label, columns[1])} m")
        for column, different in zip(columns, differs, strict=True):
            ratio = ratio_interval(*aligned(some.of(label, column), shared.of(label, column)))
            assert (not ratio.low <= 1.0 <= ratio.high) == different, (name, ratio)
            row.append(f"{number_text(ratio.estimate)} ({interval_text(ratio)})")
        yield f"| {' | '.join(row)} |"


def aligned(first: pd.Series[float], other: pd.Series[float]) -> tuple[Any, Any]:
    """The values of the seeds that both have."""
    both = pd.concat([first, other], axis=1).dropna().to_numpy(float)
    return both[:, 0], both[:, 1]


MEASURED = {
    "association.md": association,
    "consistency.md": consistency,
    "from-filter-to-smoother.md": from_filter_to_smoother,
}
STATED = {
    "association.md": (
        "20 paired seeds, three shares of outliers",
        "A circle of 38 m radius",
        "Medians over 20 runs",
        "with the 95 % interval",
        "pose NEES (3)",
        "where 99.9 % were asked for",
        "With 5 % outliers another 5 % or more are lost",
        "| 5 % outliers |",
    ),
    "consistency.md": (
        "(3 in the plane, 6 in space)",
        "20 paired seeds at four noise levels",
        "6 paired seeds",
        "with the 95 % interval",
        "Where that holds 1,",
        "leaves 3",
        "(15 % on errors, 25 % on NEES)",
    ),
    "from-filter-to-smoother.md": (
        "12 paired seeds",
        "with the 95 % interval",
        "where that holds 1,",
        "NEES (3 expected)",
        "keeps up to 50 poses",
        # Times belong to a machine.
        "from 0.04 ms a frame (EKF; 0.08 ms right-invariant) to 3 ms",
    ),
}


def plain(page: str) -> str:
    """The page's text on one line, without code, images and the addresses of links."""
    text = (DOCS / page).read_text(encoding="utf-8")
    text = re.sub(r"(?m)^    .*$", "", text)
    text = re.sub(r"(?s)```[a-z]*\n(.*?)```", lambda code: " ".join(re.findall(r"#.*", code[1])), text)
    text = re.sub(r"!\[.*?\]\(.*?\)", "", text)
    text = re.sub(r"\]\(.*?\)", "]", text)
    return " ".join(text.replace("**", "").replace("*", "").split())


@pytest.mark.parametrize("page", MEASURED)
def test_every_number_is_derived_or_a_setting(page: str) -> None:
    text = plain(page)
    missing = []
    for quote in sorted([*MEASURED[page](), *STATED[page]], key=len, reverse=True):
        if quote not in text:
            missing.append(quote)
        text = text.replace(quote, " … ")
    assert not missing
    # Names that hold a digit are no numbers; list marks and headings neither.
    left = re.sub(r"\b[A-Za-z_]\w*\d\w*|`[^`]*`", "", text)
    assert not re.findall(r".{0,40}\d.{0,40}", left)


def test_what_the_readme_says_of_its_real_log() -> None:
    """The filter's NIS, and a map metres away from the batch solution's."""
    page = " ".join((DOCS.parent / "README.md").read_text(encoding="utf-8").split())
    park = Quoted("victoria_park")
    nis = float(park.of("EKF", "nis_per_dof").item())
    assert f"(NIS per degree of freedom {nis:.2f}), and yet its map is metres away" in page
    assert float(park.of("EKF", "landmark_rmse").item()) > 2.0
    assert float(park.of("iSAM2", "landmark_rmse").item()) < 0.1
