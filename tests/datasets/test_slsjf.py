"""Huang's simulated sets: a small one written here, exact by its own formulas, and set 8240 where it lies."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

import slamcmp
from slamcmp import geometry
from slamcmp.backends.gtsam_smoothers.batch import Batch
from slamcmp.datasets.slsjf import TIME_STEP_S, slsjf
from slamcmp.errors import DataError, MissingDataError, UsageError
from tests.recorded_data import recorded


def write(folder: Path, **changed: Any) -> dict[str, np.ndarray]:
    """Five poses by the formulas of parameters.txt, two beacons seen from each, the second row first."""
    v, w = np.array([0.0, 1.0, 2.0, 1.5]), np.array([0.0, 0.4, -0.2, 3.0])
    pose = np.zeros((5, 3))
    pose[0] = 1.0, -2.0, 0.3
    for k in range(4):
        x, y, phi = pose[k]
        turned = phi + w[k] * TIME_STEP_S
        pose[k + 1] = (
            x + v[k] * TIME_STEP_S * math.cos(turned),
            y + v[k] * TIME_STEP_S * math.sin(turned),
            turned,
        )
    beacons = np.array([[7, 4, 1], [3, 2, 5]], dtype=np.uint16)
    seen = []
    for k in (1, 0, 2, 3):
        for name, bx, by in beacons.astype(float):
            dx, dy = bx - pose[k, 0], by - pose[k, 1]
            seen.append([k + 1, name, math.hypot(dx, dy), math.atan2(dy, dx) - pose[k, 2], 0, 0, 0])
    held = {
        "store_speed": v[None],
        "store_turnrate": w[None],
        "store_robotTrue": pose.T,
        "store_beaconsTrue": beacons,
        "sensor_data": np.array(seen),
        **changed,
    }
    for name, table in held.items():
        savemat(folder / f"{name}.mat", {name: table})
    return held


def test_without_noise_everything_fits_the_truth(tmp_path: Path) -> None:
    write(tmp_path)
    log = slsjf(path=str(tmp_path))
    assert log.truth is not None
    T = log.problem.T_world_body
    where = dict(zip(log.truth.ids.tolist(), log.truth.positions, strict=True))
    for k, (increment, seen) in enumerate(zip(log.T_prev_body, log.detections, strict=True)):
        T = T @ increment
        np.testing.assert_allclose(T, log.truth.T_world_body[k], atol=1e-12)
        assert sorted(seen.ids.tolist()) == ([3, 7] if k < 4 else [])
        for name, z in zip(seen.ids.tolist(), seen.z, strict=True):
            expected = log.problem.sensor.predict(T, where[name])
            np.testing.assert_allclose(log.problem.sensor.residual(z, expected), 0, atol=1e-12)
    np.testing.assert_allclose(log.t, [0, 0.3, 0.6, 0.9, 1.2])


def test_the_covariance_is_that_of_noisy_speeds_and_turn_rates(tmp_path: Path) -> None:
    """A hundred thousand draws of the published model; sideways it has only what the turn swings."""
    write(tmp_path)
    log = slsjf(path=str(tmp_path), lateral_sigma_m=1e-9, turn_sigma_deg_s=3.0, speed_sigma_m_s=0.05)
    rng = np.random.default_rng(0)
    v = 2.0 + 0.05 * rng.normal(size=100_000)
    w = -0.2 + math.radians(3.0) * rng.normal(size=100_000)
    turned, way = w * TIME_STEP_S, v * TIME_STEP_S
    drawn = geometry.se2(way * np.cos(turned), way * np.sin(turned), turned)
    error = geometry.log(geometry.inverse(log.T_prev_body[3]) @ drawn)
    sigma = np.sqrt(np.diag(log.Q[3]))
    np.testing.assert_allclose(
        np.cov(error.T) / np.outer(sigma, sigma), log.Q[3] / np.outer(sigma, sigma), atol=0.02
    )


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"sensor_data": np.array([[6.0, 7, 1, 0, 0, 0, 0]])}, "sensor_data.mat: row 1 is of step 6; 1 to 5"),
        ({"sensor_data": np.ones((2, 4))}, r"sensor_data.mat: \(2, 4\) of float64 where"),
        ({"store_speed": np.ones((1, 7))}, "7 speeds in store_speed.mat for 4 turn rates"),
        ({"store_robotTrue": np.ones((3, 9))}, r"store_robotTrue.mat: \(3, 9\) where \(3, 5\) is needed"),
        ({"store_turnrate": np.array([[0, np.nan, 0, 0]])}, "store_turnrate.mat: not every number is finite"),
        ({"store_beaconsTrue": np.array([["a", "b", "c"]])}, "store_beaconsTrue.mat: .* a matrix of numbers"),
    ],
)
def test_sets_that_do_not_fit_are_refused(tmp_path: Path, changed: Any, message: str) -> None:
    write(tmp_path, **changed)
    with pytest.raises(DataError, match=message):
        slsjf(path=str(tmp_path))


def test_damaged_and_missing_files_are_named(tmp_path: Path) -> None:
    write(tmp_path)
    with pytest.raises(UsageError, match=r"steps is 6, and .* has 5 poses"):
        slsjf(path=str(tmp_path), steps=6)
    savemat(tmp_path / "store_speed.mat", {"speed": np.ones((1, 4))})
    with pytest.raises(DataError, match=r"store_speed.mat: holds no matrix store_speed \(it has speed\)"):
        slsjf(path=str(tmp_path))
    (tmp_path / "store_speed.mat").write_bytes((tmp_path / "store_turnrate.mat").read_bytes()[:140])
    with pytest.raises(DataError, match=r"store_speed.mat: no MATLAB file"):
        slsjf(path=str(tmp_path))
    (tmp_path / "store_speed.mat").unlink()
    with pytest.raises(MissingDataError, match=r"store_speed.mat: there is no such file"):
        slsjf(path=str(tmp_path))
    with pytest.raises(MissingDataError, match="openslam-org"):
        slsjf(path="no_such_set")


def test_set_8240_is_as_published() -> None:
    log = slsjf(path=str(recorded("slsjf_sim") / "8240"))
    assert log.truth is not None
    ids = np.concatenate([seen.ids for seen in log.detections])
    assert (log.t.size, ids.size, np.unique(ids).size) == (8241, 40524, 612)
    where = dict(zip(log.truth.ids.tolist(), log.truth.positions, strict=True))
    pairs = zip(log.truth.T_world_body, log.detections, strict=True)
    errors = [
        log.problem.sensor.residual(
            seen.z, log.problem.sensor.predict(T, np.array([where[i] for i in seen.ids]))
        )
        for T, seen in pairs
        if seen.ids.size
    ]
    sigma = np.concatenate(errors).std(axis=0)
    assert sigma[0] == pytest.approx(0.1, rel=0.06)
    assert math.degrees(sigma[1]) == pytest.approx(1.0, rel=0.06)
    noise = geometry.log(geometry.inverse(log.T_prev_body[1:]) @ _steps(log.truth.T_world_body))
    assert math.degrees(noise[:, 2].std()) / TIME_STEP_S == pytest.approx(2.85, abs=0.01)


def _steps(T: np.ndarray) -> np.ndarray:
    return geometry.inverse(T[:-1]) @ T[1:]


def test_the_maps_nees_is_that_of_the_pose_it_stands_with(tmp_path: Path) -> None:
    """Batch on 500 poses: its final map with its final pose. With the online pose, iSAM2's, it would be half
    as much again, and on 2000 poses twenty times."""
    path, steps = str(recorded("slsjf_sim") / "8240"), 500
    mapping = {"source": {"name": "slsjf", "path": path, "steps": steps}, "back_ends": [{"name": "batch"}]}
    (tmp_path / "e.yaml").write_text(json.dumps(mapping))
    trial = slamcmp.run(
        tmp_path / "e.yaml", folder=tmp_path / "r", executor="serial", progress=False
    ).trials.iloc[0]

    stream = slamcmp.make_stream("slsjf", path=path, steps=steps)
    assert stream.truth is not None
    batch = Batch(stream.problem)
    for frame in stream.frames:
        batch.update(frame)
    online = batch.estimate().T_world_body
    final, landmarks, P = batch.trajectory().T_world_body[-1], batch.landmarks(), batch.joint_covariance()
    rows = {name: row for row, name in enumerate(stream.truth.ids.tolist())}
    offset = stream.truth.positions[[rows[i] for i in landmarks.ids.tolist()]] - landmarks.positions

    def nees(T: np.ndarray) -> float:
        pose = geometry.log(geometry.inverse(T) @ stream.truth.T_world_body[-1])
        error = np.concatenate([pose, offset.ravel()])
        return float(error @ np.linalg.solve(P, error)) / error.size

    assert trial["joint_nees_per_dof"] == pytest.approx(nees(final), rel=1e-6)
    assert nees(final) == pytest.approx(0.731, abs=0.005)
    assert nees(online) > 1.4 * nees(final)
