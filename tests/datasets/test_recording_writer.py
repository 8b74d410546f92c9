"""Conversions: what is read back is the log that was written."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slamcmp import geometry as g
from slamcmp.cli import app
from slamcmp.datasets.graphs.graph_file import graph_file
from slamcmp.datasets.plain.plain_recording import recording
from slamcmp.datasets.plain.plain_roles import files_by_role
from slamcmp.datasets.plain.recording_writer import write_recording
from slamcmp.errors import DataError, MissingDataError, UsageError
from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.models.sensors import make_sensor
from slamcmp.types import Detections, GroundTruth, Log, Problem
from tests.datasets.plain_drive import Drive


def a_log(sensor: str = "range_bearing", seed: int = 0, *, own_ids=None) -> Log:
    """Ten frames with all that a planar log can have: full covariances, no names, gaps in the truth."""
    rng = np.random.default_rng(seed)
    K = 10
    G = rng.normal(size=(K, 3, 3)) * 0.05
    G[0] = 0
    steps = g.exp(rng.normal(size=(K, 3)) * [0.5, 0.05, 0.3])
    steps[0] = np.eye(3)
    true = g.dead_reckoning(g.se2(3, -4, 2.0), steps)
    true[4] = np.nan
    detections = []
    for _ in range(K):
        m = int(rng.integers(0, 4))
        d = make_sensor(sensor, {}).dim
        z = rng.uniform(0.5, 3.0, (m, d))
        R = rng.uniform(0.01, 0.2, (m, d))[:, :, None] ** 2 * np.eye(d)
        detections.append(Detections(z, R, rng.permutation(np.array([-1, 0, 1, 2]))[:m]))
    t = np.cumsum(rng.uniform(0.05, 0.4, K))
    model = make_sensor(sensor, {"space_dim": 2} if sensor == "relative_position" else {})
    P_true = np.tile(np.diag([1e-4, 1e-4, 1e-6]), (K, 1, 1))
    P_true[4] = np.nan
    return Log(
        "mine",
        Problem(g.se2(3.1, -4.1, 2.1), np.diag([0.01, 0.01, 0.0004]), model),
        t,
        steps,
        G @ np.swapaxes(G, 1, 2),
        tuple(detections),
        GroundTruth(t, true, np.arange(3), rng.normal(size=(3, 2)), P=P_true),
        own_ids=own_ids,
    )


def read_back(folder: Path) -> Log:
    spec = load_experiment(folder / "experiment.yaml").source
    return recording(**spec.arguments())


def same(one: Log, other: Log) -> None:
    np.testing.assert_array_equal(one.t, other.t)
    np.testing.assert_allclose(one.T_prev_body, other.T_prev_body, atol=1e-14)
    np.testing.assert_allclose(one.Q, other.Q, atol=1e-16)
    np.testing.assert_allclose(one.problem.T_world_body, other.problem.T_world_body, atol=1e-15)
    np.testing.assert_allclose(one.problem.P, other.problem.P, rtol=1e-14)
    for a, b in zip(one.detections, other.detections, strict=True):
        np.testing.assert_array_equal(a.ids, b.ids)
        np.testing.assert_array_equal(a.z, b.z)
        np.testing.assert_allclose(a.R, b.R, rtol=1e-14)


@pytest.mark.parametrize("kind", ["csv", "parquet"])
@pytest.mark.parametrize("sensor", ["range_bearing", "relative_position", "range_only", "bearing_only"])
def test_a_log_reads_back(tmp_path, sensor, kind, monkeypatch):
    monkeypatch.chdir(tmp_path)
    log = a_log(sensor)
    written = write_recording(log, tmp_path, kind=kind)
    assert written.left_out == []
    back = read_back(tmp_path)
    same(log, back)
    known = log.truth.known()
    np.testing.assert_array_equal(back.truth.known(), known)
    np.testing.assert_allclose(back.truth.T_world_body[known], log.truth.T_world_body[known], atol=1e-14)
    np.testing.assert_allclose(back.truth.P[known], log.truth.P[known], atol=1e-17)
    np.testing.assert_array_equal(back.truth.positions, log.truth.positions)


def test_landmarks_keep_their_own_names(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    log = a_log(own_ids=np.array([-7, 12, 1 << 60]))
    write_recording(log, tmp_path)
    back = read_back(tmp_path)
    same(log, back)
    assert back.own_ids.tolist() == [-7, 12, 1 << 60]


def test_through_g_2_o_and_back(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Drive(seconds=12).write(tmp_path)
    names = ("odometry.csv", "detections.csv")
    settings = [f"--set={each}" for each in ("range_sigma_m=0.05", "bearing_sigma_rad=0.01", "start=origin")]
    app(["data", "convert", *names, "log.g2o", *settings], standalone_mode=False)
    direct = recording(
        odometry=names[0], detections=names[1], range_sigma_m=0.05, bearing_sigma_rad=0.01, start="origin"
    )
    graph = graph_file(path="log.g2o")
    np.testing.assert_allclose(graph.T_prev_body, direct.T_prev_body, atol=1e-12)
    np.testing.assert_allclose(graph.Q, direct.Q, rtol=1e-9, atol=1e-15)
    app(["data", "convert", "log.g2o", "own"], standalone_mode=False)
    monkeypatch.chdir(tmp_path / "own")
    back = read_back(tmp_path / "own")
    same(graph, back)
    for a, b in zip(direct.detections, back.detections, strict=True):
        np.testing.assert_array_equal(a.ids, b.ids)
        np.testing.assert_allclose(a.z, b.z, atol=1e-14)


def test_an_experiment_s_log_and_its_parts(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.yaml").write_text(
        "source: {name: circle, landmarks: 8, steps: 12}\nback_ends: [{name: ekf_slam}]\nseeds: 2\n"
    )
    app(
        ["data", "convert", "small.yaml", "out", "--trial", "1", "--format", "parquet"], standalone_mode=False
    )
    assert " frames, " in capsys.readouterr().out
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "detections.parquet",
        "experiment.yaml",
        "landmarks.parquet",
        "odometry.parquet",
        "truth.parquet",
    ]
    monkeypatch.chdir(tmp_path / "out")
    assert read_back(tmp_path / "out").truth is not None


def test_what_the_files_cannot_hold(tmp_path):
    log = a_log()
    tilted = replace(log, problem=replace(log.problem, P=np.diag([0.01, 0.04, 0.0004])))
    assert write_recording(tilted, tmp_path).left_out == [
        "the prior's covariance beyond one sigma of position and one of heading"
    ]
    crossed = [replace(each, R=each.R + 1e-5) for each in log.detections]
    with pytest.raises(DataError, match="the noise of a detection is correlated"):
        write_recording(replace(log, detections=tuple(crossed)), tmp_path)
    with pytest.raises(
        UsageError, match="planar logs of range_bearing, relative_position, range_only, bearing_only, not of"
    ):
        write_recording(_spatial(), tmp_path)


def _spatial() -> Log:
    sensor = make_sensor("relative_position", {"space_dim": 3})
    nothing = Detections(np.empty((0, 3)), np.empty((0, 3, 3)), np.empty(0, np.int64))
    return Log(
        "space",
        Problem(np.eye(4), np.eye(6), sensor),
        np.zeros(1),
        np.eye(4)[None],
        np.zeros((1, 6, 6)),
        (nothing,),
    )


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["odometry.csv"], "FROM... TO: what to convert, and last"),
        (["none.csv", "x.g2o"], r"none\.csv: there is no such file"),
        (["detections.csv", "x.g2o"], "none of them is odometry"),
        (
            ["odometry.csv", "copy_of_odometry.csv", "x.g2o"],
            r"odometry of this log is .*odometry\.csv already",
        ),
        (["odometry.csv", "x.xyz"], r"x\.xyz: a name that ends in \.g2o, or a folder"),
        (["odometry.csv", "x.g2o", "--set", "range_sigm=1"], "did you mean 'range_sigma_m'"),
        (
            ["odometry.csv", "x.g2o", "--set", "range_sigma_m=-1"],
            "--set range_sigma_m: Input should be greater",
        ),
    ],
)
def test_wrong_calls(tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    files = Drive(seconds=5).write(tmp_path)
    (tmp_path / "copy_of_odometry.csv").write_bytes(files["odometry"].read_bytes())
    with pytest.raises((UsageError, MissingDataError), match=message):
        app(["data", "convert", *words], standalone_mode=False)
    assert not (tmp_path / "x.g2o").exists()


def test_roles(tmp_path):
    files = Drive(seconds=5).write(tmp_path)
    rows = files["truth"].read_text()
    for name in ("wheel_odometry.csv", "vicon.csv", "one.csv", "two.csv"):
        (tmp_path / name).write_text(rows)
    names = ("wheel_odometry.csv", "vicon.csv")
    for order in (names, names[::-1]):
        found = files_by_role([tmp_path / name for name in order])
        assert {role: path.name for role, path in found.items()} == {
            "odometry": "wheel_odometry.csv",
            "truth": "vicon.csv",
        }
    seen = files["detections"].read_text().splitlines()
    (tmp_path / "nameless.csv").write_text("\n".join(",".join(np.delete(row.split(","), 1)) for row in seen))
    assert files_by_role([tmp_path / "nameless.csv"]) == {"detections": tmp_path / "nameless.csv"}


def test_increments_covariances_are_shared_by_their_parts(tmp_path):
    """Half of an increment has half of its covariance; two halves have the whole, carried over."""
    head = "t_s,dx_m,dy_m,dtheta_rad,cov_xx_m2,cov_xy_m2,cov_xtheta_m_rad"
    head += ",cov_yy_m2,cov_ytheta_m_rad,cov_thetatheta_rad2"
    path = tmp_path / "odometry.csv"
    path.write_text(f"{head}\n0,0,0,0,0,0,0,0,0,0\n1,1,0,0,0.04,0,0,0.01,0,0\n")
    (tmp_path / "seen.csv").write_text("t_s,id,range_m,bearing_rad\n0,1,1,0\n0.5,1,1,0\n1,1,1,0\n")
    log = recording(
        odometry=str(path), detections=str(tmp_path / "seen.csv"), range_sigma_m=0.1, bearing_sigma_rad=0.1
    )
    np.testing.assert_allclose(log.Q[1:], np.tile(np.diag([0.02, 0.005, 0]), (2, 1, 1)), atol=1e-15)
    path.write_text(path.read_text().replace("0.04,0,", "0.04,0.5,"))
    with pytest.raises(DataError, match=r"odometry\.csv:3: its cov columns are no covariance"):
        recording(odometry=str(path))
    path.write_text("t_s,dx_m,dy_m,dtheta_rad,cov_xx_m2\n0,0,0,0,0\n1,1,0,0,0.04\n")
    with pytest.raises(DataError, match="has cov_xx, and no cov_xy; all six are needed"):
        recording(odometry=str(path))
