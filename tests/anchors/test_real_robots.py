"""docs/real-robots.md quotes what the shipped experiments gave: its tables, row by row."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd
import pytest

from tests.anchors.reference import read_runs

PAGE = (Path(__file__).parents[2] / "docs" / "real-robots.md").read_text(encoding="utf-8")


def cell(value: float) -> str:
    """Empty where there is none."""
    return "" if pd.isna(value) else f"{value:.3f}" if value < 10 else f"{value:.2f}"


def table_row(cells: Sequence[str]) -> str:
    """In Markdown; an empty cell is one blank."""
    return "|" + "|".join(f" {each} " if each else " " for each in cells) + "|"


def plaza_rows() -> list[str]:
    """A row a back end: aligned error online and final, and of the beacons, of both sets."""
    runs = read_runs("plaza")
    columns = ["online_ate_aligned", "final_ate_aligned", "landmark_rmse_aligned"]
    rows = []
    for label, own in runs.groupby("label", sort=False):
        assert own["status"].tolist() == ["ok", "ok"], label
        one, two = (own[own["source.number"] == number][columns].iloc[0] for number in (1, 2))
        cells = [str(label), *map(cell, (*one, *two))]
        rows.append(table_row(cells))
    return rows


@pytest.mark.parametrize("row", plaza_rows(), ids=lambda row: row.split("|")[1].strip())
def test_a_row_of_the_plaza_table_is_what_was_measured(row: str) -> None:
    assert row in PAGE


def gps_rows() -> list[str]:
    """A row a back end: aligned error online and final."""
    runs = read_runs("victoria_park_gps")
    assert set(runs["status"]) == {"ok"}
    digits = [
        (row.label, *("" if pd.isna(each) else f"{each:#.3g}" for each in (row.online, row.final)))
        for row in runs.rename(
            columns={"online_ate_aligned": "online", "final_ate_aligned": "final"}
        ).itertuples()
    ]
    return [table_row(row) for row in digits]


@pytest.mark.parametrize("row", gps_rows(), ids=lambda row: row.split("|")[1].strip())
def test_a_row_of_victoria_park_s_table_is_what_was_measured(row: str) -> None:
    assert row in PAGE


def test_the_innovations_of_victoria_park_are_smaller_than_stated() -> None:
    """NIS/dof of the three filters, the sentence below the table."""
    runs = read_runs("victoria_park_gps").set_index("label")["nis_per_dof"]
    told = {f"{runs[name]:.2f}" for name in ("EKF + RTS", "right-invariant EKF + RTS", "iterated EKF")}
    assert told == {"0.20"}
    assert "(NIS/dof 0.20)" in PAGE


def test_with_hindsight_the_right_invariant_filter_is_with_batch_on_plaza() -> None:
    """Within 5 % of batch in both sets, and so is iSAM2; the sentence below the table."""
    runs = read_runs("plaza").set_index(["label", "source.number"])["final_ate_aligned"]
    for number in (1, 2):
        for label in ("right-invariant EKF + RTS", "iSAM2"):
            assert runs[label, number] == pytest.approx(runs["batch", number], rel=0.05)


def test_hindsight_gains_a_quarter_on_plaza_but_in_the_window() -> None:
    runs = read_runs("plaza").dropna(subset=["final_ate_aligned"])
    gained = 1.0 - runs["final_ate_aligned"] / runs["online_ate_aligned"]
    window = runs["label"] == "sliding window"
    assert gained[~window].min() > 0.25
    assert gained[window].max() < 0.25
