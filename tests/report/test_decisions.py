"""The figure of a front end without labels: what is drawn wrong is what was wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from slamcmp.report.figures.drawable import NotDrawable
from slamcmp.report.figures.frontend.decisions import LEFT_OUT, RIGHT, WRONG, plot_decisions
from slamcmp.results.runs.run_file import StoredTruth, load_truth, save_truth
from slamcmp.results.store import Results
from slamcmp.types import Association, GroundTruth


def results(folder: Path, association: Association | None, truth: GroundTruth | None) -> Results:
    (folder / "streams").mkdir()
    known = StoredTruth("d1", 3, truth, {}, association=association)
    save_truth(known, folder / "streams" / "a.truth.npz")
    nothing = pd.DataFrame()
    return Results(folder, {}, pd.DataFrame({"trial": [0], "digest": ["d1"]}), nothing, nothing)


ASSOCIATION = Association(
    (np.array([0, 1]), np.array([0, 1]), np.array([1, -1, 0])),
    (np.array([7, 8]), np.array([7, 8]), np.array([7, 8, -1])),
    (np.ones((2, 2)), np.ones((2, 2)), np.ones((3, 2))),
)
"""The third frame: a 7 taken for 8, an 8 left out, clutter taken for 7."""
TRUTH = GroundTruth(
    np.arange(3.0), np.tile(np.eye(3), (3, 1, 1)), np.array([0, 1]), np.array([[4.0, 0.0], [0.0, 5.0]])
)


def lines(axes: object, colour: str) -> list[list[list[float]]]:
    found = [line for line in axes.lines if line.get_color() == colour]  # type: ignore[attr-defined]
    return [np.asarray(line.get_xydata()).tolist() for line in found]


def test_each_dot_is_where_it_belongs(tmp_path: Path) -> None:
    figure = plot_decisions(results(tmp_path, ASSOCIATION, TRUTH))
    times, above = figure.axes
    assert lines(times, RIGHT) == [[[0, 0], [0, 1], [1, 0], [1, 1]]]
    assert lines(times, LEFT_OUT) == [[[2, 1]]]
    assert lines(times, WRONG) == [[[2, 0], [2, 1]], [[2, 0]], [[2, 0]]]
    assert lines(above, WRONG) == [[[1, 1], [0, 5]], [[1, 1]], [[1, 1], [4, 0]], [[1, 1]]]
    assert times.get_title() == "trial 0: precision 66.7 %, recall 66.7 %"


def test_without_true_poses_there_is_no_map(tmp_path: Path) -> None:
    assert len(plot_decisions(results(tmp_path, ASSOCIATION, None)).axes) == 1


def test_nothing_to_draw(tmp_path: Path) -> None:
    with pytest.raises(NotDrawable, match="no stream of a front end without labels"):
        plot_decisions(results(tmp_path, None, TRUTH))


def test_decisions_survive_the_file(tmp_path: Path) -> None:
    results(tmp_path, ASSOCIATION, TRUTH)
    known = load_truth(tmp_path / "streams" / "a.truth.npz")
    assert known is not None
    assert known.association is not None
    for name in ("ids", "labels", "points"):
        for one, other in zip(getattr(known.association, name), getattr(ASSOCIATION, name), strict=True):
            assert np.array_equal(one, other)
