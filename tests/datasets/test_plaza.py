"""Plaza 1 and 2 against the files themselves, and what a filter without the beacons' places makes of them."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from slamcmp.backends.filters.variants import RightInvariantEkf
from slamcmp.datasets.plaza import plaza
from slamcmp.datasets.wheel import wheel_file
from slamcmp.errors import DataError, MissingDataError
from slamcmp.experiment.job.run_back_end import run_back_end
from slamcmp.frontend.delayed_start import delayed_start
from slamcmp.geometry import dead_reckoning, translation, wrap
from slamcmp.metrics.alignment import align_points
from slamcmp.types import Log

PAGE = " ".join((Path(__file__).parents[2] / "docs" / "real-robots.md").read_text(encoding="utf-8").split())
SIZES = {1: (9657, 3529), 2: (4090, 1816)}
SCALE = 0.935


@functools.cache
def log_of(number: int) -> Log:
    return plaza(number=number, range_scale=SCALE)


@functools.cache
def tables(number: int) -> dict[str, np.ndarray]:
    return loadmat(wheel_file(f"Plaza{number}_.mat"))


@pytest.mark.parametrize("number", [1, 2])
def test_every_range_within_the_odometrys_time_is_there(number: int) -> None:
    log, heard = log_of(number), tables(number)["TD"]
    assert (len(tables(number)["DR"]), len(heard)) == SIZES[number]
    inside = heard[heard[:, 0] >= tables(number)["DR"][0, 0]]
    found = [
        (t, i, z)
        for t, seen in zip(log.t.tolist(), log.detections, strict=True)
        for i, z in zip(seen.ids.tolist(), seen.z[:, 0].tolist(), strict=True)
    ]
    wanted = np.stack([inside[:, 0], inside[:, 2], SCALE * inside[:, 3]], axis=1)
    np.testing.assert_allclose(sorted(found), sorted(map(tuple, wanted.tolist())), rtol=0, atol=1e-9)
    assert log.problem.sensor.name == "range_only"
    assert sorted(log.truth.ids.tolist()) == [0, 1, 5, 6]


def test_odometry_sums_up_to_the_files_own_dead_reckoning() -> None:
    """``DRp`` of the .mat file of Plaza 2; that of Plaza 1 is of another gyro than its turns are."""
    log, summed = log_of(2), tables(2)["DRp"]
    ours = dead_reckoning(np.eye(3), log.T_prev_body)
    at = np.stack([np.interp(log.t, summed[:, 0], summed[:, i]) for i in (1, 2)], axis=1)
    moved = align_points(translation(ours), at).points(translation(ours))
    length = np.linalg.norm(np.diff(at, axis=0), axis=1).sum()
    assert np.linalg.norm(moved - at, axis=1).max() < 0.002 * length


def test_the_turns_of_plaza_1_are_those_of_its_truth_and_that_is_said() -> None:
    path, steps = tables(1)["GT"].astype(float), tables(1)["DR"]
    np.testing.assert_allclose(wrap(np.diff(path[:, 3]) - steps[:, 2]), 0.0, rtol=0, atol=1e-9)
    assert any("turns are those of its truth" in warning for warning in log_of(1).warnings)
    assert not any("turns" in warning for warning in log_of(2).warnings)


@pytest.mark.parametrize("number", [1, 2])
def test_the_truth_looks_where_it_drives(number: int) -> None:
    """In Plaza 2 the file's heading is turned by half a turn from that."""
    path = tables(number)["GT"].astype(float)
    log = log_of(number)
    known = log.truth.known()
    assert known.mean() > 0.99
    T = log.truth.T_world_body[known]
    step = np.diff(translation(T), axis=0)
    moving = np.linalg.norm(step, axis=1) > 0.15
    off = wrap(np.arctan2(step[:, 1], step[:, 0]) - np.arctan2(T[:-1, 1, 0], T[:-1, 0, 0]))
    assert abs(np.median(off[moving])) < 0.1
    assert path[0, 0] <= log.t[0]


@pytest.mark.parametrize("number", [1, 2])
def test_ranges_are_too_long_by_a_share_and_not_by_a_length(number: int) -> None:
    raw = plaza(number=number)
    places = dict(zip(raw.truth.ids.tolist(), raw.truth.positions, strict=True))
    true, heard = [], []
    for T, seen in zip(raw.truth.T_world_body, raw.detections, strict=True):
        for landmark, z in zip(seen.ids.tolist(), seen.z[:, 0], strict=True):
            true.append(np.linalg.norm(places[landmark] - T[:2, 2]))
            heard.append(z)
    known = np.isfinite(true)
    slope, offset = np.polyfit(np.array(true)[known], np.array(heard)[known], 1)
    assert 1.065 < slope < 1.075
    assert abs(offset) < 0.15
    long = np.median(np.array(heard)[known] / np.array(true)[known])
    assert f"they are {100 * (long - 1):.1f} % too long" in PAGE
    assert f"(1/{long:.3f})" in PAGE
    left = np.array(heard)[known] - slope * np.array(true)[known] - offset
    assert 0.5 < left.std() < 0.6


@pytest.mark.parametrize(("number", "path", "beacons"), [(1, 0.5, 0.3), (2, 0.5, 0.3)])
def test_beacons_start_without_truth_and_are_found(number: int, path: float, beacons: float) -> None:
    log = log_of(number)
    stream = delayed_start(log, 0)
    run = run_back_end(RightInvariantEkf, stream, label="EKF", parameters={})
    assert run.status == "ok"
    known = log.truth.known()
    estimated = translation(run.online.T_world_body)[known]
    assert apart(estimated, translation(log.truth.T_world_body)[known]) < path
    order = np.searchsorted(np.sort(log.truth.ids), run.landmarks.ids)
    true = log.truth.positions[np.argsort(log.truth.ids)][order]
    assert len(true) == 4
    assert apart(run.landmarks.positions, true) < beacons


def apart(points: np.ndarray, true: np.ndarray) -> float:
    """Root mean square distance after the best rigid alignment."""
    off = align_points(points, true).points(points) - true
    return float(np.sqrt((off**2).sum(axis=1).mean()))


def test_what_is_missing_or_wrong_is_told(tmp_path: Path) -> None:
    with pytest.raises(MissingDataError, match=r"nowhere/Plaza1_DR\.txt: there is no such file"):
        plaza(path="nowhere")
    for name in ("Plaza1_DR.txt", "Plaza1_TD.txt", "Plaza1_.mat"):
        (tmp_path / name).write_bytes(wheel_file(name).read_bytes())
    assert plaza(path=str(tmp_path)).t.size == plaza().t.size
    savemat(tmp_path / "Plaza1_.mat", {"GT": np.zeros((3, 2))})
    with pytest.raises(DataError, match=r"Plaza1_\.mat: has no table 'GT' of 4 columns; found GT"):
        plaza(path=str(tmp_path))
    whole = wheel_file("Plaza1_.mat").read_bytes()
    for broken in (
        b"",
        b"no such thing",
        b"x" * 4000,
        whole[:100],
        whole[:5000],
        whole[:200] + whole[900:9000],
    ):
        (tmp_path / "Plaza1_.mat").write_bytes(broken)
        with pytest.raises(DataError, match=r"Plaza1_\.mat: (cannot be read as a MATLAB file|has no table)"):
            plaza(path=str(tmp_path))
    lines = wheel_file("Plaza1_DR.txt").read_text().splitlines()
    (tmp_path / "Plaza1_DR.txt").write_text("\n".join([*lines[:3], lines[1], *lines[3:]]))
    with pytest.raises(DataError, match=r"Plaza1_DR\.txt: row 4: its time does not come after"):
        plaza(path=str(tmp_path))
    (tmp_path / "Plaza1_DR.txt").write_text("\n".join(lines[:2]))
    (tmp_path / "Plaza1_TD.txt").write_text("1.0 2 5 7.0\n")
    with pytest.raises(DataError, match=r"Plaza1_TD\.txt: no range lies within"):
        plaza(path=str(tmp_path))
