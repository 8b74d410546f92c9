"""Time stamps in any unit, truth files beside a graph, and what a pairing that finds nothing says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from slamcmp import geometry as g
from slamcmp.datasets.graphs.graph_file import graph_file
from slamcmp.datasets.time_stamps import in_seconds
from slamcmp.datasets.trajectories import read_tum_trajectory
from slamcmp.errors import DataError, MissingDataError

FACTORS = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}


@pytest.mark.parametrize("unit", FACTORS)
@pytest.mark.parametrize("rate_hz", [5, 20, 100])
@pytest.mark.parametrize("start_s", [0, 1_403_715_273])
def test_the_unit_is_told_by_the_stamps(unit: str, rate_hz: int, start_s: int) -> None:
    seconds = start_s + np.arange(40) / rate_hz
    stamps = np.round(seconds * FACTORS[unit], 3)
    told: list[str] = []
    found = in_seconds(Path("truth.txt"), stamps, "auto", parameter="unit_of_mine", told=told)
    np.testing.assert_allclose(found, seconds, rtol=0, atol=1e-3)
    assert len(told) == (unit != "s")
    assert all("truth.txt: time stamps are taken for " in each and "unit_of_mine" in each for each in told)
    np.testing.assert_allclose(
        in_seconds(Path("truth.txt"), stamps, unit, parameter="x"), seconds, rtol=0, atol=1e-3
    )


def test_a_unit_that_cannot_be_told_is_asked_for() -> None:
    # 5000 apart: milliseconds of a slow logger, or microseconds of a fast one.
    with pytest.raises(
        DataError, match=r"truth\.txt: time stamps 5000 apart, .*; set unit_of_mine to s, ms, us"
    ):
        in_seconds(Path("truth.txt"), np.arange(9) * 5e3, "auto", parameter="unit_of_mine")
    t = in_seconds(Path("truth.txt"), np.arange(9) * 5e3, "us", parameter="unit_of_mine")
    np.testing.assert_allclose(t, np.arange(9) * 5e-3)


def test_stamps_out_of_order_are_told(tmp_path: Path) -> None:
    path = tmp_path / "truth.txt"
    path.write_text("".join(f"{t} 0 0 0 0 0 0 1\n" for t in (0, 2, 1, 3, 3)))
    told: list[str] = []
    stamps, _ = read_tum_trajectory(path, told=told)
    assert stamps.tolist() == [0, 1, 2, 3]
    assert told == [
        "truth.txt: time stamps go back at pose 2; poses are taken in order of time",
        "truth.txt: 1 pose(s) have the time stamp of another; of each the first counts",
    ]


# ---- the truth of a graph ----


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """Ten steps of 1 m and 0.1 rad with vertices of the exact path but one, and a landmark at (2, 3)."""
    lines = [f"EDGE_SE2 {k} {k + 1} 1 0 0.1 400 0 0 400 0 10000" for k in range(9)]
    true = g.dead_reckoning(
        np.eye(3), np.concatenate([np.eye(3)[None], np.tile(g.se2(1, 0, 0.1), (9, 1, 1))])
    )
    x, y, theta = g.se2_coordinates(true).T
    lines += [f"VERTEX_SE2 {k} {x[k]} {y[k]} {theta[k]}" for k in range(10)]
    lines += ["EDGE_SE2_XY 0 -7 2 3 100 0 100", "VERTEX_XY -7 2 3", "VERTEX_XY 99 8 8"]
    (tmp_path / "drive.g2o").write_text("\n".join(lines) + "\n")
    rows = [
        f"{k * 10**8} {x[k]} {y[k]} 0.5 0 0 {np.sin(theta[k] / 2)} {np.cos(theta[k] / 2)}" for k in range(8)
    ]
    (tmp_path / "truth.txt").write_text("\n".join(rows) + "\n")
    return tmp_path


def test_vertices_as_truth(drive: Path) -> None:
    assert graph_file(path=str(drive / "drive.g2o")).truth is None
    log = graph_file(path=str(drive / "drive.g2o"), truth="vertices")
    expected = g.dead_reckoning(np.eye(3), log.T_prev_body)
    np.testing.assert_allclose(log.truth.T_world_body, expected, atol=1e-12)
    # Landmarks under the numbers that the log gives them; one that nobody saw is left out.
    assert log.own_ids.tolist() == [-7]
    assert log.truth.ids.tolist() == [0]
    np.testing.assert_array_equal(log.truth.positions, [[2, 3]])


def test_a_file_as_truth_in_any_unit_and_with_an_end(drive: Path) -> None:
    log = graph_file(path=str(drive / "drive.g2o"), time_step_s=0.1, truth=str(drive / "truth.txt"))
    assert log.truth.known().tolist() == [True] * 8 + [False] * 2
    expected = g.dead_reckoning(np.eye(3), log.T_prev_body)
    np.testing.assert_allclose(log.truth.T_world_body[:8], expected[:8], atol=1e-12)
    assert any(
        "truth.txt: time stamps are taken for nanoseconds (truth_time_unit)" in w for w in log.warnings
    )


def test_a_truth_of_another_clock_names_the_parameters(drive: Path) -> None:
    lines = (drive / "truth.txt").read_text().splitlines()
    later = [f"{1.4e9 + k} {line.split(maxsplit=1)[1]}" for k, line in enumerate(lines)]
    (drive / "epoch.txt").write_text("\n".join(later) + "\n")
    with pytest.raises(DataError, match=r"has no pose at any .*truth_max_gap_s \(0\.2 s\).*truth_time_unit"):
        graph_file(path=str(drive / "drive.g2o"), truth=str(drive / "epoch.txt"))
    sparse = {"path": str(drive / "drive.g2o"), "time_step_s": 0.033, "truth": str(drive / "truth.txt")}
    few = graph_file(**sparse, truth_max_gap_s=0.05).truth.known()
    many = graph_file(**sparse).truth.known()
    assert few.tolist() == [True] + [False] * 9
    assert many.all()
    with pytest.raises(MissingDataError, match=r"none\.txt"):
        graph_file(path=str(drive / "drive.g2o"), truth="none.txt")
