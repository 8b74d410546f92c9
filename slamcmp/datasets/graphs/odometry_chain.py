"""Which edges of a graph are the robot's odometry, and what speaks against it.

The chain of poses in the order of their ids is the odometry. An edge stored from the later pose to the
earlier one is turned round exactly: ``Z exp(e)`` becomes ``Z^-1 exp(-Ad(Z) e)``, so Q = Ad C Ad^T keeps the
cost as it was. Several edges between a pose and the next are one measurement of the same motion: their
information-weighted mean on the manifold.

Nothing is guessed: a marker that was stored as a pose would otherwise become the robot's last step.

========  =====================================================================
symbol    meaning
========  =====================================================================
Z_i, C_i  a measured motion and its covariance in the tangent of the later body
X         their mean: the least of sum_i |log(Z_i^-1 X)|^2 in the norm of C_i
J_i       derivative of log(Z_i^-1 X exp(d)) by d: the inverse right Jacobian
========  =====================================================================
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.special import chdtri

from slamcmp.datasets.graphs.graph_types import Graph, PoseEdge, name_of
from slamcmp.errors import DataError
from slamcmp.geometry import adjoint, exp, inverse, local, right_jacobian
from slamcmp.types import FloatArray

CONTRADICTION = 1e-9
"""Probability below which two measurements of one thing cannot both be what their covariances say."""

_UNUSUAL = 3
"""Times the largest other step of irregular ids: a last step so long is no habit of the numbering."""


def split_edges(graph: Graph, ids: Sequence[int]) -> tuple[dict[int, PoseEdge], list[PoseEdge]]:
    """The odometry edge into each frame but the first, and the rest as they were stored.

    Args:
        graph: as it was read.
        ids: of the poses to use, in order; edges to others are left out.

    Raises:
        DataError: an edge from a pose to itself, two poses without one, parallel edges that contradict one
            another, or a pose that looks like a landmark.
    """
    index = {pose: k for k, pose in enumerate(ids)}
    parallel: dict[int, list[PoseEdge]] = defaultdict(list)
    closures: list[PoseEdge] = []
    used: list[PoseEdge] = []
    for edge in graph.pose_edges:
        if edge.first not in index or edge.second not in index:
            continue
        a, b = index[edge.first], index[edge.second]
        if a == b:
            raise DataError(
                f"{edge.where}: an edge from pose {name_of(edge.first)} to itself; two poses are needed"
            )
        used.append(edge)
        if abs(a - b) == 1:
            parallel[max(a, b)].append(edge if a < b else turned(edge))
        else:
            closures.append(edge)
    for k in range(1, len(ids)):
        if k not in parallel:
            raise DataError(
                f"{graph.path}: no edge joins pose {name_of(ids[k - 1])} and pose {name_of(ids[k])}; "
                "the odometry needs one between each pose and the next"
            )
    _refuse_landmarks(graph, ids, used)
    return {k: fused(edges) for k, edges in parallel.items()}, closures


def turned(edge: PoseEdge) -> PoseEdge:
    """The same measurement from the other end."""
    transport = adjoint(edge.T)
    return PoseEdge(
        edge.second, edge.first, inverse(edge.T), transport @ edge.covariance @ transport.T, edge.where
    )


def fused(edges: Sequence[PoseEdge]) -> PoseEdge:
    """One edge for several between the same two poses, all in the same direction.

    Raises:
        DataError: one is farther from the mean than :data:`CONTRADICTION` allows.
    """
    if len(edges) == 1:
        return edges[0]
    first = edges[0]
    weights = [np.linalg.inv(edge.covariance) for edge in edges]
    X = first.T
    for _ in range(50):
        residuals = [local(edge.T, X) for edge in edges]
        jacobians = [np.linalg.inv(right_jacobian(r)) for r in residuals]
        information = sum(J.T @ W @ J for J, W in zip(jacobians, weights, strict=True))
        pull = sum(J.T @ W @ r for J, W, r in zip(jacobians, weights, residuals, strict=True))
        step: FloatArray = -np.linalg.solve(information, pull)
        X = X @ exp(step)
        if np.abs(step).max() < 1e-14:
            break
    chi2 = sum(float(local(edge.T, X) @ W @ local(edge.T, X)) for edge, W in zip(edges, weights, strict=True))
    limit = float(chdtri(first.covariance.shape[0] * (len(edges) - 1), CONTRADICTION))
    if chi2 > limit:
        others = ", ".join(edge.where.rpartition(":")[2] for edge in edges[1:])
        raise DataError(
            f"{first.where}: this edge and that of line {others} measure the same motion from pose "
            f"{name_of(first.first)} to pose {name_of(first.second)} and contradict one another: chi-squared "
            f"{chi2:.4g} where {limit:.4g} is as good as never passed; one of them is wrong"
        )
    total: FloatArray = np.linalg.inv(information)
    return PoseEdge(first.first, first.second, X, 0.5 * (total + total.T), first.where)


def _refuse_landmarks(graph: Graph, ids: Sequence[int], edges: Sequence[PoseEdge]) -> None:
    """Raise DataError for a pose that is a landmark by all that the file tells.

    The robot's own poses are looked at and look on; a marker stored as a pose only is looked at (or, its
    edges stored from the other end, only looks). So do the first and the last pose of a chain, where the
    numbering and the direction of the other edges tell, and a pose between whose own edges lead both ways,
    where the chain tells: it holds together without a marker.
    """
    if len(ids) < 3:
        return
    index = {pose: k for k, pose in enumerate(ids)}
    pairs = [(index[edge.first], index[edge.second]) for edge in edges]
    starts, ends = {a for a, _ in pairs}, {b for _, b in pairs}
    joined = {(min(a, b), max(a, b)) for a, b in pairs}
    onwards = Counter(b > a for a, b in pairs if abs(a - b) == 1)
    source, sink = (0, len(ids) - 1) if onwards[True] >= onwards[False] else (len(ids) - 1, 0)
    jumps = _jumps(_steps(graph, ids))
    for k, pose in enumerate(ids):
        looks, jump = k in starts, jumps[max(k - 1, 0)]
        if looks and (k in ends or k == source):
            continue
        if jump:
            reason = f"does not follow pose {name_of(ids[k - 1] if k else ids[1])} in the numbering"
        elif (k - 1, k + 1) in joined:
            reason = "the poses beside it are joined without it"
        elif k in (source, sink) and looks == (k == sink):
            reason = "its edges lead the other way from those of the other poses"
        else:
            continue
        of_it = [edge for edge in edges if pose in (edge.first, edge.second)]
        others = ", ".join(name_of(edge.second if looks else edge.first) for edge in of_it[:3])
        raise DataError(
            f"{graph.pose_lines.get(pose, of_it[0].where)}: pose {name_of(pose)} "
            f"{f'only looks at others ({others})' if looks else f'is only looked at (from {others})'} and "
            f"{reason}: a landmark stored as a pose? Store it as one (VERTEX_XY with EDGE_SE2_XY; in space "
            "VERTEX_TRACKXYZ with EDGE_SE3_TRACKXYZ), or number the poses in the order in which the robot "
            "took them"
        )


def numbering_jump(graph: Graph, ids: Sequence[int]) -> str | None:
    """What is to be told where the numbers of the poses jump once: a second session, or a marker's number."""
    jumps = _jumps(_steps(graph, ids)) if len(ids) > 2 else []
    if True not in jumps:
        return None
    k = jumps.index(True)
    return (
        f"{graph.path.name}: the numbers of the poses jump from {name_of(ids[k])} to {name_of(ids[k + 1])}; "
        "the edge between these two is taken for a step of the robot's odometry"
    )


def _jumps(steps: Sequence[int]) -> list[bool]:
    """Of each step, whether it is none that this numbering has elsewhere.

    Regular numbers have one step; irregular ones any up to :data:`_UNUSUAL` times the largest other.
    """
    ordered = sorted(steps)
    jumps = []
    for step in steps:
        least, most = ordered[step == ordered[0]], ordered[-2 if step == ordered[-1] else -1]
        jumps.append(step > (most if most == least else _UNUSUAL * most))
    return jumps


def _steps(graph: Graph, ids: Sequence[int]) -> list[int]:
    """Differences of the ids that follow one another; ids in between that landmarks bear do not count."""
    taken = np.array(
        sorted({edge.landmark for edge in graph.landmark_edges} | set(graph.landmarks)), dtype=object
    )
    return [
        later
        - earlier
        - int(((taken > earlier) & (taken < later)).sum() if taken.size and later - earlier > 1 else 0)
        for earlier, later in pairwise(ids)
    ]
