"""Victoria Park's raw log: a drive of our own in the archive's format, and the archive itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from slamcmp import geometry as g
from slamcmp.datasets.victoria_park import victoria_park
from slamcmp.datasets.victoria_park_raw import victoria_park_raw
from slamcmp.errors import DataError, MissingDataError
from slamcmp.frontend.associated import associated
from tests.datasets.test_tree_trunks import cast
from tests.recorded_data import recorded

SPEED, STEERING, SECONDS = 2.0, 0.2, 30.0
L, H, AHEAD, LEFT = 2.83, 0.76, 3.78, 0.5
OMEGA = SPEED * np.tan(STEERING) / L


def axle_at(t: float) -> np.ndarray:
    """The rear axle's middle goes round a circle; the world is the laser's first frame."""
    return g.inverse(g.se2(AHEAD, LEFT, 0.0)) @ g.exp(np.array([SPEED * t, 0.0, OMEGA * t]))


def laser_at(t: float) -> np.ndarray:
    return axle_at(t) @ g.se2(AHEAD, LEFT, 0.0)


@pytest.fixture(scope="module")
def trees() -> np.ndarray:
    return np.random.default_rng(8).uniform([-16.0, -10.0], [16.0, 32.0], (14, 2))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, trees: np.ndarray) -> Path:
    """Wheels at 40 Hz, scans at 5 Hz, fixes at 5 Hz with a gap and a jump."""
    path = tmp_path_factory.mktemp("park")
    wheel = SPEED * (1.0 - np.tan(STEERING) * H / L)
    times = np.arange(0.0, SECONDS, 0.025)
    (path / "DRS.txt").write_text("".join(f"{t:.3f}\t {wheel:.9f}\t{STEERING:.9f}\n" for t in times))
    numbers = []
    for t in np.arange(0.0, SECONDS - 0.1, 0.2):
        q = g.transform(g.inverse(laser_at(t)), trees)
        away, bearing = np.hypot(*q.T), np.arctan2(q[:, 1], q[:, 0])
        scan = cast([(float(a), float(b), 0.5) for a, b in zip(away, bearing, strict=True)])
        numbers += [f"{t:.3f}", *(f"{r:.4f}" for r in scan)]
    (path / "LASER.txt").write_text("\t".join(numbers))
    fixes = []
    for t in np.arange(0.1, SECONDS, 0.2):
        if 10.0 < t < 16.0:
            continue
        x, y = laser_at(t)[:2, 2] + (20.0 if abs(t - 20.1) < 0.01 else 0.0)
        fixes.append(f"{t:.3f}\t{y:.6f}\t{x:.6f}\n")
    (path / "GPS.txt").write_text("".join(fixes))
    return path


def test_odometry_is_ackermanns_seen_from_the_laser(folder: Path) -> None:
    log = victoria_park_raw(path=str(folder))
    poses = g.dead_reckoning(np.eye(3), log.T_prev_body)
    for t, T in zip(log.t.tolist(), poses, strict=True):
        np.testing.assert_allclose(T, laser_at(t), rtol=0, atol=1e-6)
    assert np.linalg.eigvalsh(log.Q[1:]).min() > 0
    # The turn's noise moves the laser sideways, since it stands ahead of the axle.
    assert log.Q[5, 1, 2] > 0


def test_trees_are_where_they_stand_and_nobody_names_them(folder: Path, trees: np.ndarray) -> None:
    log = victoria_park_raw(path=str(folder))
    seen = 0
    for t, detections in zip(log.t.tolist(), log.detections, strict=True):
        assert (detections.ids == -1).all()
        places = log.problem.sensor.invert(laser_at(t), detections.z)
        for place in places:
            assert np.linalg.norm(trees - place, axis=1).min() < 0.35
            seen += 1
    assert seen > 3 * log.t.size


def test_the_truth_has_gaps_and_no_jumps(folder: Path) -> None:
    log = victoria_park_raw(path=str(folder))
    known = log.truth.known()
    assert 0.7 < known.mean() < 0.85
    assert not known[(log.t > 10.2) & (log.t < 15.9)].any()
    assert not known[(log.t > 19.95) & (log.t < 20.25)].any()
    for t, T in zip(log.t[known].tolist(), log.truth.T_world_body[known], strict=True):
        np.testing.assert_allclose(T[:2, 2], laser_at(t)[:2, 2], rtol=0, atol=0.01)
        assert abs(g.heading(T @ g.inverse(laser_at(t)))) < 0.05


def test_association_finds_each_tree_once(folder: Path, trees: np.ndarray) -> None:
    log = victoria_park_raw(path=str(folder))
    stream = associated(log, 0, confirm_sightings=4, confirm_frames=8)
    whose: dict[int, set[int]] = {}
    for t, frame in zip(log.t.tolist(), stream.frames, strict=True):
        for landmark, z in zip(frame.ids.tolist(), frame.z, strict=True):
            place = log.problem.sensor.invert(laser_at(t), z)
            whose.setdefault(landmark, set()).add(int(np.linalg.norm(trees - place, axis=1).argmin()))
    assert len(whose) >= 10
    assert all(len(each) == 1 for each in whose.values())
    assert len(set.union(*whose.values())) == len(whose)


def test_what_is_wrong_is_told(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(MissingDataError, match="data info victoria_park"):
        victoria_park_raw(path="nowhere")
    with pytest.raises(MissingDataError, match=r"LASER\.txt"):
        victoria_park_raw(path=str(tmp_path))
    whole = {name: (folder / name).read_text() for name in ("LASER.txt", "DRS.txt", "GPS.txt")}
    lines = whole["DRS.txt"].splitlines()
    scans = whole["LASER.txt"].split()
    for name, text, message in (
        ("LASER.txt", "\t".join(scans[:-1]), r"LASER\.txt: \d+ numbers; a scan has 362"),
        ("LASER.txt", "", r"LASER\.txt: 0 numbers"),
        ("LASER.txt", "\t".join(["x", *scans[1:]]), r"LASER\.txt: could not convert"),
        ("LASER.txt", "\t".join(scans[:362] * 2), r"LASER\.txt: scan 2: its time does not come after"),
        ("LASER.txt", "\t".join(["99.0", *scans[1:362]]), r"LASER\.txt: no scan lies within"),
        ("DRS.txt", "\n".join([*lines[:2], lines[0]]), r"DRS\.txt: row 3: odometry needs"),
        ("DRS.txt", lines[0], r"DRS\.txt: row 1: odometry needs"),
        ("GPS.txt", "1.0 2.0\n", r"GPS\.txt"),
    ):
        for each, content in whole.items():
            (tmp_path / each).write_text(content)
        (tmp_path / name).write_text(text)
        with pytest.raises(DataError, match=message):
            victoria_park_raw(path=str(tmp_path))


def test_the_recorded_drive_is_that_of_the_wheels_file() -> None:
    """The first 200 s: turns and way of iSAM's file at the same scans, trees all along, fixes in eighty."""
    log = victoria_park_raw(path=str(recorded("victoria_park")), seconds=200.0)
    other = victoria_park(steps=900)
    ours, theirs = (g.dead_reckoning(np.eye(3), each.T_prev_body) for each in (log, other))
    rows = np.searchsorted(log.t, other.t[other.t < 200.0] - 0.01)
    # That file's preparation is not known: it turns some tenth less, and its body is not the laser.
    turned, told = np.unwrap(g.heading(ours))[rows], np.unwrap(g.heading(theirs))[: rows.size]
    assert np.corrcoef(turned, told)[0, 1] > 0.995
    assert 1.0 < np.polyfit(told, turned, 1)[0] < 1.2
    driven, length = (
        np.linalg.norm(np.diff(T[:, :2, 2], axis=0), axis=1).sum() for T in (ours, theirs[:877])
    )
    assert 1.0 < driven / length < 1.08
    per_scan = np.array([each.ids.size for each in log.detections])
    assert 4 < per_scan.mean() < 12
    assert 60 < log.truth.known().sum() < 120


@pytest.mark.slow
def test_the_page_has_the_drive_s_numbers() -> None:
    """Scans, trunks a scan and scans with a fix, as docs/real-robots.md says them."""
    log = victoria_park_raw(path=str(recorded("victoria_park")))
    assert log.truth is not None
    page = " ".join((Path(__file__).parents[2] / "docs" / "real-robots.md").read_text().split())
    known = int(log.truth.known().sum())
    assert f"finds trunks in {log.t.size} laser scans" in page
    assert f"({known} scans, a thirteenth of the drive)" in page
    assert round(log.t.size / known) == 13
    assert "a trunk; six a scan)" in page
    assert round(float(np.mean([each.ids.size for each in log.detections]))) == 6
