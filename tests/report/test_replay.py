"""A trial as a recording for Rerun: what is in the file, read back by Rerun's own program."""

from __future__ import annotations

import builtins
import collections
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

import slamcmp
import slamcmp.geometry
import slamcmp.results.runs.run_file
from slamcmp.report.replay import CHI2_95, _ellipse, _Replay, write_replay
from tests.command import Command

WORLD = {"name": "circle", "landmarks": 8, "steps": 30}


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    experiment = {
        "source": WORLD,
        "back_ends": [{"name": "ekf_slam", "label": "E K/F"}, {"name": "isam2"}],
        "seeds": 2,
    }
    folder = tmp_path_factory.mktemp("replay") / "driven"
    return slamcmp.run(experiment, folder=folder, executor="serial", progress=False)


def rows_by_entity(file: Path) -> dict[str, int]:
    """Rows of each entity, as Rerun reads the file."""
    done = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "print", str(file)], capture_output=True, text=True, check=True
    )
    text = re.sub(r"\x1b\[[0-9;]*m", "", done.stdout)
    rows: collections.Counter[str] = collections.Counter()
    for count, entity in re.findall(r"with (\d+) rows \([^)]*\) - (.+?) - ", text):
        rows[entity.replace("\\", "")] += int(count)
    return dict(rows)


def test_the_file_has_every_frame_of_every_back_end(driven, tmp_path):
    pytest.importorskip("rerun", reason="the extra [view] is not installed")
    shown = write_replay(driven, tmp_path / "a" / "t.rrd", trial=1)
    assert shown == ["E K/F", "isam2"]
    rows = rows_by_entity(tmp_path / "a" / "t.rrd")
    for label in shown:
        for moving in ("now", "ellipse", "measured"):
            assert rows[f"/world/{label}/{moving}"] == WORLD["steps"], (label, moving)
        for fixed in ("online", "landmarks", "landmark ellipses"):
            assert rows[f"/world/{label}/{fixed}"] == 1
        assert rows[f"/plots/error [m]/{label}"] >= WORLD["steps"] - 1
    assert rows["/world/isam2/final"] == 1
    assert "/world/E K/F/final" not in rows
    assert rows["/world/truth/now"] == WORLD["steps"]
    assert {"/world/truth/path", "/world/truth/landmarks", "/about"} <= rows.keys()
    one = tmp_path / "one.rrd"
    assert write_replay(driven, one, back_ends=["isam2"]) == ["isam2"]
    assert not [name for name in rows_by_entity(one) if "E K" in name]


def test_images_come_with_features_and_matches(tmp_path):
    pytest.importorskip("rerun", reason="the extra [view] is not installed")
    experiment = {
        "source": {"name": "rendered", "building": "room", "camera": "stereo", "steps": 4},
        "front_end": {"name": "tracked_features"},
        "back_ends": ["dead_reckoning"],
    }
    results = slamcmp.run(experiment, folder=tmp_path / "room", executor="serial", progress=False)
    write_replay(results, tmp_path / "room.rrd")
    rows = rows_by_entity(tmp_path / "room.rrd")
    assert rows["/camera"] == rows["/camera/features"] == rows["/camera/matches"] == 4
    assert rows["/world/dead_reckoning/now"] == 4


def test_the_ellipse_holds_95_percent():
    P = np.array([[4.0, 1.0], [1.0, 2.0]])
    ring = _ellipse(np.array([1.0, -2.0, 0.0]), P)[:, :2] - [1.0, -2.0]
    squared = np.einsum("ki,ij,kj->k", ring, np.linalg.inv(P), ring)
    assert squared == pytest.approx(chi2.ppf(0.95, 2))
    assert pytest.approx({n: chi2.ppf(0.95, n) for n in (2, 3)}) == CHI2_95
    assert ring[0] == pytest.approx(ring[-1])


def test_rays_end_where_the_sensor_says(driven):
    trial = 0
    replay = _Replay(None, None, driven, trial)
    stream = slamcmp.make_stream("circle", int(driven.trials["seed"].min()), landmarks=8, steps=30)
    heading = 0.3
    rays = replay._rays(5, np.array([1.0, 2.0, 0.0]), heading)
    expected = stream.problem.sensor.invert(slamcmp.geometry.se2(1.0, 2.0, heading), stream.frames[5].z)
    assert np.array(rays)[:, 1, :2] == pytest.approx(expected)
    assert np.array(rays)[:, 0] == pytest.approx(np.tile([1.0, 2.0, 0.0], (len(expected), 1)))


class TestTheCommand:
    """``slamcmp view``."""

    @pytest.fixture
    def call(self, driven, monkeypatch, capsys) -> Command:
        return Command(driven.folder.parent, monkeypatch, capsys)

    def test_a_folder_or_a_runs_file(self, call, driven, tmp_path, monkeypatch):
        pytest.importorskip("rerun", reason="the extra [view] is not installed")
        monkeypatch.setattr(sys, "platform", "linux")
        monkeypatch.delenv("DISPLAY", raising=False)
        monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
        code, out, said = call("view", str(driven.folder), "--trial", "1")
        assert (code, out) == (0, f"{driven.folder / 'view' / 'trial-1.rrd'}: E K/F, isam2\n")
        assert "there is no screen here; elsewhere: rerun " in said
        run = next(
            path
            for path in (driven.folder / "runs").glob("*.npz")
            if slamcmp.results.runs.run_file.load_run(path).run.back_end == "isam2"
        )
        code, out, said = call("view", str(run), "--output", str(tmp_path / "x.rrd"), "--no-open")
        assert (code, out, said) == (0, f"{tmp_path / 'x.rrd'}: isam2\n", "")

    def test_what_is_not_there_is_said_in_one_line(self, call, driven):
        pytest.importorskip("rerun", reason="the extra [view] is not installed")
        for arguments, status, text in (
            (("nowhere",), 3, "nowhere: no results here"),
            ((str(driven.folder), "--trial", "7"), 2, "has no trial 7: they are 0 to 1"),
            ((str(driven.folder), "--back-end", "ekf"), 2, "has no back end 'ekf': E K/F, isam2"),
            (("no.npz",), 3, "no.npz: no run that can be read"),
        ):
            code, out, said = call("view", *arguments)
            assert (code, out) == (status, "")
            assert text in said
            assert said.count("\n") == 1

    def test_without_rerun_it_says_what_to_install(self, call, driven, monkeypatch):
        imported = builtins.__import__

        def without(name, *more, **options):
            if name == "rerun":
                raise ImportError(name)
            return imported(name, *more, **options)

        monkeypatch.setattr(builtins, "__import__", without)
        monkeypatch.delitem(sys.modules, "rerun", raising=False)
        code, _, said = call("view", str(driven.folder))
        assert code == 3
        assert said == "slamcmp: slamcmp view needs Rerun: pip install 'slamcmp[view]'\n"
