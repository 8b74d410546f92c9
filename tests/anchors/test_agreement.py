"""The advisor on ten cells of the study: they are the drawn ones, and it contradicts the study in none."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from slamcmp.results.grid import at_point
from tests.anchors.agreement import CELLS, COMMON, FILE, PARTS, SEEDS, drawn, overconfident, ratios, rows
from tests.anchors.answer import read
from tests.anchors.reference import ROOT

WITHIN = 1.05
"""Of the best: the advisor's rule."""


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return pd.read_csv(FILE, comment="#", keep_default_na=False)


def test_the_cells_are_the_drawn_ones_and_the_study_is_the_committed_one(table: pd.DataFrame) -> None:
    assert len(table) == CELLS * len(COMMON)
    for number, (part, point) in enumerate(drawn(), start=1):
        own = table[table["cell"] == number].set_index("label")
        assert (own["part"] == part).all()
        assert all((own[path] == value).all() for path, value in point.items())
        for label, study in ratios(at_point(read(part), point)).items():
            row = own.loc[label]
            expected = (study.estimate, study.low, study.high)
            assert (row["study_estimate"], row["study_low"], row["study_high"]) == pytest.approx(
                expected, rel=1e-4
            )
    assert all(not set(SEEDS) & set(read(part)["seed"]) for part in PARTS)


def test_no_ratio_and_no_choice_contradicts_the_study(table: pd.DataFrame) -> None:
    apart = table[(table["advice_low"] > table["study_high"]) | (table["study_low"] > table["advice_high"])]
    recommended = table[table["verdict"] == "recommended"]
    for number, (part, point) in enumerate(drawn(), start=1):
        own = recommended[recommended["cell"] == number]
        if own.empty:
            continue
        (taken,) = set(own["take"])
        assert not overconfident(at_point(read(part), point), taken)
        if taken in COMMON:
            assert own[own["label"] == taken]["study_low"].item() <= WITHIN
    text = " ".join((ROOT / "docs" / "advise.md").read_text(encoding="utf-8").split())
    said = (
        f"In {recommended['cell'].nunique()} of the ten it recommends a back end, in the other "
        f"{CELLS - recommended['cell'].nunique()} ten seeds are not enough for it to say"
    )
    assert said in text
    assert f"{len(table) - len(apart)} of {len(table)} ratios" in text
    near = (table.groupby("cell")["study_estimate"].max() <= WITHIN).sum()
    assert near == 9
    assert "nine of the ten cells" in text


@pytest.mark.slow
def test_the_committed_agreement_is_what_the_ladder_gives(table: pd.DataFrame, tmp_path: Path) -> None:
    found = rows(tmp_path)
    assert found["take"].tolist() == table["take"].tolist()
    assert found["advice_estimate"].tolist() == pytest.approx(table["advice_estimate"].tolist(), rel=1e-3)
