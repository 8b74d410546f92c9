"""A filter's robust update is the minimum of prior plus kernels: against GTSAM, the window, and itself."""

from __future__ import annotations

from typing import Any

import gtsam
import numpy as np
import pytest
from gtsam import noiseModel

from slamcmp.backends.filters.covariances.covariance import JointCovariance, block_diagonal
from slamcmp.backends.filters.covariances.error_covariance import ErrorCovariance
from slamcmp.backends.filters.ekf_slam import EkfSlam
from slamcmp.backends.filters.iterated import IteratedEkf
from slamcmp.backends.filters.msckf import Msckf
from slamcmp.backends.filters.robocentric import RobocentricEkf
from slamcmp.backends.filters.ukf import UkfSlam
from slamcmp.backends.filters.variants import (
    FirstEstimatesEkf,
    ObservabilityConstrainedEkf,
    RightInvariantEkf,
    WorldEkf,
)
from slamcmp.backends.gtsam_smoothers.robust_factors import robust_noise
from slamcmp.backends.robust import WIDTHS, Kernel
from slamcmp.backends.window.sliding_window import SlidingWindow
from slamcmp.errors import UsageError
from slamcmp.types import MeasurementStream
from tests.backends.spoilt import ghosts, spoilt, with_noise
from tests.toy_stream import toy_stream

FILTERS = [
    EkfSlam,
    WorldEkf,
    FirstEstimatesEkf,
    ObservabilityConstrainedEkf,
    RightInvariantEkf,
    RobocentricEkf,
    IteratedEkf,
    UkfSlam,
]


def run(back_end: Any, stream: MeasurementStream) -> Any:
    for frame in stream.frames:
        back_end.update(frame)
    return back_end


@pytest.mark.parametrize("name", sorted(WIDTHS))
def test_linear_update_is_gtsams_robust_optimum(name: str) -> None:
    """A point with a prior, seen eight times, twice wrongly: mean and covariance to rounding."""
    rng = np.random.default_rng(4)
    P = np.array([[0.8, 0.3], [0.3, 0.5]])
    x0 = np.array([1.0, -2.0])
    R = np.array([[[0.04, 0.01 * (-1) ** i], [0.01 * (-1) ** i, 0.09]] for i in range(8)])
    z = np.einsum("mij,mj->mi", np.linalg.cholesky(R), rng.standard_normal((8, 2)))
    z += x0 + np.array([0.3, -0.2])
    z[2] += [2.5, 0.0]
    z[5] += [-4.0, 3.0]

    covariance = ErrorCovariance(JointCovariance(P), 2)
    covariance.make_robust(Kernel(name, WIDTHS[name]), 2)
    H = np.tile(np.eye(2), (8, 1))
    dx = covariance.observe(np.arange(2), H, block_diagonal(R), (z - x0).ravel())

    graph, wrap = gtsam.NonlinearFactorGraph(), robust_noise(Kernel(name, WIDTHS[name]))
    graph.add(gtsam.PriorFactorPoint2(0, x0, noiseModel.Gaussian.Covariance(P)))
    for zi, Ri in zip(z, R, strict=True):
        graph.add(gtsam.PriorFactorPoint2(0, zi, wrap(noiseModel.Gaussian.Covariance(Ri))))
    values = gtsam.Values()
    values.insert(0, x0 + np.array([0.3, -0.2]))
    parameters = gtsam.GaussNewtonParams()
    parameters.setMaxIterations(500)
    parameters.setRelativeErrorTol(0.0)
    parameters.setAbsoluteErrorTol(0.0)
    best = gtsam.GaussNewtonOptimizer(graph, values, parameters).optimize()
    np.testing.assert_allclose(x0 + dx, best.atPoint2(0), atol=1e-9)
    np.testing.assert_allclose(
        covariance.dense(), gtsam.Marginals(graph, best).marginalCovariance(0), rtol=1e-7
    )
    assert covariance.weights is not None
    assert (covariance.weights[[2, 5]] < 0.35).all()
    assert (np.delete(covariance.weights, [2, 5]) > 0.5).all()


@pytest.mark.parametrize("name", sorted(WIDTHS))
@pytest.mark.parametrize("kind", [*FILTERS, Msckf])
def test_a_wide_kernel_is_none_to_the_last_bit(kind: Any, name: str, plain_filters: None) -> None:
    if kind not in (EkfSlam, UkfSlam, Msckf) and name not in ("huber", "gnc"):
        pytest.skip("the kernel's part is the same code")
    stream, _, _ = toy_stream(frames=15)
    plain, robust = (
        run(kind(stream.problem), stream),
        run(kind(stream.problem, robust=name, robust_width=1e9), stream),
    )
    np.testing.assert_array_equal(robust.estimate().T_world_body, plain.estimate().T_world_body)
    np.testing.assert_array_equal(robust.estimate().P, plain.estimate().P)
    np.testing.assert_array_equal(robust.landmarks().positions, plain.landmarks().positions)
    told = robust.diagnostics()
    assert told["smallest_weight"] == 1.0
    assert told["downweighted"] == 0
    assert {key: told[key] for key in plain.diagnostics()} == plain.diagnostics()


@pytest.mark.parametrize("name", ["huber", "gnc"])
def test_ekf_is_the_robust_window_of_one_pose(name: str) -> None:
    """Two programs, covariance and information form, with ghosts and landmarks that start from ghosts."""
    clean, _, _ = toy_stream(frames=30, landmarks=9, seen_at_once=6, seed=1)
    stream = ghosts(clean, 0.2, seed=5)
    ekf = EkfSlam(stream.problem, robust=name)
    window = SlidingWindow(
        stream.problem, window=1, iterations=100, tolerance=1e-11, linearisation="frozen", robust=name
    )
    restarted = 0
    for frame in stream.frames:
        ekf.update(frame)
        window.update(frame)
        restarted += int(ekf.diagnostics()["restarted"])
        assert window.diagnostics()["restarted"] == ekf.diagnostics()["restarted"]
        np.testing.assert_allclose(window.estimate().T_world_body, ekf.estimate().T_world_body, atol=1e-6)
        np.testing.assert_allclose(window.joint_covariance(), ekf.joint_covariance(), atol=1e-6)
    assert restarted > 0


@pytest.mark.parametrize("kind", FILTERS[1:])
def test_listeners_hear_of_the_noise_with_its_weights(kind: Any) -> None:
    """RTS with a kernel is RTS without one on the noise that the kernel made of it."""
    clean, _, _ = toy_stream(frames=25, landmarks=6, seed=2)
    stream = spoilt(
        clean, {(12, 1): clean.frames[12].z[1] + [1.5, 0.2], (20, 3): clean.frames[20].z[3] - 1.0}
    )
    robust = kind(stream.problem, smooth=True, robust="huber")
    weights = {}
    for frame in stream.frames:
        known = [i for i, name in enumerate(frame.ids.tolist()) if name in robust._number]
        robust.update(frame)
        weights[frame.k] = np.ones(frame.ids.size)
        if known:
            weights[frame.k][known] = robust._P.weights
    assert max(weights[12][1], weights[20][3]) < 0.3
    plain = kind(with_noise(stream, lambda f: f.R).problem, smooth=True)
    run(plain, with_noise(stream, lambda f: f.R / weights[f.k][:, None, None]))
    ours, theirs = robust.trajectory(), plain.trajectory()
    np.testing.assert_allclose(ours.T_world_body, theirs.T_world_body, atol=1e-9)
    np.testing.assert_allclose(ours.P, theirs.P, atol=1e-11)


@pytest.mark.parametrize("kind", [EkfSlam, UkfSlam, RobocentricEkf])
def test_nis_stays_nominal_and_the_outlier_is_told(kind: Any) -> None:
    clean, _, _ = toy_stream(frames=20, landmarks=6, seed=2)
    stream = spoilt(clean, {(19, 1): clean.frames[19].z[1] + [3.0, 0.0]})
    plain, robust = kind(stream.problem), kind(stream.problem, robust="huber", robust_width=6.0)
    for frame in stream.frames:
        plain.update(frame)
        robust.update(frame)
    told = robust.diagnostics()
    assert told["nis"] == pytest.approx(plain.diagnostics()["nis"], rel=1e-9)
    assert told["nis_dof"] == plain.diagnostics()["nis_dof"]
    assert told["nis"] > 100
    assert told["downweighted"] == 1
    assert told["smallest_weight"] < 0.4


@pytest.mark.parametrize("kind", [*FILTERS, Msckf])
@pytest.mark.parametrize("name", ["huber", "gnc"])
def test_a_fifth_of_ghosts_costs_less_than_without_kernel(kind: Any, name: str) -> None:
    """The stream with 20 % ghosts: near the clean run's pose, where without a kernel it is metres off."""
    clean, truth, _ = toy_stream(frames=40, landmarks=10, seen_at_once=6, seed=3)
    stream = ghosts(clean, 0.2, seed=8)

    def error(stream: MeasurementStream, **parameters: Any) -> float:
        back_end, squares = kind(stream.problem, **parameters), []
        for frame, T in zip(stream.frames, truth, strict=True):
            back_end.update(frame)
            squares.append(((back_end.estimate().T_world_body - T)[:2, 2] ** 2).sum())
        return float(np.sqrt(np.mean(squares)))

    robust = error(stream, robust=name)
    assert robust < 2.0 * error(clean, robust=name)
    if kind is EkfSlam:
        assert error(stream) > 5.0 * robust


def test_postponed_updates_take_no_kernel() -> None:
    stream, _, _ = toy_stream(frames=2)
    with pytest.raises(UsageError, match=r"active_landmarks .* robust"):
        EkfSlam(stream.problem, active_landmarks=5, robust="huber")
