"""Whether a filter keeps unobservable what its sensors cannot see.

A filter is described by its linear blocks, one ``(transition, sighting)`` per frame: the error-state
transition (s, s) from the last frame (the identity at the first), and the stacked measurement Jacobian (o, s)
of the frame, all on one fixed ordering of the state with the pose first. The local observability matrix is
[H_0; H_1 F_1; H_2 F_2 F_1; …] (Chen, Jiang and Hu 1990; Huang, Mourikis and Roumeliotis 2010, eq. 22). In
planar SLAM nothing sees where the world lies: the null space of a correct filter has dimension 3 (6 in
space); the standard EKF's has 2, and it becomes sure of its heading without having seen it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

Block = tuple[FloatArray, FloatArray]

RELATIVE_TOLERANCE = 1e-9
"""Singular values below this share of the largest count as zero."""


def observability_matrix(blocks: Sequence[Block]) -> FloatArray:
    """[H_0 F_0; H_1 F_1 F_0; …], (sum of o, s).

    Args:
        blocks: per frame the transition (s, s) and the measurement Jacobian (o, s), o may be 0.
    """
    states = blocks[0][0].shape[0]
    product = np.eye(states)
    rows = []
    for transition, sighting in blocks:
        product = transition @ product
        rows.append(sighting @ product)
    return np.concatenate(rows)


def observability_rank(blocks: Sequence[Block], relative_tolerance: float = RELATIVE_TOLERANCE) -> int:
    """Dimension of what the blocks can see, by singular values."""
    return _rank(observability_matrix(blocks), relative_tolerance)


def observability_nullity(blocks: Sequence[Block], relative_tolerance: float = RELATIVE_TOLERANCE) -> int:
    """Dimension of what they cannot see: s minus the rank."""
    states: int = blocks[0][0].shape[0]
    return states - observability_rank(blocks, relative_tolerance)


def nullity_over_time(
    blocks: Sequence[Block], relative_tolerance: float = RELATIVE_TOLERANCE
) -> NDArray[np.int64]:
    """Nullity of the first 1, 2, … frames, (K,).

    The triangular factor of what came before stands for all its rows, so a run costs K decompositions of
    (s + o, s) instead of ever taller ones.
    """
    states = blocks[0][0].shape[0]
    product = np.eye(states)
    triangle: FloatArray = np.empty((0, states))
    nullities = []
    for transition, sighting in blocks:
        product = transition @ product
        rows = np.concatenate([triangle, sighting @ product])
        triangle = np.asarray(np.linalg.qr(rows, mode="r"), dtype=np.float64)
        nullities.append(states - _rank(triangle, relative_tolerance))
    return np.array(nullities, dtype=np.int64)


def information_along(
    blocks: Sequence[Block], covariances: Sequence[FloatArray], directions: FloatArray
) -> FloatArray:
    """Information [1 per squared unit of the direction] that measurements claim about directions, (K, g).

    ``directions`` (s, g) are errors at the first frame, carried on by the transitions; frame k adds
    ``|W H_k F_k … F_0 v|²`` with W^T W the inverse of its measurement covariance. For a correct estimator and
    the unobservable directions every entry is zero.

    Args:
        blocks: as above.
        covariances: of each frame's stacked measurement noise, (o, o).
        directions: (s, g).

    Raises:
        numpy.linalg.LinAlgError: a measurement covariance is not positive definite.
    """
    carried = np.array(directions, dtype=np.float64)
    gained = np.zeros((len(blocks), carried.shape[1]))
    for k, ((transition, sighting), covariance) in enumerate(zip(blocks, covariances, strict=True)):
        carried = transition @ carried
        if sighting.shape[0]:
            whitened = np.linalg.solve(np.linalg.cholesky(covariance), sighting @ carried)
            gained[k] = (whitened**2).sum(axis=0)
    return gained


def rigid_motions_planar(T_world_body: FloatArray, landmarks: FloatArray) -> FloatArray:
    """Errors that move the whole plane: (3 + 2 L, 3) for a pose (3, 3) and landmarks (L, 2).

    Columns: 1 m along world x, 1 m along y, 1 rad about the world's origin. The pose is in the body tangent
    (x, y, theta), landmarks are additive in world axes.
    """
    rotation, position = T_world_body[:2, :2], T_world_body[:2, 2]
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    directions = np.zeros((3 + landmarks.size, 3))
    directions[:2, :2] = rotation.T
    directions[:2, 2] = rotation.T @ turn @ position
    directions[2, 2] = 1.0
    directions[3:, :2] = np.tile(np.eye(2), (len(landmarks), 1))
    directions[3:, 2] = (landmarks @ turn.T).ravel()
    return directions


def rigid_motions_spatial(T_world_body: FloatArray, landmarks: FloatArray) -> FloatArray:
    """Errors that move the whole space: (6 + 3 L, 6) for a pose (4, 4) and landmarks (L, 3).

    Columns: rotation by 1 rad about world x, y, z through the origin, then 1 m along x, y, z. The pose is in
    the body tangent (omega, v), landmarks are additive in world axes.
    """
    rotation, position = T_world_body[:3, :3], T_world_body[:3, 3]
    directions = np.zeros((6 + landmarks.size, 6))
    directions[:3, :3] = rotation.T
    directions[3:6, :3] = -rotation.T @ _cross_matrix(position)
    directions[3:6, 3:] = rotation.T
    for i, landmark in enumerate(landmarks):
        directions[6 + 3 * i : 9 + 3 * i, :3] = -_cross_matrix(landmark)
        directions[6 + 3 * i : 9 + 3 * i, 3:] = np.eye(3)
    return directions


def _rank(matrix: FloatArray, relative_tolerance: float) -> int:
    if matrix.shape[0] == 0:
        return 0
    values = np.linalg.svd(matrix, compute_uv=False)
    return int(np.count_nonzero(values > relative_tolerance * values[0]))


def _cross_matrix(vector: FloatArray) -> FloatArray:
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
