"""The matrices of a sweep over two parameters: every cell is the paired ratio at its pair of values."""

from __future__ import annotations

import numpy as np
import pytest

from slamcmp.metrics.statistics import ratio_interval
from slamcmp.results.answers.phrases import change_text
from slamcmp.results.answers.sweep_matrix import sweep_matrices
from tests.results.hand_made import NOISE, WORLD, results_of, runs

SCALE, STEPS = "source.noise_scale", "source.range_sigma_m"
GAIN = {(0.5, 1.0): 1.0, (0.5, 2.0): 0.8, (4.0, 1.0): 1.25, (4.0, 2.0): 0.5, (9.0, 1.0): 1.0, (9.0, 2.0): 0.9}
"""Error of B over that of A at each pair of values."""


def swept(gain=GAIN, seeds=12, **more):
    rows = []
    for number, ((scale, sigma), ratio) in enumerate(gain.items()):
        at = {SCALE: scale, STEPS: sigma, **more}
        a = WORLD[:seeds] * NOISE[0, :seeds]
        b = ratio * WORLD[:seeds] * NOISE[1, :seeds]
        for label, errors in (("A", a), ("B", b)):
            each = runs(label, list(errors), **at)
            rows += [{**row, "trial": 100 * number + row["seed"]} for row in each]
    return results_of(rows)


def test_every_cell_is_the_paired_ratio_at_its_values():
    online, final = sweep_matrices(swept())
    assert (online.title, final.title) == ("B against A, online", "B against A, with hindsight")
    # The longer parameter goes down the page, and both are in words, with their unit.
    assert (online.down, online.across) == ("noise scale", "range sigma [m]")
    assert online.columns == ("1", "2")
    assert [value for value, _ in online.rows] == ["0.5", "4", "9"]
    for value, cells in online.rows:
        for column, cell in zip(online.columns, cells, strict=True):
            ratio = GAIN[float(value), float(column)]
            expected = ratio_interval(ratio * WORLD * NOISE[1], WORLD * NOISE[0])
            assert cell.text == change_text(expected)
            wanted = "tie" if ratio == 1.0 else "better" if ratio < 1.0 else "worse"
            assert cell.verdict == wanted


def test_too_few_runs_and_missing_points_are_said_so():
    (online, _) = sweep_matrices(swept(seeds=3))
    assert {(cell.text, cell.verdict) for _, cells in online.rows for cell in cells} == {
        ("too few runs", "too few")
    }
    part = {point: ratio for point, ratio in GAIN.items() if point != (4.0, 2.0)}
    (online, _) = sweep_matrices(swept(part))
    assert online.rows[1][1][1].text == ""
    assert online.rows[1][1][0].verdict == "worse"


@pytest.mark.parametrize("columns", [1, 3])
def test_one_or_three_parameters_have_no_matrix(columns):
    if columns == 1:
        results = swept({point: ratio for point, ratio in GAIN.items() if point[1] == 1.0})
    else:
        results = swept()
        results.trials["source.steps"] = np.where(results.trials["trial"] % 2, 10, 20)
    assert sweep_matrices(results) == []


def test_a_parameter_of_one_back_end_alone_has_none_and_neither_has_a_very_wide_sweep():
    results = swept()
    renamed = results.trials.rename(columns={SCALE: "back_ends.B.window"})
    assert sweep_matrices(type(results)(results.folder, {}, renamed, results.frames, results.landmarks)) == []
    wide = {(float(a), float(b)): 1.0 for a in range(1, 10) for b in range(1, 10)}
    assert sweep_matrices(swept(wide, seeds=1)) == []
