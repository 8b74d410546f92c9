"""The parts of the sliding window against dense algebra and central differences; then the whole."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from slamcmp import geometry
from slamcmp.backends.sights import Sights
from slamcmp.backends.window.cost import ObservationTerms, OdometryTerms, observation_terms, odometry_terms
from slamcmp.backends.window.gauss_newton import GaussNewtonStep
from slamcmp.backends.window.marginalisation import Prior, Quadratic
from slamcmp.backends.window.sliding_window import SlidingWindow
from slamcmp.errors import DivergedError, UsageError
from slamcmp.models.sensors import RangeBearing, RelativePosition
from slamcmp.types import TANGENT_DIM, Frame, MeasurementStream, Problem
from tests.backends.graph_streams import spatial_stream
from tests.toy_stream import toy_stream

POLICIES = ["latest", "fej", "frozen"]


def run(stream: MeasurementStream, **parameters: Any) -> SlidingWindow:
    window = SlidingWindow(stream.problem, **parameters)
    for frame in stream.frames:
        window.update(frame)
    return window


def random_poses(rng: np.random.Generator, count: int, n: int, spread: float = 1.0) -> np.ndarray:
    return geometry.exp(spread * rng.normal(size=(count, TANGENT_DIM[n])))


def central_difference(function: Any, size: int) -> np.ndarray:
    h = 1e-6
    return np.stack([(function(h * unit) - function(-h * unit)) / (2 * h) for unit in np.eye(size)], axis=-1)


def definite(rng: np.random.Generator, size: int) -> np.ndarray:
    square = rng.normal(size=(size, size))
    return square @ square.T + size * np.eye(size)


@pytest.mark.parametrize("n", [2, 3])
@pytest.mark.parametrize("poses", [1, 2, 3, 6])
def test_step_and_covariances_are_those_of_the_dense_normal_equations(poses: int, n: int) -> None:
    rng = np.random.default_rng(poses + n)
    p, landmarks, known, d = TANGENT_DIM[n], 5, 3, n
    prior = Quadratic(definite(rng, p + n * known), rng.normal(size=p + n * known), 7.0)
    odometry = OdometryTerms(
        rng.normal(size=(poses - 1, p, p)),
        rng.normal(size=(poses - 1, p, p)),
        rng.normal(size=(poses - 1, p)),
    )
    pairs = np.array([(k, j) for k in range(poses) for j in range(landmarks) if (k + j) % 2 or k == 0])
    pose_of, landmark_of = pairs.T
    terms = ObservationTerms(
        rng.normal(size=(len(pairs), d, p)),
        rng.normal(size=(len(pairs), d, n)),
        rng.normal(size=(len(pairs), d)),
    )
    step = GaussNewtonStep(prior, odometry, terms, pose_of, landmark_of, landmarks, n)

    states = poses * p + landmarks * n
    rows, values = [], []
    for k in range(poses - 1):
        row = np.zeros((p, states))
        row[:, k * p : (k + 1) * p] = odometry.A_prev[k]
        row[:, (k + 1) * p : (k + 2) * p] = odometry.A_next[k]
        rows.append(row)
        values.append(odometry.b[k])
    for i, (k, j) in enumerate(pairs):
        row = np.zeros((d, states))
        row[:, k * p : (k + 1) * p] = terms.H_pose[i]
        row[:, poses * p + j * n : poses * p + (j + 1) * n] = terms.H_land[i]
        rows.append(row)
        values.append(terms.b[i])
    A, b = np.concatenate(rows), np.concatenate(values)
    first = np.concatenate([np.arange(p), poses * p + np.arange(n * known)])
    Lam, eta = A.T @ A, -A.T @ b
    Lam[np.ix_(first, first)] += prior.Lam
    eta[first] += prior.eta
    P = np.linalg.inv(Lam)
    solution = P @ eta
    np.testing.assert_allclose(step.pose_step.ravel(), solution[: poses * p], atol=1e-11)
    np.testing.assert_allclose(step.landmark_step.ravel(), solution[poses * p :], atol=1e-11)
    own = np.arange(poses * p).reshape(poses, p)
    np.testing.assert_allclose(step.pose_covariances(), P[own[:, :, None], own[:, None, :]], atol=1e-12)
    np.testing.assert_allclose(step.first_pose_covariance(), P[:p, :p], atol=1e-12)
    head = np.concatenate([own[-1], np.arange(poses * p, states)])
    np.testing.assert_allclose(step.joint_covariance(), P[np.ix_(head, head)], atol=1e-12)
    np.testing.assert_allclose(step.last_pose_covariance(), P[np.ix_(own[-1], own[-1])], atol=1e-12)
    assert step.chi2 == pytest.approx(prior.c + b @ b - eta @ solution, rel=1e-11)


def test_a_quadratic_keeps_its_values_when_recentred_and_its_minimum_when_eliminated() -> None:
    rng = np.random.default_rng(4)
    quadratic = Quadratic(definite(rng, 6), rng.normal(size=6), 2.5)

    def value(of: Quadratic, delta: np.ndarray) -> float:
        return float(delta @ of.Lam @ delta - 2 * of.eta @ delta + of.c)

    step, delta = rng.normal(size=(2, 6))
    assert value(quadratic.recentred(step), delta - step) == pytest.approx(value(quadratic, delta), rel=1e-12)
    gone, kept = np.array([1, 4]), np.array([0, 2, 3, 5])
    # The Schur complement is the inverse of the covariance's block (FACTS: oracle identity 7).
    marginal = quadratic.eliminated(gone)
    P = np.linalg.inv(quadratic.Lam)
    np.testing.assert_allclose(np.linalg.inv(marginal.Lam), P[np.ix_(kept, kept)], atol=1e-13)
    mean = P @ quadratic.eta
    np.testing.assert_allclose(np.linalg.solve(marginal.Lam, marginal.eta), mean[kept], atol=1e-13)
    assert value(marginal, mean[kept]) == pytest.approx(value(quadratic, mean), rel=1e-12)


def test_what_nothing_determines_cannot_be_eliminated() -> None:
    with pytest.raises(DivergedError, match="not determined"):
        Quadratic(np.diag([1.0, 0.0]), np.zeros(2)).eliminated(np.array([1]))


@pytest.mark.parametrize("n", [2, 3])
def test_odometry_jacobians_are_central_differences(n: int) -> None:
    rng = np.random.default_rng(n)
    p = TANGENT_DIM[n]
    T = random_poses(rng, 2, n)
    increment = geometry.inverse(T[0]) @ T[1] @ geometry.exp(0.3 * rng.normal(size=p))
    W = np.linalg.cholesky(definite(rng, p)).T

    def residual(delta: np.ndarray) -> np.ndarray:
        moved = geometry.retract(T, delta.reshape(2, p))
        return W @ geometry.local(increment, geometry.inverse(moved[0]) @ moved[1])

    terms = odometry_terms(T, T, increment[None], W[None])
    expected = central_difference(residual, 2 * p)
    np.testing.assert_allclose(
        np.concatenate([terms.A_prev[0], terms.A_next[0]], axis=1), expected, atol=1e-7
    )
    np.testing.assert_allclose(terms.b[0], residual(np.zeros(2 * p)), atol=1e-12)


@pytest.mark.parametrize("n", [2, 3])
def test_prior_is_gaussian_in_position_and_turn_from_its_centre(n: int) -> None:
    """Value and gradient at another point are those of the Gaussian, its differences in the centre's axes."""
    rng = np.random.default_rng(n)
    p = TANGENT_DIM[n]
    centre, points = random_poses(rng, 1, n)[0], rng.normal(size=(2, n))
    prior = Prior(Quadratic(definite(rng, p + 2 * n), rng.normal(size=p + 2 * n), 1.0), centre, points)
    T, moved = geometry.retract(centre, 0.4 * rng.normal(size=p)), points + rng.normal(size=(2, n))

    def value(delta: np.ndarray) -> np.ndarray:
        relative = geometry.inverse(centre) @ geometry.retract(T, delta[:p])
        x = np.concatenate([position_and_turn(relative), (moved - points).ravel() + delta[p:]])
        q = prior.quadratic
        return np.array([x @ q.Lam @ x - 2 * q.eta @ x + q.c])

    linear = prior.linearised(T, moved)
    assert linear.c == pytest.approx(value(np.zeros(p + 2 * n))[0], rel=1e-10)
    gradient = central_difference(value, p + 2 * n)[0]
    np.testing.assert_allclose(-2 * linear.eta, gradient, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("n", [2, 3])
def test_prior_of_first_estimates_keeps_its_information_when_the_pose_moves(n: int) -> None:
    rng = np.random.default_rng(n)
    p = TANGENT_DIM[n]
    centre, T = random_poses(rng, 2, n)
    given, none = Quadratic(definite(rng, p), rng.normal(size=p)), np.empty((0, n))
    prior = Prior(given, centre, none, first_estimates=True)
    at_centre = prior.linearised(centre, none)
    np.testing.assert_allclose(at_centre.Lam, given.Lam, atol=1e-12)
    np.testing.assert_allclose(at_centre.eta, given.eta, atol=1e-12)
    back = geometry.change_of_axes(centre, T)
    elsewhere = prior.linearised(T, none).with_pose_error(back)
    np.testing.assert_allclose(elsewhere.Lam, given.Lam, atol=1e-11)
    moved = position_and_turn(geometry.inverse(centre) @ T)
    np.testing.assert_allclose(elsewhere.eta, given.eta - given.Lam @ moved, atol=1e-9)


def position_and_turn(T: np.ndarray) -> np.ndarray:
    """(p, log R) in the tangent's order."""
    if len(T) == 3:
        return geometry.se2_coordinates(T)
    return np.concatenate([geometry.so3_log(geometry.rotation(T)), geometry.translation(T)])


@pytest.mark.parametrize("sensor", [RangeBearing(), RelativePosition(), RelativePosition(space_dim=3)])
def test_first_estimates_keep_rigid_motions_of_the_world_invisible(sensor: Any) -> None:
    """A N = 0 at any mixture of points, N = the motions of the world at the points of the Jacobians."""
    rng = np.random.default_rng(8)
    n = sensor.space_dim
    T, at = random_poses(rng, 3, n), random_poses(rng, 3, n)
    points, points_at = rng.normal(size=(2, 4, n)) * 3
    increments = geometry.inverse(T[:-1]) @ T[1:]
    W = np.broadcast_to(np.eye(TANGENT_DIM[n]), (2, TANGENT_DIM[n], TANGENT_DIM[n]))
    odometry = odometry_terms(T, at, increments, W)
    pose_of, land_of = np.array([0, 0, 1, 2, 2]), np.array([0, 1, 2, 1, 3])
    z = sensor.predict(T[pose_of], points[land_of])
    Wz = np.broadcast_to(np.eye(n), (5, n, n))
    terms = observation_terms(
        Sights(sensor, sensor), T[pose_of], points[land_of], at[pose_of], points_at[land_of], z, Wz
    )

    pose_motions, point_motions = rigid_motions(T, at, points_at)
    seen = np.einsum("kij,kjg->kig", odometry.A_prev, pose_motions[:-1])
    seen += np.einsum("kij,kjg->kig", odometry.A_next, pose_motions[1:])
    np.testing.assert_allclose(seen, 0, atol=1e-12)
    seen = np.einsum("mij,mjg->mig", terms.H_pose, pose_motions[pose_of])
    seen += np.einsum("mij,mjg->mig", terms.H_land, point_motions[land_of])
    np.testing.assert_allclose(seen, 0, atol=1e-12)


def rigid_motions(T: np.ndarray, at: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Body-tangent errors (K, p, g) of the poses and (L, n, g) of the points under motions of the world."""
    n = points.shape[1]
    R_t = np.swapaxes(geometry.rotation(T), -1, -2)
    place = geometry.translation(at)
    eye = np.broadcast_to(np.eye(n), (len(points), n, n))
    if n == 2:
        J = np.array([[0.0, -1.0], [1.0, 0.0]])
        shift = np.concatenate([R_t, R_t @ (place @ J.T)[:, :, None]], axis=2)
        turn = np.tile([[[0.0, 0.0, 1.0]]], (len(T), 1, 1))
        return np.concatenate([shift, turn], axis=1), np.concatenate(
            [eye, (points @ J.T)[:, :, None]], axis=2
        )
    shift = np.concatenate([R_t, -R_t @ geometry.hat(place)], axis=2)
    turn = np.concatenate([np.zeros_like(R_t), R_t], axis=2)
    return np.concatenate([turn, shift], axis=1), np.concatenate([eye, -geometry.hat(points)], axis=2)


@pytest.mark.parametrize("window", [1, 3])
def test_a_dropped_landmark_is_a_kept_one_that_comes_back_under_another_name(window: int) -> None:
    """With frozen linear forms dropping is exact: a landmark without further measurements says nothing."""
    stream, _, _ = toy_stream(frames=60, landmarks=14, seed=5, seen_at_once=3)
    dropping = SlidingWindow(
        stream.problem, window=window, iterations=1, linearisation="frozen", landmarks="drop_unseen"
    )
    keeping = SlidingWindow(stream.problem, window=window, iterations=1, linearisation="frozen")
    names: dict[int, int] = {}
    renamed, sizes = 0, []
    for frame in stream.frames:
        for landmark in frame.ids.tolist():
            # What the dropping window no longer holds joins the keeping one as somebody new.
            recent = stream.frames[max(0, frame.k - window) : frame.k]
            if not any(landmark in other.ids for other in recent):
                renamed += 1
                names[landmark] = 100 + renamed
        alias = np.array([names[landmark] for landmark in frame.ids.tolist()])
        dropping.update(frame)
        keeping.update(Frame(frame.k, frame.t, frame.T_prev_body, frame.Q, alias, frame.z, frame.R))
        a, b = dropping.estimate(), keeping.estimate()
        np.testing.assert_allclose(a.T_world_body, b.T_world_body, atol=1e-10)
        np.testing.assert_allclose(a.P, b.P, atol=1e-10)
        sizes.append(dropping.landmarks().ids.size)
    assert renamed > 30
    assert max(sizes) <= 3 * (window + 1)
    assert keeping.landmarks().ids.size == renamed


@pytest.mark.parametrize("window", [1, 4, 200])
def test_trajectory_holds_each_pose_as_it_left_the_window(window: int) -> None:
    stream, _, _ = toy_stream(frames=40)
    smoother = SlidingWindow(stream.problem, window=window)
    snapshots = []
    for frame in stream.frames:
        smoother.update(frame)
        snapshots.append(smoother.trajectory())
    final = snapshots[-1]
    assert final.P is not None
    for k in range(40):
        left = snapshots[min(k + window - 1, 39)]
        np.testing.assert_array_equal(final.T_world_body[k], left.T_world_body[k])
        assert left.P is not None
        np.testing.assert_allclose(final.P[k], left.P[k], rtol=1e-9, atol=1e-15)
    np.testing.assert_array_equal(final.t, [frame.t for frame in stream.frames])


@pytest.mark.parametrize("policy", POLICIES)
def test_moving_the_whole_world_moves_the_estimate_with_it(policy: str) -> None:
    stream, _, _ = toy_stream(frames=40, prior_sigma=0.1)
    G = geometry.se2(30.0, -20.0, 2.0)
    problem = Problem(G @ stream.problem.T_world_body, stream.problem.P, stream.problem.sensor)
    moved = run(MeasurementStream(problem, stream.frames), window=5, linearisation=policy, iterations=3)
    here = run(stream, window=5, linearisation=policy, iterations=3)
    np.testing.assert_allclose(
        moved.estimate().T_world_body, G @ here.estimate().T_world_body, rtol=0, atol=1e-9
    )
    np.testing.assert_allclose(moved.estimate().P, here.estimate().P, rtol=1e-8, atol=1e-10)
    there = geometry.transform(G, here.landmarks().positions)
    np.testing.assert_allclose(moved.landmarks().positions, there, rtol=0, atol=1e-9)


def test_iterations_end_at_the_tolerance() -> None:
    stream, _, _ = toy_stream(frames=10)
    loose = run(stream, window=5, iterations=50, tolerance=1e-3).diagnostics()
    tight = run(stream, window=5, iterations=50, tolerance=1e-12).diagnostics()
    assert loose["last_step"] < 1e-3
    assert tight["last_step"] < 1e-12
    assert loose["iterations"] < tight["iterations"] < 50


@pytest.mark.parametrize("seed", [5, 9])
def test_steps_that_would_raise_the_cost_are_halved(monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    """Pinned Jacobians far off the estimate: whole steps lead away by kilometres, halved ones stay near."""
    stream, truth, _ = toy_stream(frames=60, noise=3.0, heading_sigma=0.05, seen_at_once=1, seed=seed)

    def worst_error() -> float:
        window, worst = SlidingWindow(stream.problem, window=3, iterations=5, linearisation="fej"), 0.0
        for frame, T in zip(stream.frames, truth, strict=True):
            try:
                window.update(frame)
            except DivergedError:
                return float("inf")
            worst = max(worst, float(np.linalg.norm((window.estimate().T_world_body - T)[:2, 2])))
        return worst

    assert worst_error() < 10.0
    monkeypatch.setattr(SlidingWindow, "_share_of", lambda self, step, share: 1.0)
    assert worst_error() > 1000.0


def test_degrees_of_freedom_count_rows_minus_unknowns() -> None:
    """Forty frames of five planar sightings of twelve landmarks: 400 numbers for 24 coordinates."""
    stream, _, _ = toy_stream(frames=40)
    assert run(stream, window=7).diagnostics()["dof"] == 400 - 24


def test_chi_square_of_full_smoothing_in_space_has_its_expectation() -> None:
    """Chi-square per degree of freedom of a correct model is one, within 3 sigma."""
    smoother = run(spatial_stream(frames=30)[0], window=None, iterations=20)
    chi2, dof = smoother.diagnostics()["chi2"], smoother.diagnostics()["dof"]
    assert abs(chi2 / dof - 1) < 3 * np.sqrt(2 / dof)


@pytest.mark.parametrize("policy", POLICIES)
def test_a_spoilt_measurement_is_reported_as_divergence(policy: str) -> None:
    stream, _, _ = toy_stream(frames=6)
    smoother = SlidingWindow(stream.problem, window=3, linearisation=policy)
    for frame in stream.frames[:5]:
        smoother.update(frame)
    last = stream.frames[5]
    z = last.z.copy()
    z[0, 0] = np.nan
    spoilt = Frame(last.k, last.t, last.T_prev_body, last.Q, last.ids, z, last.R)
    with pytest.raises(DivergedError, match="not positive definite, or not finite"):
        smoother.update(spoilt)


def test_singular_noise_is_refused_with_the_reason() -> None:
    stream, _, _ = toy_stream(frames=3)
    problem = Problem(stream.problem.T_world_body, np.zeros((3, 3)), stream.problem.sensor)
    with pytest.raises(UsageError, match=r"the prior covariance .* is singular"):
        SlidingWindow(problem)
    smoother = SlidingWindow(stream.problem)
    smoother.update(stream.frames[0])
    frame = stream.frames[1]
    with pytest.raises(UsageError, match=r"Q of frame 1 is singular"):
        smoother.update(
            Frame(1, frame.t, frame.T_prev_body, np.diag([1.0, 0, 1]), frame.ids, frame.z, frame.R)
        )


def test_a_frame_is_the_three_steps_and_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each by its name; a pose leaves with the last solve's Jacobians, so before the frame's own."""
    stream, _, _ = toy_stream(frames=4)
    window = SlidingWindow(stream.problem, window=2)
    done: list[str] = []
    for name in ("construct", "marginalise", "solve"):
        step = getattr(SlidingWindow, name)

        def told(self: SlidingWindow, *frame: Frame, name: str = name, step: Any = step) -> None:
            done.append(name)
            step(self, *frame)

        monkeypatch.setattr(SlidingWindow, name, told)
    for frame in stream.frames:
        window.update(frame)
        assert done[-3:] == ["construct", "marginalise", "solve"]
    assert len(done) == 12


@pytest.mark.parametrize("iterations", [2, 30])
def test_chi_square_is_that_of_the_residuals_at_the_estimate(iterations: int) -> None:
    """Against the sum written out, also where iterations were cut short: then the linear cost is another."""
    stream, _, _ = toy_stream(frames=12, noise=8.0, prior_sigma=0.1)
    problem, window = stream.problem, run(stream, window=None, iterations=iterations)
    poses, landmarks = window.trajectory().T_world_body, window.landmarks()
    place = dict(zip(landmarks.ids.tolist(), landmarks.positions, strict=True))
    first = geometry.local(problem.T_world_body, poses[0])
    # The prior's error is additive: position in the prior's axes, and heading.
    first[:2] = problem.T_world_body[:2, :2].T @ (poses[0] - problem.T_world_body)[:2, 2]
    chi2 = first @ np.linalg.solve(problem.P, first)
    for frame, T in zip(stream.frames, poses, strict=True):
        if frame.k:
            e = geometry.local(frame.T_prev_body, geometry.inverse(poses[frame.k - 1]) @ T)
            chi2 += e @ np.linalg.solve(frame.Q, e)
        for landmark, z, R in zip(frame.ids.tolist(), frame.z, frame.R, strict=True):
            e = problem.sensor.residual(z, problem.sensor.predict(T, place[landmark]))
            chi2 += e @ np.linalg.solve(R, e)
    told = window.diagnostics()
    assert told["chi2"] == pytest.approx(chi2, rel=1e-9)
    linear_is_another = abs(window._solution.step.chi2 / chi2 - 1.0) > 1e-6
    assert linear_is_another == (iterations == 2)
