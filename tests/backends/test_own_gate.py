"""A back end behind its own gate: S against brute force, the share it rejects, and what it leaves alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import bdtr, bdtrc, chdtri

from slamcmp import geometry
from slamcmp.backends.own_gate import OwnGate, innovation_covariances, predicted_blocks
from slamcmp.errors import UsageError
from slamcmp.experiment.conformance.check import check_back_end
from slamcmp.experiment.job.recorder import SelfLinearising
from slamcmp.models.sensors import make_sensor
from slamcmp.protocols import Diagnosed, JointEstimator, Mapper, Smoother
from slamcmp.registry import back_ends
from slamcmp.types import Frame, MeasurementStream, Problem
from tests.camera_stream import Kind, camera_stream
from tests.toy_stream import toy_stream

NAMES: list[tuple[str, dict[str, Any]]] = [
    ("ekf_slam", {}),
    ("ekf_right_invariant", {"smooth": True}),
    ("ekf_fej", {}),
    ("isam2", {"relinearize_skip": 1}),
    ("sliding_window", {"window": 4, "iterations": 2}),
]


def make(name: str, problem: Problem, **parameters: Any) -> Any:
    return back_ends.get(name).target(problem, **parameters)


@pytest.mark.parametrize(("name", "parameters"), NAMES)
def test_a_gate_that_lets_all_pass_changes_no_bit(name: str, parameters: dict[str, Any]) -> None:
    stream, _, _ = toy_stream(frames=40)
    plain = make(name, stream.problem, **parameters)
    gated = OwnGate(make(name, stream.problem, **parameters), stream.problem, 1 - 1e-15)
    tested = 0
    for frame in stream.frames:
        plain.update(frame)
        gated.update(frame)
        one, two = plain.estimate(), gated.estimate()
        assert np.array_equal(one.T_world_body, two.T_world_body)
        assert np.array_equal(one.P, two.P)
        tested += int(gated.diagnostics()["gate_tested"])
        assert gated.diagnostics()["gate_rejected"] == 0
    assert tested == sum(frame.ids.size for frame in stream.frames) - plain.landmarks().ids.size
    assert np.array_equal(plain.landmarks().positions, gated.landmarks().positions)
    assert np.array_equal(plain.joint_covariance(), gated.joint_covariance())
    assert {*plain.diagnostics(), "gate_tested", "gate_rejected"} == set(gated.diagnostics())


@pytest.mark.parametrize(("name", "parameters"), NAMES)
def test_distances_are_those_of_the_whole_state_propagated_by_brute_force(
    name: str, parameters: dict[str, Any]
) -> None:
    """S = H F P F^T H^T + H G Q G^T H^T + R with every matrix written out over the whole state."""
    stream, _, _ = toy_stream(frames=25)
    back_end = make(name, stream.problem, **parameters)
    gate = OwnGate(back_end, stream.problem, 0.5)
    for frame in stream.frames[:-1]:
        back_end.update(frame)
        gate._seen.update(frame.ids.tolist())
    frame = stream.frames[-1]
    distances = gate._squared_distances(frame)

    sensor, landmarks = stream.problem.sensor, back_end.landmarks()
    P, T = back_end.joint_covariance(), back_end.estimate().T_world_body
    F = np.eye(len(P))
    F[:3, :3] = geometry.adjoint(geometry.inverse(frame.T_prev_body))
    P = F @ P @ F.T
    P[:3, :3] += frame.Q
    T = T @ frame.T_prev_body
    for i, landmark in enumerate(frame.ids):
        (row,) = np.flatnonzero(landmarks.ids == landmark)
        H = np.zeros((2, len(P)))
        H_pose, H_land = sensor.jacobians(T, landmarks.positions[row])
        H[:, :3], H[:, 3 + 2 * row : 5 + 2 * row] = H_pose, H_land
        y = sensor.residual(frame.z[i], sensor.predict(T, landmarks.positions[row]))
        S = H @ P @ H.T + frame.R[i]
        assert distances[i] == pytest.approx(y @ np.linalg.inv(S) @ y, rel=1e-6)


@pytest.mark.parametrize("name", ["ekf_slam", "ekf_world", "ekf_right_invariant"])
def test_a_lone_observations_distance_is_the_filters_own_nis(name: str) -> None:
    """Where Jacobians are the latest estimate's, the gate's S is the one that the filter works with."""
    stream, _, _ = toy_stream(frames=60, seen_at_once=1, landmarks=4)
    back_end = make(name, stream.problem)
    gate = OwnGate(back_end, stream.problem, 0.5)
    compared = 0
    for frame in stream.frames:
        (distance,) = gate._squared_distances(frame)
        back_end.update(frame)
        gate._seen.update(frame.ids.tolist())
        if not np.isnan(distance):
            assert back_end.diagnostics()["nis"] == pytest.approx(distance, rel=1e-8)
            compared += 1
    assert compared == 60 - 4


def test_s_is_the_spread_of_simulated_innovations() -> None:
    """Closed form against sampling: 20 000 draws of pose, landmark, odometry and sensor noise, within 5 %."""
    rng = np.random.default_rng(3)
    sensor = make_sensor("range_bearing", {})
    T, landmark = geometry.se2(1.0, -2.0, 0.4), np.array([[5.0, 3.0]])
    root = 0.02 * rng.normal(size=(5, 5))
    P, Q, R = root @ root.T, np.diag([0.03, 0.02, 0.01]) ** 2, np.diag([0.05, 0.02])[None] ** 2
    step = geometry.se2(0.5, 0.1, 0.2)
    frame = Frame(1, 1.0, step, Q, np.array([7]), np.zeros((1, 2)), R)
    H_pose, H_land = sensor.jacobians(T @ step, landmark)
    S = innovation_covariances(H_pose, H_land, *predicted_blocks(P, frame, 3, 2), R)[0]

    draws = 20_000
    error = rng.multivariate_normal(np.zeros(5), P, draws)
    moved = rng.multivariate_normal(np.zeros(3), Q, draws)
    true = geometry.retract(geometry.retract(T, error[:, :3]) @ step, moved)
    z = sensor.predict(true, landmark + error[:, 3:]) + rng.multivariate_normal(np.zeros(2), R[0], draws)
    y = sensor.residual(z, np.broadcast_to(sensor.predict(T @ step, landmark), z.shape))
    np.testing.assert_allclose(np.cov(y.T), S, rtol=0.05, atol=0.05 * np.sqrt(S[0, 0] * S[1, 1]))


@pytest.mark.parametrize("probability", [0.9, 0.99])
def test_the_share_rejected_on_a_linear_problem_is_one_minus_the_probability(probability: float) -> None:
    """Known heading makes relative positions linear, so innovations are Gaussian with exactly S.

    The gate only watches here (every frame is handed on whole), or rejections would bias what follows.
    Innovations of different frames are independent; with one observation a frame the count is binomial,
    and must lie inside its central 99.9 %.
    """
    tested = rejected = 0
    for seed in range(8):
        stream = linear_stream(seed)
        back_end = make("ekf_slam", stream.problem)
        gate = OwnGate(back_end, stream.problem, probability)
        threshold = chdtri(2, 1 - probability)
        for frame in stream.frames:
            distances = gate._squared_distances(frame)
            tested += int((~np.isnan(distances)).sum())
            rejected += int((distances > threshold).sum())
            back_end.update(frame)
            gate._seen.update(frame.ids.tolist())
    assert tested == 8 * (200 - 5)
    assert bdtr(rejected, tested, 1 - probability) > 5e-4
    assert bdtrc(rejected - 1, tested, 1 - probability) > 5e-4


def linear_stream(seed: int) -> MeasurementStream:
    """200 frames of random steps without turning, one of five landmarks in turn at each."""
    rng = np.random.default_rng(seed)
    sensor = make_sensor("relative_position", {"space_dim": 2})
    world = rng.uniform(-10, 10, (5, 2))
    # The heading is known as well as rounding allows: a variance of 1e-20 leaves nothing nonlinear.
    P, Q = np.diag([0.01, 0.01, 1e-20]), np.diag([0.04, 0.01, 1e-20])
    R = np.array([[[0.02, 0.005], [0.005, 0.01]]])
    position = rng.multivariate_normal(np.zeros(2), P[:2, :2])
    frames = []
    for k in range(200):
        step = rng.normal(size=2) if k else np.zeros(2)
        position = position + step
        measured = step + (rng.multivariate_normal(np.zeros(2), Q[:2, :2]) if k else 0.0)
        z = world[k % 5] - position + rng.multivariate_normal(np.zeros(2), R[0])
        increment = geometry.se2(*measured, 0.0)
        frames.append(
            Frame(k, float(k), increment, Q if k else np.zeros((3, 3)), np.array([k % 5]), z[None], R)
        )
    return MeasurementStream(Problem(np.eye(3), P, sensor), tuple(frames))


@pytest.mark.parametrize(("name", "parameters"), NAMES)
def test_an_observation_twenty_sigma_off_is_dropped_as_if_it_had_never_been(
    name: str, parameters: dict[str, Any]
) -> None:
    stream, _, _ = toy_stream(frames=30)
    spoilt, cleaned = list(stream.frames), list(stream.frames)
    for k in (10, 20):
        frame = stream.frames[k]
        z = frame.z.copy()
        # Of S, not of R: at this range one sigma of the prediction is well below a metre.
        z[2, 0] += 20.0
        spoilt[k] = replace(frame, z=z)
        rest = np.arange(frame.ids.size) != 2
        cleaned[k] = replace(frame, ids=frame.ids[rest], z=frame.z[rest], R=frame.R[rest])
    gated = OwnGate(make(name, stream.problem, **parameters), stream.problem, 1 - 1e-12)
    plain = make(name, stream.problem, **parameters)
    for bad, good in zip(spoilt, cleaned, strict=True):
        gated.update(bad)
        plain.update(good)
        kept = gated.kept_observations()
        assert kept.size == bad.ids.size
        assert np.flatnonzero(~kept).tolist() == ([2] if bad.ids.size > good.ids.size else [])
        assert gated.diagnostics()["gate_rejected"] == bad.ids.size - good.ids.size
        assert np.array_equal(gated.estimate().T_world_body, plain.estimate().T_world_body)


@pytest.mark.parametrize("kind", ["mono", "stereo"])
@pytest.mark.parametrize("name", ["ekf_slam", "isam2"])
def test_cameras_in_space(name: str, kind: Kind) -> None:
    """A pixel fifty off is dropped and nothing else; entries pass with their frame."""
    stream, _ = camera_stream(kind, frames=12)
    gate = OwnGate(make(name, stream.problem), stream.problem, 1 - 1e-9)
    for frame in stream.frames:
        (known,) = np.nonzero(np.isin(frame.ids, [] if frame.k == 0 else gate.landmarks().ids))
        spoilt = known[:1] if frame.k % 3 == 2 else known[:0]
        z = frame.z.copy()
        z[spoilt, 0] += 50.0
        gate.update(replace(frame, z=z))
        assert np.flatnonzero(~gate.kept_observations()).tolist() == spoilt.tolist()
        assert gate.diagnostics()["gate_tested"] == known.size
        assert frame.entries is None or np.isin(frame.entries.ids, gate.landmarks().ids).all()


def test_new_landmarks_pass_untested() -> None:
    stream, _, _ = toy_stream(frames=2)
    gate = OwnGate(make("ekf_slam", stream.problem), stream.problem, 1e-9)
    gate.update(stream.frames[0])
    assert gate.kept_observations().all()
    assert gate.diagnostics()["gate_tested"] == 0
    known = np.isin(stream.frames[1].ids, stream.frames[0].ids)
    assert known.any()
    assert not known.all()
    gate.update(stream.frames[1])
    # Next to nothing passes so narrow a gate: what is kept was not tested.
    assert np.array_equal(gate.kept_observations(), ~known)


def test_it_is_a_smoother_only_where_its_back_end_is_one() -> None:
    stream, _, _ = toy_stream(frames=3)
    for name, smoother in (("ekf_slam", False), ("ekf_right_invariant", False), ("isam2", True)):
        gate = OwnGate(make(name, stream.problem), stream.problem, 0.99)
        assert isinstance(gate, Smoother) is smoother
        assert all(isinstance(gate, kind) for kind in (Mapper, JointEstimator, Diagnosed))
        assert isinstance(gate, SelfLinearising) is isinstance(make(name, stream.problem), SelfLinearising)


def test_a_back_end_without_a_joint_covariance_or_a_wrong_probability_is_refused() -> None:
    stream, _, _ = toy_stream(frames=2)
    with pytest.raises(UsageError, match=r"own_gate: FixedLag has no joint_covariance\(\)"):
        OwnGate(make("fixed_lag", stream.problem), stream.problem, 0.99)
    for probability in (0.0, 1.0, 1.5):
        with pytest.raises(UsageError, match=f"own_gate is {probability:g}"):
            OwnGate(make("ekf_slam", stream.problem), stream.problem, probability)


@pytest.mark.parametrize("name", ["ekf_slam", "isam2"])
def test_it_conforms(name: str, tmp_path: Path) -> None:
    """Whatever every back end must do; at 0.9999 chance rejects one observation of the bench's hundreds."""
    file = tmp_path / f"gated_{name}.py"
    file.write_text(
        "from slamcmp.backends.own_gate import OwnGate\n"
        "from slamcmp.registry import back_ends\n"
        "def gated(problem):\n"
        f"    return OwnGate(back_ends.get({name!r}).target(problem), problem, 0.9999)\n"
    )
    findings = check_back_end(f"{file}:gated")
    assert [finding for finding in findings if not finding.passed] == []
    assert len(findings) >= 15
