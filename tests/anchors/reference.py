"""``results/reference/``: what shipped experiments gave, written by one command and held by the slow tests.

``python -m tests.anchors.reference results/p1`` writes the summary of that results folder.
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import pytest

from slamcmp.results.store import Results, load_results
from slamcmp.results.verdict import judge

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
    name = "_".join(Path(content["experiment"]).with_suffix("").parts[1:])
    path = FOLDER / f"{name}.json"
    path.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return path


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
        {"label": label, "at": {}, "metric": name, "measured": median, "runs": len(runs)}
        for label, runs in ok.groupby("label", sort=False)
        for name, median in runs[metrics].median().items()
        if median == median
    ]


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
        print(write(load_results(Path(folder))))
