"""``results/reference/``: what shipped experiments gave, written by one command and held by the slow tests.

``python -m tests.anchors.reference results/p1`` writes the summary of that results folder; of an experiment
that pages of ``docs/`` quote also a table of its runs, from which tests derive the quoted numbers anew.
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from slamcmp.results.grid import at_point, grid_points, has_values, swept_columns
from slamcmp.results.judgements.verdict import judge
from slamcmp.results.store import Results, load_results

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "results" / "reference"

UNTIMED = (
    "online_ate",
    "online_heading_rmse_deg",
    "online_pose_nees",
    "final_ate",
    "final_heading_rmse_deg",
    "final_pose_nees",
    "landmark_rmse",
)
"""Medians over the runs, for experiments without published numbers."""

QUOTED = (
    "dial",
    "filter_vs_smoother",
    "observability",
    "association",
    "association_shared",
    "victoria_park",
    "plaza",
    "victoria_park_gps",
    "range_only",
    "bearing_only",
    "kitti06",
    "kitti06_defaults",
)
"""Experiments whose numbers stand in ``docs/``."""
OF_A_RUN = (
    *UNTIMED,
    "online_ate_aligned",
    "final_ate_aligned",
    "landmark_rmse_aligned",
    "nis_per_dof",
    "nullity",
    "spurious_turn_per_rad2",
    "linearisation_drift",
    "kl_from_batch_median",
    "gate_recall",
    "gate_precision",
)
"""Columns of those tables; times are not among them, they belong to the machine."""

SAME = 0.02
"""Relative; the same seeds on another machine differ by what 2500 steps make of the last bits."""


def summary(results: Results) -> dict[str, Any]:
    """What is kept of an experiment's results: where they come from, and every value."""
    manifest = results.manifest
    experiment = Path(manifest["config_file"])
    parts = experiment.parts[experiment.parts.index("experiments") :]
    verdict = judge(results)
    found = {"values": _medians(results)} if verdict is None else verdict.as_dict()
    content = {
        "experiment": Path(*parts).as_posix(),
        "commit": manifest["commit"],
        "seeds": len(manifest["seeds"] or []),
        "finished": manifest["finished"],
        "status": {name: int(count) for name, count in results.trials["status"].value_counts().items()},
        "versions": manifest["versions"],
    } | found
    plain: dict[str, Any] = _plain(content)
    return plain


def write(results: Results) -> Path:
    """Write the summary to its place."""
    content = summary(results)
    path = FOLDER / f"{_name(content['experiment'])}.json"
    path.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return path


def write_runs(results: Results) -> Path:
    """Write the table of the runs to its place, five digits of every number."""
    trials = results.trials
    metrics = [name for name in OF_A_RUN if has_values(trials, [name])]
    table = trials[["seed", *swept_columns(trials), "label", "status", *metrics]]
    path = FOLDER / f"{_name(summary(results)['experiment'])}_runs.csv"
    table.to_csv(path, index=False, float_format="%.5g", lineterminator="\n")
    return path


def read_runs(name: str) -> pd.DataFrame:
    """``results/reference/NAME_runs.csv``: one row a run, as in the trials table."""
    return pd.read_csv(FOLDER / f"{name}_runs.csv")


def read(name: str) -> dict[str, Any]:
    """The content of ``results/reference/NAME.json``."""
    content: dict[str, Any] = json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))
    return content


def assert_reproduces(results: Results, expected: dict[str, Any]) -> None:
    """Every value is that of the committed summary ``expected``."""
    known = {_key(value): value["measured"] for value in expected["values"]}
    found = {_key(value): value["measured"] for value in summary(results)["values"]}
    assert found == pytest.approx(known, rel=SAME)


def _medians(results: Results) -> list[dict[str, Any]]:
    ok = results.trials[results.trials["status"] == "ok"]
    metrics = [name for name in UNTIMED if name in ok.columns]
    return [
        {"label": label, "at": point, "metric": name, "measured": median, "runs": len(runs)}
        for point in grid_points(results.trials)
        for label, runs in at_point(ok, point).groupby("label", sort=False)
        for name, median in runs[metrics].median().items()
        if median == median
    ]


def _name(experiment: str) -> str:
    """``anchors_p1`` of ``experiments/anchors/p1.yaml``."""
    return "_".join(Path(experiment).with_suffix("").parts[1:])


def _key(value: dict[str, Any]) -> tuple[str, str, str]:
    return value["label"], json.dumps(value["at"], sort_keys=True), value["metric"]


def _plain(value: Any) -> Any:
    """For JSON: five digits of every number, null for NaN."""
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if isinstance(value, float):
        return float(f"{value:.5g}") if math.isfinite(value) else None
    return value


if __name__ == "__main__":
    for folder in sys.argv[1:]:
        found = load_results(Path(folder))
        print(path := write(found))
        if path.stem in QUOTED:
            print(write_runs(found))
