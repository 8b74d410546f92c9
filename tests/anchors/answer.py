"""``results/reference/answer/``: the runs of the study "Filter or smooth?", and what is read out of them.

``python -m tests.anchors.answer results/answer`` writes the table of every part of the study that has a
results folder there. A page's sentences are derived from these tables by the functions below, in
tests/anchors/test_answer.py.

Independent samples are seeds: a seed's worlds share their random draws over the cells. So what is said of
many cells is the mean of a seed's logarithms of ratios over these cells, and its interval is over the seeds.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from slamcmp.metrics.statistics import Interval, ratio_interval
from slamcmp.results.grid import at_point, milliseconds_per_frame, swept_columns
from slamcmp.results.store import load_results
from tests.anchors.reference import FOLDER

ANSWER = FOLDER / "answer"
SENSORS = ("relative_position", "range_bearing", "stereo")
PARTS = tuple(f"{sensor}{part}" for sensor in SENSORS for part in ("", "_windows", "_outliers"))
COLUMNS = (
    "online_ate",
    "final_ate",
    "online_pose_nees",
    "online_pose_log_score_bits",
    "online_pose_entropy_bits",
)


def write(part: str, folder: Path) -> Path:
    """Write one part's runs to their place, five digits of every number, and where they come from."""
    results = load_results(folder)
    trials = results.trials.assign(ms=milliseconds_per_frame(results.trials, "update_s", "estimate_s"))
    table = trials[["seed", *swept_columns(trials), "label", "status", *COLUMNS, "ms"]]
    ANSWER.mkdir(parents=True, exist_ok=True)
    path = ANSWER / f"{part}.csv"
    commit = results.manifest["commit"]
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(f"# experiments/answer/{part}.yaml at {commit['sha']}\n# ms: of one machine\n")
        table.to_csv(file, index=False, float_format="%.5g", lineterminator="\n")
    return path


def read(part: str) -> pd.DataFrame:
    """The committed runs of one part."""
    return pd.read_csv(ANSWER / f"{part}.csv", comment="#")


def pooled(
    runs: pd.DataFrame,
    label: str,
    base: str,
    column: str = "online_ate",
    base_column: str | None = None,
    at: Mapping[str, Any] | None = None,
) -> Interval:
    """Geometric mean over cells and seeds of one back end's value over another's, with its 95 % interval.

    Cells in which either of the two has a run that failed count with the seeds that both finished; a seed
    counts with the cells that it has.
    """
    keys = ["seed", *swept_columns(runs)]
    rows = at_point(runs, at or {})
    ok = rows[rows["status"] == "ok"]
    ours = ok[ok["label"] == label].set_index(keys)[column]
    theirs = ok[ok["label"] == base].set_index(keys)[base_column or column]
    pairs = pd.concat([ours.rename("ours"), theirs.rename("theirs")], axis=1, join="inner").dropna()
    logs = np.log(pairs["ours"] / pairs["theirs"])
    of_seed = np.exp(logs.groupby(level="seed").mean())
    return ratio_interval(of_seed, np.ones(len(of_seed)))


def failed(runs: pd.DataFrame, label: str) -> tuple[int, int]:
    """How many runs of a back end failed, and of how many."""
    own = runs[runs["label"] == label]
    return int((own["status"] != "ok").sum()), len(own)


def main(results: Path) -> None:
    """Write the tables of every part that has been run."""
    for part in PARTS:
        if (results / part / "manifest.json").is_file():
            print(write(part, results / part))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
