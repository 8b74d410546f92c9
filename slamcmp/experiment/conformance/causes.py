"""Which fault a covariance has: what it claims on a stream without errors, against filters with one.

Where every measurement is what the truth gives, no estimate moves from it, every Jacobian is that of the
truth, and right filters of all charts claim one and the same covariance, which hangs on Q, R and the
equations alone. So does a faulty one, and most faults claim one that no other does: here each is put into a
textbook EKF, one at a time, and the back end's covariance is set beside all of theirs. What agrees with one
of them over all frames has its fault, whatever its author wrote; what agrees with none is told so.

========  =======================================================================
symbol    meaning
========  =======================================================================
A, Q      Ad(T_prev_body^-1) and the increment's covariance
B         derivative of a new landmark by its measurement, H_land^-1, (n, n)
G         derivative of a new landmark by the pose, -B H_pose, (n, p)
P         joint covariance, pose (body tangent) first, then landmarks (world)
========  =======================================================================
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.optimize import minimize_scalar

from slamcmp.backends.entries import places_by_itself
from slamcmp.backends.filters.covariances.covariance import block_diagonal
from slamcmp.experiment.conformance.bench import Bench, run
from slamcmp.geometry import adjoint_of_inverse, inverse, transform
from slamcmp.protocols import Mapper
from slamcmp.types import FloatArray, Frame, GroundTruth, MeasurementStream

AGREES = 1e-3
"""Largest difference of covariances, as a share of the deviations they belong to, that is none."""
ORDERS = ("new first", "new last", "as they come")
"""In which a frame's observations of new and of known landmarks may be taken in."""
Change = Callable[[FloatArray], FloatArray]


def _same(X: FloatArray) -> FloatArray:
    return X


@dataclass(frozen=True)
class _Mistakes:
    """What one filter does otherwise than the textbook; the defaults are right."""

    Q: Change = _same
    R_known: Change = _same
    """Of landmarks in the map."""
    R_new: Change = _same
    in_metres: str = ""
    """A new landmark's R as if it were in metres: along "world" or "body" axes."""
    cross: bool = True
    """Whether new landmarks are correlated with what was there."""
    of_pose: bool = True
    """Whether the pose's uncertainty is in a new landmark's own."""
    moves_cross: bool = True
    """Whether a step carries the pose's covariance with the map."""
    keeps_cross: bool = True
    """Whether a correction leaves a covariance of pose and map."""
    believes_map: bool = False
    """Whether landmarks are corrected by as if they were known."""
    old_pose: bool = False
    """Whether observations are linearised at the pose before the step."""


def _times(factor: float) -> Change:
    return lambda X: factor * X


def _squared(X: FloatArray) -> FloatArray:
    return X @ X


def _root(X: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(X)
    root: FloatArray = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    return root


FAULTS: Mapping[str, _Mistakes] = {
    "new landmarks enter without their correlation to the pose": _Mistakes(cross=False, of_pose=False),
    "new landmarks enter without their correlation to the pose, though with its uncertainty": _Mistakes(
        cross=False
    ),
    "R of a new landmark is added in the measurement's units, as if they were metres; it is B R B^T, B the "
    "landmark's derivative by the measurement": _Mistakes(in_metres="world"),
    "R of a new landmark is added in the measurement's units, turned by the heading; it is B R B^T, B the "
    "landmark's derivative by the measurement": _Mistakes(in_metres="body"),
    "a new landmark's covariance lacks R": _Mistakes(R_new=_times(0.0)),
    "every observation is taken in twice, or R is half of what it is": _Mistakes(
        R_known=_times(0.5), R_new=_times(0.5)
    ),
    "every observation of a known landmark is taken in twice, or with half of R": _Mistakes(
        R_known=_times(0.5)
    ),
    "R is taken for standard deviations and squared": _Mistakes(R_known=_squared, R_new=_squared),
    "R of known landmarks is taken for standard deviations and squared": _Mistakes(R_known=_squared),
    "the root of R, its standard deviations, stands where R belongs": _Mistakes(R_known=_root, R_new=_root),
    "Q is left out": _Mistakes(Q=_times(0.0)),
    "Q is added twice": _Mistakes(Q=_times(2.0)),
    "Q is taken for standard deviations and squared": _Mistakes(Q=_squared),
    "the root of Q, its standard deviations, stands where Q belongs": _Mistakes(Q=_root),
    "a step moves the pose's own covariance but not the one with the map": _Mistakes(moves_cross=False),
    "a correction drops the covariance of pose and map": _Mistakes(keeps_cross=False),
    "landmarks are taken as known: the map's uncertainty is missing in the correction": _Mistakes(
        believes_map=True
    ),
    "observations are linearised at the pose before the step": _Mistakes(old_pose=True),
}
"""One at a time, each with the words that name it."""
FACTORS: Mapping[str, Callable[[float], _Mistakes]] = {
    "R is {0:.3g} times what it should be, or observations are taken in that much oftener": lambda f: (
        _Mistakes(R_known=_times(f), R_new=_times(f))
    ),
    "R of known landmarks is {0:.3g} times what it should be": lambda f: _Mistakes(R_known=_times(f)),
    "R of new landmarks is {0:.3g} times what it should be": lambda f: _Mistakes(R_new=_times(f)),
    "Q is {0:.3g} times what it should be": lambda f: _Mistakes(Q=_times(f)),
}
"""Faults of an unknown size, which is fitted."""


KEPT = 500
_kept: dict[tuple[str, int, str], FloatArray] = {}
"""What textbook filters with a fault claim, by stream, fault and order: the same for whatever is checked."""


def cause(bench: Bench) -> str:
    """In words, why a covariance does not fit its errors; or that it was not found, and how far it was."""
    sensor = bench.stream.problem.sensor
    if not places_by_itself(sensor) or any(frame.entries is not None for frame in bench.stream.frames):
        return "cause not found: it is looked for with sensors that place a landmark by one measurement"
    stream, truth = errorless(bench)
    try:
        _, claimed = run(bench, stream, truth)
    except Exception as error:
        return f"cause not found: on a stream without errors it raised {type(error).__name__}"
    right = _claims(stream, truth, _Mistakes())
    off = _difference(claimed, right)
    if off.max() < AGREES:
        unlike = _unlike_landmarks(bench, stream, truth)
        if unlike is not None:
            return (
                "cause not found: on a stream without errors its pose's covariance is an EKF's and landmark "
                f"{unlike}'s is not; is what landmarks() and joint_covariance() report in world axes, and in "
                "the order of its ids?"
            )
        return (
            "its covariance is right where measurements have no errors, so Q, R, new landmarks and the "
            "equations of P are; what is left is how errors enter: a gain or an innovation that is not the "
            "one of this P, Jacobians at another state than the one that is corrected, a covariance left in "
            "the axes before the correction"
        )
    found = [name for name, each in FAULTS.items() if _explains(stream, truth, each, claimed)]
    if not found:
        fits = [(_fitted(stream, truth, family, claimed), words, family) for words, family in FACTORS.items()]
        found = [words.format(f) for f, words, family in fits if _explains(stream, truth, family(f), claimed)]
    if found:
        beside = _beside(stream, truth, FAULTS[found[0]]) if found[0] in FAULTS else ""
        return f"cause: {'; or: '.join(found)} (its covariances on a stream without errors are those{beside})"
    first = int(np.argmax(off > AGREES))
    seen = {name for frame in stream.frames[:first] for name in frame.ids.tolist()}
    again = sum(name in seen for name in stream.frames[first].ids.tolist())
    return (
        f"cause not found: on a stream without errors its covariance first differs from an EKF's in frame "
        f"{first}, by {100 * off[first]:.2g} %, where {again} landmarks are seen again and "
        f"{stream.frames[first].ids.size - again} are new; it is none of {len(FAULTS) + len(FACTORS)} faults "
        "that were tried"
    )


def errorless(bench: Bench) -> tuple[MeasurementStream, GroundTruth]:
    """The bench's stream as it would be if prior, odometry and measurements had no errors, and its truth."""
    stream, truth = bench.stream, bench.truth
    moved = stream.problem.T_world_body @ inverse(truth.T_world_body[0])
    poses, positions = moved @ truth.T_world_body, transform(moved, truth.positions)
    row = {name: k for k, name in enumerate(truth.ids.tolist())}
    frames = []
    for frame, T in zip(stream.frames, poses, strict=True):
        step = inverse(poses[frame.k - 1]) @ T if frame.k else frame.T_prev_body
        z = stream.problem.sensor.predict(T, positions[[row[name] for name in frame.ids.tolist()]])
        frames.append(replace(frame, T_prev_body=step, z=z.reshape(frame.z.shape)))
    return replace(stream, frames=tuple(frames)), GroundTruth(truth.t, poses, truth.ids, positions)


def _explains(
    stream: MeasurementStream, truth: GroundTruth, mistakes: _Mistakes, claimed: FloatArray
) -> bool:
    # With a mistake it makes a difference which comes first, correction or new landmarks.
    return any(
        _difference(claimed, _kept_claims(stream, truth, mistakes, order)).max() < AGREES for order in ORDERS
    )


def _beside(stream: MeasurementStream, truth: GroundTruth, fault: _Mistakes) -> str:
    """Which other faults this one hides, in words: put in beside it they change no covariance of a pose.

    Without Q, for one, the pose is as well known as at the start, whatever observations say.
    """
    own = _kept_claims(stream, truth, fault, ORDERS[0])
    hidden = [
        name
        for name, other in FAULTS.items()
        if (both := _both(fault, other)) is not None
        and _difference(_claims(stream, truth, both), own).max() < AGREES
    ]
    if not hidden:
        return ""
    more = f", and {len(hidden) - 1} more" if len(hidden) > 1 else ""
    return f"; another fault may stand beside it and would not show in them, such as: {hidden[0]}{more}"


def _both(one: _Mistakes, other: _Mistakes) -> _Mistakes | None:
    """A filter with both faults; None where they are of one and the same thing."""
    default = _Mistakes()
    changed = {
        each.name: getattr(other, each.name)
        for each in fields(_Mistakes)
        if getattr(other, each.name) != getattr(default, each.name)
    }
    if any(getattr(one, name) != getattr(default, name) for name in changed):
        return None
    return replace(one, **changed)


def _kept_claims(
    stream: MeasurementStream, truth: GroundTruth, mistakes: _Mistakes, order: str
) -> FloatArray:
    """The claims, kept for the next back end that is checked in the same world."""
    if not any(mistakes is each for each in FAULTS.values()):
        # Of a fitted size: nobody asks for that one again.
        return _claims(stream, truth, mistakes, order)
    key = (stream.digest, id(mistakes), order)
    if key not in _kept:
        if len(_kept) >= KEPT:
            _kept.clear()
        _kept[key] = _claims(stream, truth, mistakes, order)
    return _kept[key]


def _difference(claimed: FloatArray, other: FloatArray) -> FloatArray:
    """Of covariances (K, p, p), the largest of each, as a share of the larger one's deviations, (K,)."""
    variances = np.maximum(np.diagonal(other, axis1=1, axis2=2), np.diagonal(claimed, axis1=1, axis2=2))
    sigma = np.sqrt(np.maximum(variances, np.finfo(float).tiny))
    scaled = (claimed - other) / (sigma[:, :, None] * sigma[:, None, :])
    answer: FloatArray = np.nan_to_num(np.abs(scaled).max(axis=(1, 2)), nan=np.inf)
    return answer


def _fitted(
    stream: MeasurementStream,
    truth: GroundTruth,
    family: Callable[[float], _Mistakes],
    claimed: FloatArray,
) -> float:
    """The factor with which a family's fault comes nearest to what was claimed."""

    def distance(log_factor: float) -> float:
        off = _difference(claimed, _claims(stream, truth, family(float(np.exp(log_factor)))))
        return float(np.minimum(off, 1e3).sum())

    return float(np.exp(minimize_scalar(distance, bounds=(-9.0, 9.0), method="bounded").x))


def _unlike_landmarks(bench: Bench, stream: MeasurementStream, truth: GroundTruth) -> int | None:
    """A landmark of the last map whose own covariance is not the textbook's; None without one."""
    back_end = bench.new(stream, truth)
    for frame in stream.frames:
        back_end.update(frame)
    if not isinstance(back_end, Mapper):
        return None
    landmarks = back_end.landmarks()
    _, P, at = _filtered(stream, truth, _Mistakes())
    n = stream.problem.sensor.space_dim
    for name, block in zip(landmarks.ids.tolist(), landmarks.covariances, strict=True):
        i = at.get(name)
        if i is None or not _difference(block[None], P[None, i : i + n, i : i + n]).max() < AGREES:
            return int(name)
    return None


def _claims(
    stream: MeasurementStream, truth: GroundTruth, mistakes: _Mistakes, order: str = "new first"
) -> FloatArray:
    """The pose's covariances (K, p, p) of an EKF with these mistakes on a stream without errors."""
    return _filtered(stream, truth, mistakes, order)[0]


def _filtered(
    stream: MeasurementStream, truth: GroundTruth, mistakes: _Mistakes, order: str = "new first"
) -> tuple[FloatArray, FloatArray, Mapping[int, int]]:
    """Those, the last joint covariance, and where in it each landmark begins."""
    p, n = len(stream.problem.P), stream.problem.sensor.space_dim
    at: dict[int, int] = {}
    row = {name: k for k, name in enumerate(truth.ids.tolist())}
    P, claims = np.array(stream.problem.P), []
    for frame in stream.frames:
        T = truth.T_world_body[frame.k]
        if frame.k:
            P = _moved(P, frame, p, mistakes)
        T_linear = truth.T_world_body[max(frame.k - 1, 0)] if mistakes.old_pose else T
        names = frame.ids.tolist()
        known = [i for i, name in enumerate(names) if name in at]
        new = [i for i, name in enumerate(names) if name not in at]
        turns: dict[str, list[int | list[int]]] = {
            "new first": [*new, known],
            "new last": [known, *new],
            "as they come": [*range(len(names))],
        }
        for turn in turns[order]:
            if isinstance(turn, list) or turn in known:
                group = turn if isinstance(turn, list) else [turn]
                if group:
                    P = _corrected(P, stream, frame, T_linear, truth, group, at, mistakes)
            else:
                P = _grown(P, stream, frame, T, truth.positions[row[names[turn]]], turn, mistakes)
                at[names[turn]] = len(P) - n
        claims.append(P[:p, :p])
    return np.array(claims), P, at


def _moved(P: FloatArray, frame: Frame, p: int, mistakes: _Mistakes) -> FloatArray:
    A, P = adjoint_of_inverse(frame.T_prev_body), P.copy()
    if mistakes.moves_cross:
        P[:p, p:] = A @ P[:p, p:]
        P[p:, :p] = P[:p, p:].T
    P[:p, :p] = A @ P[:p, :p] @ A.T + mistakes.Q(frame.Q)
    return P


def _grown(
    P: FloatArray,
    stream: MeasurementStream,
    frame: Frame,
    T: FloatArray,
    position: FloatArray,
    i: int,
    mistakes: _Mistakes,
) -> FloatArray:
    H_pose, H_land = stream.problem.sensor.jacobians(T, position)
    p, B = H_pose.shape[1], np.linalg.inv(H_land)
    G, R = -B @ H_pose, mistakes.R_new(frame.R[i])
    cross = G @ P[:p] if mistakes.cross else np.zeros((len(B), len(P)))
    if mistakes.in_metres:
        turned = np.eye(len(B)) if mistakes.in_metres == "world" else T[:-1, :-1]
        own = turned @ R @ turned.T
    else:
        own = B @ R @ B.T
    if mistakes.of_pose:
        own = own + G @ P[:p, :p] @ G.T
    return np.block([[P, cross.T], [cross, own]])


def _corrected(
    P: FloatArray,
    stream: MeasurementStream,
    frame: Frame,
    T: FloatArray,
    truth: GroundTruth,
    known: list[int],
    at: Mapping[int, int],
    mistakes: _Mistakes,
) -> FloatArray:
    n = stream.problem.sensor.space_dim
    names = frame.ids[known].tolist()
    row = {name: k for k, name in enumerate(truth.ids.tolist())}
    H_pose, H_land = stream.problem.sensor.jacobians(T, truth.positions[[row[name] for name in names]])
    m, d, p = H_pose.shape
    H = np.zeros((m, d, len(P)))
    H[:, :, :p] = H_pose
    if not mistakes.believes_map:
        for i, name in enumerate(names):
            H[i, :, at[name] : at[name] + n] = H_land[i]
    H_all = H.reshape(m * d, -1)
    R = block_diagonal(np.stack([mistakes.R_known(each) for each in frame.R[known]]))
    P = P - P @ H_all.T @ np.linalg.solve(H_all @ P @ H_all.T + R, H_all @ P)
    if not mistakes.keeps_cross:
        P[:p, p:], P[p:, :p] = 0.0, 0.0
    return 0.5 * (P + P.T)
