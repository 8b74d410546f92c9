"""The properties that ``slamcmp check`` looks for, one function each.

A check answers with what it saw, with None where the property does not apply, or raises
:class:`CheckFailedError` with the likely cause: most faults of a first EKF-SLAM have a signature (a
covariance in world axes, an update that looks ahead, an innovation that is not wrapped).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from slamcmp.experiment.conformance.bench import Bench, blind, feed, reckoned, run
from slamcmp.experiment.conformance.causes import cause
from slamcmp.experiment.conformance.outcomes import SEEDS, SETTLED, Band, chi2_band, outcomes, spread_band
from slamcmp.experiment.job.collected import first_fault
from slamcmp.geometry import adjoint_of_inverse, local
from slamcmp.protocols import Diagnosed, JointEstimator, Mapper, Smoother
from slamcmp.types import Estimate, FloatArray, GroundTruth, Landmarks, MeasurementStream, Trajectory

LOOP_SHARE = 0.5
"""Most of dead reckoning's error that an estimator which closes loops may keep."""

OPEN_SHARE = 0.8
"""The same for one that does not (trait ``closes_loops=False``): its error still grows with the path. Batch
estimation on the tracks of the MSCKF, each sight of a landmark a new landmark, keeps 0.66 here."""


class CheckFailedError(Exception):
    """A property does not hold; the text says what was seen and the likely cause."""


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise CheckFailedError(message)


def check_shapes(bench: Bench) -> str:
    """answers with an Estimate of finite numbers after every frame"""
    for frame, estimate in feed(bench, bench.stream):
        _require(
            isinstance(estimate, Estimate),
            f"estimate() returned {type(estimate).__name__}; return slamcmp.types.Estimate(T_world_body, P)",
        )
        _require(
            estimate.T_world_body.shape == frame.T_prev_body.shape,
            f"T_world_body is {estimate.T_world_body.shape} where {frame.T_prev_body.shape} is needed",
        )
        p = bench.stream.problem.P.shape[0]
        _require(
            estimate.P.shape == (p, p),
            f"P is {estimate.P.shape} where {(p, p)} is needed: the pose's part of the joint covariance",
        )
        _require(
            bool(np.isfinite(estimate.T_world_body).all() and np.isfinite(estimate.P).all()),
            f"frame {frame.k}: not finite; look for a division by a range of 0 or the inverse "
            "of a singular S",
        )
    return f"{len(bench.stream.frames)} frames"


def check_rigid(bench: Bench) -> str:
    """keeps T_world_body a rigid transform"""
    worst = 0.0
    for frame, estimate in feed(bench, bench.stream):
        worst = max(worst, _require_rigid(estimate.T_world_body, f"frame {frame.k}"))
    return f"R^T R within {worst:.1g} of the identity"


def _require_rigid(T: FloatArray, where: str) -> float:
    """How far R^T R is off the identity."""
    R = T[:-1, :-1]
    off = float(np.abs(R.T @ R - np.eye(len(R))).max())
    _require(
        off < 1e-6 and float(np.linalg.det(R)) > 0,
        f"{where}: R^T R is off the identity by {off:.2g}, det R is {np.linalg.det(R):.3g}; build the matrix "
        "from the heading",
    )
    last_row = np.append(np.zeros(len(R)), 1.0)
    _require(
        bool(np.allclose(T[-1], last_row)), f"{where}: the last row is {T[-1]} where {last_row} is needed"
    )
    return off


def check_covariance(bench: Bench) -> str:
    """keeps P symmetric and positive definite"""
    smallest = np.inf
    for frame, estimate in feed(bench, bench.stream):
        P = estimate.P
        asymmetry = float(np.abs(P - P.T).max() / np.abs(P).max())
        _require(
            asymmetry < 1e-9,
            f"frame {frame.k}: P is not symmetric (relative {asymmetry:.2g}); average it with its transpose",
        )
        low = float(np.linalg.eigvalsh(P)[0])
        _require(
            low > 0,
            f"frame {frame.k}: smallest eigenvalue of P is {low:.3g}; "
            "the update subtracts more than there is: check the signs and H",
        )
        smallest = min(smallest, low)
    return f"smallest eigenvalue {smallest:.2g}"


def check_prior(bench: Bench) -> str:
    """starts at the prior"""
    stream = blind(bench.stream)
    estimate = next(feed(bench, stream))[1]
    shift = float(np.abs(local(stream.problem.T_world_body, estimate.T_world_body)).max())
    _require(
        shift < 1e-9,
        f"after frame 0 without observations the pose is {shift:.2g} from the prior; "
        "frame 0 carries no motion",
    )
    scale = np.abs(stream.problem.P).max()
    off = float(np.abs(estimate.P - stream.problem.P).max() / scale)
    _require(off < 1e-6, f"after frame 0 P differs from the prior's by {off:.2g} of its size")
    return "pose and covariance"


def check_odometry(bench: Bench) -> str:
    """follows odometry alone exactly"""
    stream = blind(bench.stream)
    poses, _ = run(bench, stream)
    off = np.abs(poses - reckoned(stream)).max(axis=(1, 2))
    first = int(np.argmax(off > 1e-6))
    _require(
        bool(off.max() <= 1e-6),
        f"frame {first}: {off.max():.2g} from dead reckoning; the new pose is T_world_body @ T_prev_body",
    )
    return f"within {off.max():.1g}"


def check_chart(bench: Bench) -> str:
    """reports P in the body tangent, order (x, y, heading)"""
    stream = blind(bench.stream)
    # With the estimate itself for a truth, Jacobians at the truth obey the closed form too.
    truth = GroundTruth(bench.truth.t, reckoned(stream), bench.truth.ids, bench.truth.positions)
    poses, covariances = run(bench, stream, truth)
    P = stream.problem.P
    for frame, T, reported in zip(stream.frames, poses, covariances, strict=True):
        if frame.k:
            A = adjoint_of_inverse(frame.T_prev_body)
            P = A @ P @ A.T + frame.Q
        off = float(np.abs(reported - P).max() / np.abs(P).max())
        if off < 0.02:
            continue
        turn = np.eye(len(P))
        turn[:2, :2] = T[:2, :2]
        order = [2, 0, 1]
        if np.allclose(reported, turn @ P @ turn.T, rtol=0.02, atol=1e-3 * np.abs(P).max()):
            cause = "it is in world axes: turn its position rows and columns by R^T"
        elif len(P) == 3 and np.allclose(
            reported, P[np.ix_(order, order)], rtol=0.02, atol=1e-3 * np.abs(P).max()
        ):
            cause = "its order is (heading, x, y)"
        else:
            cause = "predict it as P = A P A^T + Q with A = Ad(T_prev_body^-1); not A^T P A"
        raise CheckFailedError(f"frame {frame.k}: P is off by {100 * off:.0f} %; {cause}")
    return "against the closed form on odometry alone"


def check_deterministic(bench: Bench) -> str:
    """gives the same answer twice"""
    first, second = run(bench, bench.stream), run(bench, bench.stream)
    same = np.array_equal(first[0], second[0]) and np.array_equal(first[1], second[1])
    _require(same, "two runs differ: unseeded random numbers, or state kept outside the instance")
    return "bit for bit"


def check_causal(bench: Bench) -> str:
    """does not let the future change the past"""
    half = len(bench.stream.frames) // 2
    other, _ = bench.world(seed=1)
    mixed = MeasurementStream(
        bench.stream.problem, bench.stream.frames[:half] + other.frames[half : len(bench.stream.frames)]
    )
    poses, covariances = run(bench, bench.stream)
    mixed_poses, mixed_covariances = run(bench, mixed)
    _require(
        np.array_equal(poses[:half], mixed_poses[:half])
        and np.array_equal(covariances[:half], mixed_covariances[:half]),
        f"estimates before frame {half} change when only later frames change",
    )
    _require(
        not np.array_equal(poses[half:], mixed_poses[half:]),
        f"estimates after frame {half} do not change when the frames do: update() ignores its frame",
    )
    return f"the first {half} frames do not depend on the rest"


def check_estimate_is_pure(bench: Bench) -> str:
    """may be asked any number of times"""
    often, rarely = bench.new(bench.stream), bench.new(bench.stream)
    for frame in bench.stream.frames:
        often.update(frame)
        rarely.update(frame)
        one, two = often.estimate(), often.estimate()
        same = np.array_equal(one.T_world_body, two.T_world_body) and np.array_equal(one.P, two.P)
        _require(same, f"frame {frame.k}: a second estimate() differs from the first")
    last = rarely.estimate()
    off = float(np.abs(local(last.T_world_body, often.estimate().T_world_body)).max())
    _require(
        off < 1e-9, f"asking for estimates changes later ones by {off:.2g}; estimate() must not change state"
    )
    return "estimate() changes nothing"


def check_accuracy(bench: Bench) -> str:
    """uses its observations"""
    found = outcomes(bench)
    share = LOOP_SHARE if bench.closes_loops else OPEN_SHARE
    # The mean tells of the few runs that are lost, the median does not.
    for name, average in (("mean", np.mean), ("median", np.median)):
        error = float(average([outcome.error_m for outcome in found]))
        guess = float(average([outcome.reckoned_m for outcome in found]))
        if not error < share * guess:
            why = cause(bench)
            if not why.startswith("cause: "):
                why = (
                    "typical causes: a bearing innovation that is not wrapped, a wrong sign in H, landmarks "
                    "confused"
                )
            raise CheckFailedError(
                f"{name} final error over {SEEDS} seeds is {error:.3f} m, dead reckoning's {guess:.3f} m; "
                f"{why}"
            )
    return f"median final error {error:.3f} m, dead reckoning {guess:.3f} m"


def check_consistency(bench: Bench) -> str:
    """reports a covariance that fits its errors"""
    found, dimension = outcomes(bench), bench.stream.problem.P.shape[0]
    last = np.array([outcome.nees[-1] for outcome in found])
    all_along = np.array([outcome.nees[SETTLED:].mean() for outcome in found])
    told = [
        _require_inside(bench, "mean NEES at the last frame", last, dimension, chi2_band(dimension, SEEDS)),
        _require_inside(
            bench, "mean NEES over the frames", all_along, dimension, spread_band(dimension, all_along)
        ),
    ]
    return "; ".join(told)


def check_map_consistency(bench: Bench) -> str | None:
    """reports landmark covariances that fit their errors"""
    values = np.array([outcome.map_nees for outcome in outcomes(bench)])
    if np.isnan(values).all():
        return None
    n = bench.stream.problem.sensor.space_dim
    return _require_inside(bench, "mean NEES of the landmarks", values, n, spread_band(n, values))


def check_joint_consistency(bench: Bench) -> str | None:
    """reports a joint covariance that fits pose and map together"""
    found = outcomes(bench)
    values = np.array([outcome.joint_nees for outcome in found])
    if np.isnan(values).all():
        return None
    dimension = float(np.mean([outcome.joint_dim for outcome in found]))
    band = chi2_band(dimension, SEEDS)
    return _require_inside(bench, "mean NEES of pose and map together", values, dimension, band)


def _require_inside(bench: Bench, what: str, values: FloatArray, expected: float, band: Band) -> str:
    mean = float(values.mean())
    told = f"{what} is {mean:.2f} over {SEEDS} seeds, expected {expected:.3g} ({band})"
    if not band.low < mean < band.high:
        kind = "pessimistic" if mean <= band.low else "overconfident"
        raise CheckFailedError(f"{told}: {kind}; {cause(bench)}")
    return f"{what} {mean:.2f} over {SEEDS} seeds, expected {expected:.3g}"


def check_landmarks(bench: Bench) -> str | None:
    """maps every landmark it was shown"""
    back_end = bench.new(bench.stream)
    if not isinstance(back_end, Mapper):
        return None
    seen: set[int] = set()
    for frame in bench.stream.frames:
        back_end.update(frame)
        seen |= set(frame.ids.tolist())
    landmarks = back_end.landmarks()
    _require(
        isinstance(landmarks, Landmarks),
        f"landmarks() returned {type(landmarks).__name__}; return slamcmp.types.Landmarks",
    )
    unknown = set(landmarks.ids.tolist()) ^ seen
    _require(not unknown, f"landmark ids differ from those observed: {sorted(unknown)[:5]}")
    blocks = landmarks.covariances
    _require(
        bool(np.isfinite(landmarks.positions).all() and np.isfinite(blocks).all()),
        "a landmark's position or covariance block is not finite",
    )
    skew = float(np.abs(blocks - np.swapaxes(blocks, 1, 2)).max() / np.abs(blocks).max())
    _require(skew < 1e-9, f"a landmark's covariance block is not symmetric (relative {skew:.2g})")
    eigenvalues = np.linalg.eigvalsh(blocks)
    _require(bool((eigenvalues > 0).all()), "a landmark's covariance block is not positive definite")
    index = {landmark: row for row, landmark in enumerate(bench.truth.ids.tolist())}
    true = bench.truth.positions[[index[landmark] for landmark in landmarks.ids.tolist()]]
    error = np.linalg.norm(landmarks.positions - true, axis=1)
    sigma = np.sqrt(np.trace(landmarks.covariances, axis1=1, axis2=2))
    worst = float((error / sigma).max())
    _require(
        worst < 10, f"a landmark is {worst:.0f} of its own sigmas from the truth; are positions in the world?"
    )
    return f"{landmarks.ids.size} landmarks"


def check_joint(bench: Bench) -> str | None:
    """has blocks in its joint covariance that agree with its other answers"""
    back_end = bench.new(bench.stream)
    if not isinstance(back_end, JointEstimator):
        return None
    for frame in bench.stream.frames:
        back_end.update(frame)
    joint, P, landmarks = back_end.joint_covariance(), back_end.estimate().P, back_end.landmarks()
    p, n = len(P), landmarks.positions.shape[1]
    size = p + n * landmarks.ids.size
    _require(joint.shape == (size, size), f"joint_covariance() is {joint.shape}; {(size, size)} is needed")
    scale = np.abs(joint).max()
    blocks = np.stack([joint[i : i + n, i : i + n] for i in range(p, size, n)])
    _require(np.allclose(joint[:p, :p], P, atol=1e-6 * scale), "its pose block is not estimate().P")
    _require(
        np.allclose(blocks, landmarks.covariances, atol=1e-6 * scale),
        "its landmark blocks are not those of landmarks(); the order is that of landmarks().ids",
    )
    # NEES expects the same of blocks without their correlation.
    correlated = np.abs(joint[:p, p:]).max(initial=0.0) > 1e-9 * scale
    _require(correlated, "pose and map are uncorrelated in it, though the map was placed from the poses")
    _require(np.abs(joint - joint.T).max() < 1e-9 * scale, "it is not symmetric")
    low = float(np.linalg.eigvalsh(joint)[0])
    _require(low > -1e-9 * scale, f"it is indefinite: smallest eigenvalue {low:.2g}")
    return f"{size} x {size}"


def check_trajectory(bench: Bench) -> str | None:
    """revises every pose of the past"""
    back_end = bench.new(bench.stream)
    if not isinstance(back_end, Smoother):
        return None
    for frame in bench.stream.frames:
        back_end.update(frame)
    trajectory = back_end.trajectory()
    _require(
        isinstance(trajectory, Trajectory),
        f"trajectory() returned {type(trajectory).__name__}; return slamcmp.types.Trajectory",
    )
    stamps = np.array([frame.t for frame in bench.stream.frames])
    _require(np.array_equal(trajectory.t, stamps), "its time stamps are not those of the frames")
    shape = bench.stream.problem.T_world_body.shape
    have = trajectory.T_world_body.shape[1:]
    _require(have == shape, f"its poses are {have} where {shape} is needed")
    _require(bool(np.isfinite(trajectory.T_world_body).all()), "it holds numbers that are not finite")
    for k, T in enumerate(trajectory.T_world_body):
        _require_rigid(T, f"frame {k}")
    if trajectory.P is not None:
        fault = first_fault(trajectory.T_world_body, trajectory.P)
        _require(fault is None, "" if fault is None else f"frame {fault[0]}: {fault[1]}")
    return f"{stamps.size} poses"


def check_diagnostics(bench: Bench) -> str | None:
    """tells its diagnostics as numbers by name"""
    back_end = bench.new(bench.stream)
    if not isinstance(back_end, Diagnosed):
        return None
    back_end.update(bench.stream.frames[0])
    values = back_end.diagnostics()
    for name, value in values.items():
        _require(
            isinstance(value, int | float | np.number),
            f"diagnostics() maps {name!r} to {value!r}; names map to single numbers",
        )
    return ", ".join(values)


CHECKS: tuple[Callable[[Bench], str | None], ...] = (
    check_shapes,
    check_rigid,
    check_covariance,
    check_prior,
    check_odometry,
    check_chart,
    check_deterministic,
    check_causal,
    check_estimate_is_pure,
    check_accuracy,
    check_consistency,
    check_landmarks,
    check_map_consistency,
    check_joint,
    check_joint_consistency,
    check_trajectory,
    check_diagnostics,
)
ESSENTIAL = frozenset({check_shapes})
"""Without these the later checks would only repeat the same failure."""
