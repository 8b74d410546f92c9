"""docs/vision.md quotes what KITTI 06 gave: tables, row by row, and that nobody is worse than odometry."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from tests.anchors.reference import read_runs

PAGE = (Path(__file__).parents[2] / "docs" / "vision.md").read_text(encoding="utf-8")


def best_error_m(runs: pd.DataFrame) -> pd.Series:
    """Of a smoother its final answer's, of a filter the online one's; infinite for a run that failed."""
    error = runs["final_ate"].fillna(runs["online_ate"])
    return error.where(runs["status"] == "ok", float("inf"))


def by_default() -> pd.DataFrame:
    """Medians of nine seeds, a row a back end: error from image 0 and 10 on, NEES from 10 on."""
    runs = read_runs("kitti06_defaults")
    runs["error"] = best_error_m(runs)
    assert runs.groupby(["label", "source.start"]).size().eq(9).all()
    errors = runs.groupby(["label", "source.start"], sort=False)["error"].median().unstack()
    nees = runs[runs["source.start"] == 10].groupby("label", sort=False)["online_pose_nees"].median()
    return pd.DataFrame({0: errors[0], 10: errors[10], "nees": nees})


def default_rows() -> list[str]:
    return [
        f"| {label} | {row[0]:.3f} | {row[10]:.3f} | {row['nees']:.2g} |"
        for label, row in by_default().iterrows()
    ]


def shipped_rows() -> list[str]:
    """The two rows of KITTI 06 in the table of all images."""
    runs = read_runs("kitti06").groupby("label")
    online, final, nees = (runs[name].median() for name in ("online_ate", "final_ate", "online_pose_nees"))
    odometry, invariant = f"{online['odometry']:.3f}", "right-invariant EKF"
    return [
        f"| KITTI 06, one camera | 48 m | {odometry} | {online['EKF']:.3f} | {final['iSAM2']:.3f} | "
        f"{final['batch']:.3f} | {nees['EKF']:.2g}, {nees['iSAM2']:.2g} |",
        f"| – {invariant} | | {odometry} | {online[invariant]:.3f} | – | – | {nees[invariant]:.2g}, – |",
    ]


@pytest.mark.parametrize("row", [*default_rows(), *shipped_rows()], ids=lambda row: row.split("|")[1].strip())
def test_a_row_of_kitti_06_is_what_was_measured(row: str) -> None:
    assert row in PAGE


@pytest.mark.parametrize("start", [0, 10])
def test_by_default_nobody_is_worse_than_its_odometry(start: int) -> None:
    medians = by_default()[start]
    assert set(medians[medians > medians["odometry"]].index) == set()


def test_how_much_of_the_odometry_s_error_the_camera_takes_away() -> None:
    """Four tenths by right-invariant EKF and smoothers, three by the plain EKF; aligned all are better."""
    runs = read_runs("kitti06").set_index(["label", "seed"])
    medians = best_error_m(runs).groupby("label").median()
    gained = 1.0 - medians / medians["odometry"]
    tenths = {label: round(10 * share) for label, share in gained.items() if label != "odometry"}
    assert tenths == {"EKF": 3, "right-invariant EKF": 4, "iSAM2": 4, "batch": 4}
    assert "takes four tenths of the median error away" in " ".join(PAGE.split())
    assert "three tenths with the plain EKF" in " ".join(PAGE.split())
    aligned = runs["final_ate_aligned"].fillna(runs["online_ate_aligned"])
    for label in tenths:
        assert (aligned[label] < aligned["odometry"]).all(), label


def test_on_how_many_of_nine_seeds_the_camera_helps() -> None:
    """The sentence below the table: right-invariant EKF and smoothers on eight, the EKF on six."""
    runs = read_runs("kitti06").set_index(["label", "seed"])
    error = best_error_m(runs)
    better = {label: int((error[label] < error["odometry"]).sum()) for label in error.index.unique("label")}
    assert {label: better[label] for label in ("right-invariant EKF", "iSAM2", "batch")} == dict.fromkeys(
        ("right-invariant EKF", "iSAM2", "batch"), 8
    )
    assert better["EKF"] == 6
