"""The committed ensembles: what docs/ensembles.md quotes of them, and that the program still gives them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from slamcmp.ensembles.ensemble import run_ensemble
from slamcmp.ensembles.problem import ensemble_problem
from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.experiment.config.shipped import find_experiment

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "ensembles.md").read_text(encoding="utf-8")
COLUMNS = (
    ("ensemble_heading_rmse_deg", 2),
    ("ensemble_position_rmse", 4),
    ("ensemble_nees_heading", 3),
    ("ensemble_nees_position", 3),
    ("ensemble_nees_pose", 3),
)


def reference(name: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((ROOT / "results" / "reference" / f"ensemble_{name}.json").read_text())
    return found


def row(name: str, each: dict[str, Any]) -> str:
    """A line of the page's table."""
    cells = [f"{each[key]:.{d}f} ± {each[f'{key}_standard_error']:.{d}f}" for key, d in COLUMNS]
    ratio = each.get("position_rmse_ratio")
    told = "" if ratio is None else "{:.4f} [{:.4f}, {:.4f}]".format(*ratio)
    return f"| {name} | {each['label']} | {' | '.join(cells)} | {told} |"


@pytest.mark.parametrize(("name", "seeds"), [("p1", 10000), ("p3", 4000)])
def test_the_page_quotes_the_committed_numbers(name: str, seeds: int) -> None:
    found = reference(name)
    assert found["seeds"] == seeds
    assert f"{seeds // 1000} 000 seeds of {name.upper()}" in PAGE
    for each in found["filters"]:
        assert row(name.upper(), each) in PAGE
        assert each["deviation_from_back_end"] < 1e-9


def test_what_the_page_says_of_p3() -> None:
    """The hundred seeds of the anchor were on the low side, by two and a half standard errors of theirs."""
    hundred = json.loads((ROOT / "results" / "reference" / "anchors_p3.json").read_text())
    (few,) = (
        each
        for each in hundred["values"]
        if (each["label"], each["metric"]) == ("right-invariant EKF", "ensemble_position_rmse")
    )
    (many,) = (each for each in reference("p3")["filters"] if each["label"] == "right-invariant EKF")
    value, error = many["ensemble_position_rmse"], many["ensemble_position_rmse_standard_error"]
    of_hundred = error * (4000 / 100) ** 0.5
    assert f"{few['measured']:.3f} m" in PAGE
    assert f"{value:.3f} ± {error:.3f} m" in PAGE
    assert 2.3 < (value - few["measured"]) / of_hundred < 2.7
    assert abs(few["measured"] / few["published"] - 1) < 0.15 < abs(value / few["published"] - 1)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["p1", "p3"])
def test_the_program_gives_the_committed_numbers(name: str) -> None:
    """All seeds of P3 again, to 1e-6; of P1 a fifth, within five standard errors of a fifth of the runs."""
    found = reference(name)
    problem = ensemble_problem(load_experiment(find_experiment(f"anchors/{name}")))
    runs = run_ensemble(problem, found["seeds"] if name == "p3" else 2000).runs
    for each, kept in zip(runs, found["filters"], strict=True):
        for key, number in each.metrics().items():
            if name == "p3":
                assert number.value == pytest.approx(kept[key], rel=1e-6), (each.label, key)
            else:
                assert abs(number.value - kept[key]) < 5 * number.standard_error, (each.label, key)
