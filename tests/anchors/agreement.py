"""Does ``slamcmp advise`` say on a cell of the study what the study says? Ten cells, drawn by a stated seed.

``python -m tests.anchors.agreement results/agreement`` runs the advisor's ladder on each cell on seeds that
the study never used, applies its rule, and writes ``results/reference/answer/agreement.csv``: for each back
end that both have its online error over iSAM2's, by the advisor and by the study, and for each cell what the
advisor would take. Its variations and its allotment of time are left out: they do not change what it says of
the cell itself.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from slamcmp.advice.ladder import INCREMENTAL, ladder, rungs
from slamcmp.advice.problem import load_problem
from slamcmp.experiment.runner import run_experiment
from slamcmp.metrics.statistics import Interval, mean_interval, ratio_interval
from slamcmp.results.answers.recommendation import recommend
from slamcmp.results.grid import at_point, swept_columns
from slamcmp.results.store import Results
from tests.anchors.answer import ANSWER, read

PARTS = ("relative_position", "range_bearing")
DRAW = 16
"""The seed that chooses the cells."""
CELLS = 10
SEEDS = tuple(range(1000, 1010))
"""Of the advisor: none of them is the study's."""
FILE = ANSWER / "agreement.csv"
COMMON = ("EKF", "right-invariant EKF", "iterated EKF")
"""Back ends of both, beside iSAM2."""
EXPECTED_NEES = 3.0


def drawn() -> list[tuple[str, dict[str, Any]]]:
    """The ten cells: part of the study and swept values, in the order of the draw."""
    every = []
    for part in PARTS:
        runs = read(part)
        points = runs[swept_columns(runs)].drop_duplicates().to_dict("records")
        every += [(part, {str(path): value for path, value in point.items()}) for point in points]
    chosen = np.random.default_rng(DRAW).choice(len(every), CELLS, replace=False)
    return [every[index] for index in chosen]


def ratios(trials: pd.DataFrame) -> dict[str, Interval]:
    """Online error over iSAM2's on common seeds, geometric mean with its 95 % interval."""
    table = trials[trials["status"] == "ok"].pivot(index="seed", columns="label", values="online_ate")
    return {label: ratio_interval(table[label], table[INCREMENTAL]) for label in COMMON}


def overconfident(trials: pd.DataFrame, label: str) -> bool:
    """Whether the whole 95 % interval of the runs' mean NEES lies above what a consistent one has."""
    own = trials[(trials["label"] == label) & (trials["status"] == "ok")]
    return mean_interval(own["online_pose_nees"]).low > EXPECTED_NEES


def advised(part: str, point: dict[str, Any], folder: Path) -> Results:
    """The advisor's ladder on one cell."""
    settings = [f"{path}={value}" for path, value in point.items()]
    problem = replace(load_problem(f"answer/{part}", settings), seeds=SEEDS)
    name = "-".join([part, *(f"{value:g}" for value in point.values())])
    experiment = replace(ladder(problem, rungs(), time_limit_s=60.0), name=name)
    return run_experiment(experiment, folder=folder / name, jobs=1, progress=False)


def rows(folder: Path) -> pd.DataFrame:
    """A row a cell and common back end."""
    found = []
    for number, (part, point) in enumerate(drawn(), start=1):
        results = advised(part, point, folder)
        advice, here = recommend(results), ratios(results.trials)
        there = ratios(at_point(read(part), point))
        for label in COMMON:
            told = {"advice": here[label], "study": there[label]}
            found.append(
                {
                    "cell": number,
                    "part": part,
                    **point,
                    "verdict": advice.verdict,
                    "take": advice.label or "",
                    "label": label,
                    **{
                        f"{who}_{name}": getattr(each, name)
                        for who, each in told.items()
                        for name in ("estimate", "low", "high", "runs")
                    },
                }
            )
        print(f"{number}: {part} {point}: {advice.verdict}, {advice.label}", file=sys.stderr, flush=True)
    return pd.DataFrame(found)


def main(folder: Path) -> None:
    """Run the ten cells and write the table."""
    table = rows(folder)
    with FILE.open("w", encoding="utf-8", newline="\n") as file:
        seeds = f"{SEEDS[0]} to {SEEDS[-1]}"
        file.write(f"# the advisor on ten cells (draw {DRAW}), seeds {seeds}, and the study\n")
        table.to_csv(file, index=False, float_format="%.5g", lineterminator="\n")
    print(FILE)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
