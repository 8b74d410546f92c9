"""The frame, the landmark and the reason are found where a fault was put in, and nothing where none was."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from slamcmp.backends.dead_reckoning import DeadReckoning
from slamcmp.backends.filters.ekf_slam import EkfSlam
from slamcmp.experiment.job.run_back_end import run_back_end
from slamcmp.geometry import se2
from slamcmp.metrics.divergence import (
    FALSE_ALARM,
    WINDOW,
    explain,
    find_suspect,
    first_departure,
)
from slamcmp.models.camera import MonoCamera
from slamcmp.models.sensors import make_sensor
from slamcmp.types import (
    Detections,
    Frame,
    GroundTruth,
    MeasurementStream,
    Problem,
    Run,
    Trajectory,
)
from tests.toy_stream import toy_stream

FAULT_AT = 40


def world(seed: int = 0) -> tuple[MeasurementStream, GroundTruth]:
    stream, poses, landmarks = toy_stream(frames=80, seed=seed)
    t = np.array([frame.t for frame in stream.frames])
    return stream, GroundTruth(t, poses, np.arange(len(landmarks)), landmarks)


def changed(stream: MeasurementStream, k: int, **fields: object) -> MeasurementStream:
    frames = list(stream.frames)
    frames[k] = replace(frames[k], **fields)
    return MeasurementStream(stream.problem, tuple(frames))


def run_ekf(stream: MeasurementStream) -> Run:
    return run_back_end(EkfSlam, stream, label="EKF", parameters={})


def test_an_outlier_of_a_single_camera_is_found_by_where_landmarks_entered() -> None:
    """A pixel alone places nothing: what the entries say counts instead."""
    rng = np.random.default_rng(5)
    camera = MonoCamera(fx_px=400.0, fy_px=400.0, cx_px=320.0, cy_px=240.0)
    points = rng.uniform([6, -2, -1], [12, 2, 1], (8, 3))
    ids = np.arange(8)
    poses = np.tile(np.eye(4), (12, 1, 1))
    poses[:, 0, 3] = 0.1 * np.arange(12)
    frames = []
    for k, T in enumerate(poses):
        moved = poses[1] if k else np.eye(4)
        z = camera.predict(T, points) if k else np.empty((0, 2))
        if k == 9:
            z[3] += [0.0, 40.0]
        by = camera.entry_sensor
        entries = None if k else Detections(by.predict(T, points), np.tile(np.eye(3) * 0.01, (8, 1, 1)), ids)
        R = np.tile(np.eye(2), (len(z), 1, 1))
        frames.append(
            Frame(k, 0.1 * k, moved, np.eye(6) * (1e-6 if k else 0.0), ids[: len(z)], z, R, entries)
        )
    stream = MeasurementStream(Problem(poses[0], 1e-12 * np.eye(6), camera), tuple(frames))
    run = run_back_end(DeadReckoning, stream, label="odometry", parameters={})
    suspect = find_suspect(stream, run, None, 10)
    assert suspect is not None
    assert (suspect.k, suspect.landmark, suspect.component) == (9, 3, "v_px")
    assert suspect.residual == pytest.approx(40.0)


def test_an_outlier_is_named_with_its_frame_and_landmark() -> None:
    stream, truth = world()
    frame = stream.frames[FAULT_AT]
    z = np.array(frame.z)
    z[2, 1] += 0.5
    stream = changed(stream, FAULT_AT, z=z)
    run = run_ekf(stream)
    departure = first_departure(run, truth)
    assert departure is not None
    assert (departure.test, departure.k) == ("NIS", FAULT_AT)
    # The window's own sum and its limit, from their definitions.
    window = slice(FAULT_AT - WINDOW + 1, FAULT_AT + 1)
    dof = run.diagnostics["nis_dof"][window].sum()
    assert departure.value == pytest.approx(np.nansum(run.diagnostics["nis"][window]))
    assert departure.limit == pytest.approx(stats.chi2.isf(FALSE_ALARM / 80, dof))
    suspect = find_suspect(stream, run, truth, departure.k)
    assert suspect is not None
    assert (suspect.k, suspect.landmark, suspect.component) == (FAULT_AT, frame.ids[2], "bearing_rad")
    assert suspect.residual == pytest.approx(0.5, abs=0.15)
    assert suspect.measurement_faulty
    assert not suspect.odometry_faulty
    expected = stream.problem.sensor.predict(truth.T_world_body[FAULT_AT], truth.positions[frame.ids[2]])
    by_hand = stream.problem.sensor.residual(z[2], expected) / np.sqrt(np.diagonal(frame.R[2]))
    assert suspect.measurement_sigmas == pytest.approx(np.linalg.norm(by_hand))
    text = explain(run, departure, suspect)
    assert f"at frame {FAULT_AT} (t = 4 s)" in text
    assert f"landmark {frame.ids[2]} in frame {FAULT_AT}: its bearing was" in text
    assert "an outlier or another landmark" in text


def test_a_slip_of_the_odometry_is_told_from_a_bad_measurement() -> None:
    stream, truth = world(1)
    T = stream.frames[FAULT_AT].T_prev_body @ se2(1.0, 0.0, 0.2)
    stream = changed(stream, FAULT_AT, T_prev_body=T)
    run = run_ekf(stream)
    departure = first_departure(run, truth)
    assert departure is not None
    assert departure.k == FAULT_AT
    suspect = find_suspect(stream, run, truth, departure.k)
    assert suspect is not None
    assert suspect.k == FAULT_AT
    assert not suspect.measurement_faulty
    assert suspect.odometry_faulty
    assert "but the odometry of this frame was" in explain(run, departure, suspect)


def test_overconfidence_without_any_fault_shows_in_nees() -> None:
    stream, truth = world(2)
    run = run_ekf(stream)
    P = run.online.P
    assert P is not None
    sure = replace(run, online=replace(run.online, P=P / 100.0), diagnostics={})
    departure = first_departure(sure, truth)
    assert departure is not None
    assert (departure.test, departure.dof, departure.window) == ("NEES", 3, 1)
    assert departure.limit == pytest.approx(stats.chi2.isf(FALSE_ALARM / 80, 3))
    assert "promised more than it kept" in explain(sure, departure, None)
    quiet = find_suspect(stream, sure, truth, FAULT_AT)
    assert quiet is not None
    assert not quiet.stands_out
    assert "No single observation stands out" in explain(sure, departure, quiet)
    # Against another back end's solution a covariance cannot be judged.
    assert first_departure(sure, truth, reference=True) is None
    assert first_departure(sure, None) is None


def test_a_consistent_filter_is_left_alone() -> None:
    alarms = 0
    for seed in range(20):
        stream, truth = world(seed)
        alarms += first_departure(run_ekf(stream), truth) is not None
    # At most 0.02 a run: four or more of twenty have a chance below 1e-3.
    assert alarms < 4


def test_false_alarms_are_as_rare_as_promised() -> None:
    rng = np.random.default_rng(5)
    stream, _ = world()
    run = run_ekf(stream)
    alarms = 0
    for _ in range(3000):
        nis = {"nis": rng.chisquare(10, 80), "nis_dof": np.full(80, 10.0)}
        alarms += first_departure(replace(run, diagnostics=nis), None) is not None
    # The bound is 1 %; four deviations of a share of 0.01 over 3000 are 0.0073.
    assert alarms / 3000 < 0.0173
    assert alarms > 0


def test_a_run_that_ended_is_looked_at_where_it_ended() -> None:
    stream, truth = world(3)
    frame = stream.frames[FAULT_AT]
    z = np.array(frame.z)
    z[0, 0] += 4.0
    stream = changed(stream, FAULT_AT, z=z)
    whole = run_ekf(stream)
    online = whole.online
    assert online.P is not None
    cut = replace(
        whole,
        status="crashed",
        online=type(online)(online.t[:FAULT_AT], online.T_world_body[:FAULT_AT], online.P[:FAULT_AT]),
        diagnostics={name: series[:FAULT_AT] for name, series in whole.diagnostics.items()},
    )
    assert first_departure(cut, truth) is None
    suspect = find_suspect(stream, cut, None, 79)
    assert suspect is not None
    assert (suspect.k, suspect.landmark, suspect.component) == (FAULT_AT, frame.ids[0], "range_m")
    assert math.isnan(suspect.measurement_sigmas)
    text = explain(cut, None, suspect)
    assert text.startswith(f"No test gave a warning in the {FAULT_AT} frames")
    assert "itself" not in text


def test_nothing_is_known_of_a_run_without_frames() -> None:
    stream, truth = world()
    whole = run_ekf(stream)
    nothing = np.empty(0)
    lost = replace(
        whole,
        status="crashed",
        online=type(whole.online)(nothing, np.empty((0, 3, 3)), None),
        diagnostics={},
    )
    assert first_departure(lost, truth) is None
    assert find_suspect(stream, lost, truth, 0) is None
    assert explain(lost, None, None) == ""


def test_the_named_landmark_is_mostly_the_filters_own_worst() -> None:
    """Against the innovations that the filter really had: the same landmark nearly always."""
    same = total = 0
    for seed in range(25):
        stream, truth = world(seed)
        rng = np.random.default_rng(seed)
        frame = stream.frames[FAULT_AT]
        row = int(rng.integers(frame.ids.size))
        z = np.array(frame.z)
        z[row] += rng.choice([-1, 1], 2) * [0.6, 0.12]
        stream = changed(stream, FAULT_AT, z=z)
        suspect = find_suspect(stream, run_ekf(stream), truth, FAULT_AT, window=1)
        own = _worst_innovation(stream)
        total += 1
        same += suspect is not None and suspect.landmark == own
    assert (same, total) >= (23, 25)


def _worst_innovation(stream: MeasurementStream) -> int:
    """The landmark with the largest NIS of its own in the faulty frame, from the joint covariance."""
    back_end = EkfSlam(stream.problem)
    for frame in stream.frames[:FAULT_AT]:
        back_end.update(frame)
    frame = stream.frames[FAULT_AT]
    blind = replace(frame, ids=frame.ids[:0], z=frame.z[:0], R=frame.R[:0])
    back_end.update(blind)
    T, P, known = back_end.estimate().T_world_body, back_end.joint_covariance(), back_end.landmarks()
    worst = {}
    for landmark, z, R in zip(frame.ids, frame.z, frame.R, strict=True):
        j = int(np.flatnonzero(known.ids == landmark)[0])
        H = np.zeros((2, len(P)))
        H[:, :3], H[:, 3 + 2 * j : 5 + 2 * j] = stream.problem.sensor.jacobians(T, known.positions[j])
        y = stream.problem.sensor.residual(z, stream.problem.sensor.predict(T, known.positions[j]))
        worst[int(landmark)] = float(y @ np.linalg.solve(H @ P @ H.T + R, y))
    return max(worst, key=lambda landmark: worst[landmark])


def sighted(*sightings: tuple[float, float]) -> MeasurementStream:
    """A robot at the origin; frame k sees landmark 5 at (x, 0), with this variance, or nothing."""
    frames = []
    for k, (x, variance) in enumerate(sightings):
        seen = np.isfinite([x])
        Q = np.diag([0.05, 0.02, 1e-8]) if k else np.zeros((3, 3))
        z, R = np.array([[x, 0.0]])[seen], np.array([variance * np.eye(2)])[seen]
        frames.append(Frame(k, float(k), np.eye(3), Q, np.array([5])[seen], z, R))
    sensor = make_sensor("relative_position", {"space_dim": 2})
    return MeasurementStream(Problem(np.eye(3), 1e-12 * np.eye(3), sensor), tuple(frames))


NOTHING = (math.nan, 1.0)


def test_a_suspect_is_measured_in_the_noise_of_all_it_is_made_of() -> None:
    """Sensor 0.01, odometry 0.05 and its place 0.04 m²: 0.5 m are sqrt(0.25 / 0.1) sigmas."""
    stream = sighted((3.0, 0.04), NOTHING, (3.5, 0.01))
    run = run_back_end(DeadReckoning, stream, label="odometry", parameters={})
    suspect = find_suspect(stream, run, None, 2)
    assert suspect is not None
    assert (suspect.k, suspect.landmark, suspect.residual) == (2, 5, pytest.approx(0.5))
    assert suspect.sigmas == pytest.approx(math.sqrt(2.5), rel=1e-6)


def test_a_place_is_the_weighted_mean_of_the_earlier_sightings() -> None:
    """3.0 m with 0.04 m² and 3.5 m with 0.01 m² place it at 3.4 m with 0.008 m²; the third does not."""
    stream = sighted((3.0, 0.04), (3.5, 0.01), (4.0, 0.03))
    run = run_back_end(DeadReckoning, stream, label="odometry", parameters={})
    suspect = find_suspect(stream, run, None, 2, window=1)
    assert suspect is not None
    assert (suspect.k, suspect.residual) == (2, pytest.approx(0.6))
    assert suspect.sigmas == pytest.approx(0.6 / math.sqrt(0.03 + 0.05 + 0.008), rel=1e-6)


def test_a_suspect_against_the_truth_is_measured_in_each_noise_alone() -> None:
    stream = sighted((3.0, 0.04), (3.5, 0.01))
    run = run_back_end(DeadReckoning, stream, label="odometry", parameters={})
    truth = GroundTruth(np.arange(2.0), se2([0.0, 0.3], 0, 0), np.array([5]), np.array([[3.6, 0.0]]))
    suspect = find_suspect(stream, run, truth, 1)
    assert suspect is not None
    # Seen from the true pose at 3.3 m: 0.2 m with sigma 0.1; the odometry missed 0.3 m with variance 0.05.
    assert suspect.measurement_sigmas == pytest.approx(2.0, rel=1e-6)
    assert suspect.odometry_sigmas == pytest.approx(0.3 / math.sqrt(0.05), rel=1e-6)


def test_the_earlier_of_two_departures_is_told() -> None:
    """NIS leaves its band at frame 3; the pose is off from frame 1 on."""
    t, poses = np.arange(5.0), np.broadcast_to(np.eye(3), (5, 3, 3))
    nis = np.array([0.0, 2.0, 2.0, 90.0, 2.0])
    run = Run(
        "a", {}, "d", 0, 5, "ok", "", Trajectory(t, poses, np.broadcast_to(0.01 * np.eye(3), (5, 3, 3))),
        np.zeros(5), np.zeros(5), diagnostics={"nis": nis, "nis_dof": np.array([0.0, 2, 2, 2, 2])},
    )  # fmt: skip
    truth = GroundTruth(t, se2([0, 0.6, 0.6, 0.6, 0.6], 0, 0), np.empty(0, int), np.empty((0, 2)))
    departure = first_departure(run, truth)
    assert departure is not None
    assert (departure.test, departure.k, departure.value) == ("NEES", 1, pytest.approx(36.0))
    # Against a reference there is no NEES: the NIS alone speaks.
    departure = first_departure(run, truth, reference=True)
    assert departure is not None
    assert (departure.test, departure.k) == ("NIS", 3)
    assert departure.value == 94.0
    assert departure.limit == pytest.approx(stats.chi2.isf(FALSE_ALARM / 5, 6))
