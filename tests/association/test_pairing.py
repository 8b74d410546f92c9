"""Whose a detection is: against brute force, closed forms and cases made by hand."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from slamcmp.association.compatibility import NOBODY, Innovations, gate, uncorrelated
from slamcmp.association.hypotheses import marginals
from slamcmp.association.jcbb import joint_compatibility
from slamcmp.association.single import maximum_likelihood, nearest_neighbour
from slamcmp.types import FloatArray, IntArray


def drawn(rng: np.random.Generator, detections: int, landmarks: int, spread: float) -> Innovations:
    """Innovations with a common error of the pose, as correlated as a filter's."""
    d = 2
    shared = rng.normal(size=(landmarks * d, 3))
    own = rng.normal(size=(landmarks * d, landmarks * d)) * 0.3
    C = (shared @ shared.T + own @ own.T).reshape(landmarks, d, landmarks, d).transpose(0, 2, 1, 3)
    R = np.tile(0.2 * np.eye(d), (detections, 1, 1))
    return Innovations(rng.normal(size=(detections, landmarks, d)) * spread, C, uncorrelated(R))


def joint_covariance(innovations: Innovations, pairs: list[tuple[int, int]]) -> FloatArray:
    return np.block([[innovations.covariance(one, other) for other in pairs] for one in pairs])


def distance(innovations: Innovations, pairs: list[tuple[int, int]]) -> float:
    if not pairs:
        return 0.0
    y = np.concatenate([innovations.y[pair] for pair in pairs])
    return float(y @ np.linalg.inv(joint_covariance(innovations, pairs)) @ y)


def hypotheses(detections: int, landmarks: int) -> list[list[tuple[int, int]]]:
    """Every one-to-one pairing."""
    found = []
    for choice in itertools.product(range(-1, landmarks), repeat=detections):
        used = [column for column in choice if column >= 0]
        if len(set(used)) == len(used):
            found.append([(row, column) for row, column in enumerate(choice) if column >= 0])
    return found


@pytest.mark.parametrize("seed", range(25))
def test_jcbb_finds_what_brute_force_finds(seed: int) -> None:
    """Most pairs, then the least joint distance, over every one-to-one pairing."""
    rng = np.random.default_rng(seed)
    detections, landmarks = rng.integers(1, 5), rng.integers(1, 5)
    innovations = drawn(rng, detections, landmarks, spread=rng.uniform(1.0, 4.0))
    alone = innovations.compatible(0.95)
    nearest = np.where(alone, innovations.squared_distances, np.inf).min(axis=1)
    order = sorted(range(detections), key=lambda i: (alone[i].sum(), nearest[i]))

    def allowed(pairs: list[tuple[int, int]]) -> bool:
        """Built up in the published order, no pair leaves its gate, alone or with those before it."""
        grown = sorted(pairs, key=lambda pair: order.index(pair[0]))
        return all(alone[pair] for pair in pairs) and all(
            distance(innovations, grown[: k + 1]) <= gate(2 * (k + 1), 0.95) for k in range(len(grown))
        )

    found = joint_compatibility(innovations, 0.95)
    mine = [(row, int(column)) for row, column in enumerate(found) if column != NOBODY]
    best = min(
        (pairs for pairs in hypotheses(detections, landmarks) if allowed(pairs)),
        key=lambda pairs: (-len(pairs), distance(innovations, pairs)),
    )
    assert mine == best


def test_jcbb_refuses_the_neighbour_that_disagrees_with_the_others() -> None:
    """All seen to the left by the same error; one detection lies exactly on the wrong landmark."""
    landmarks = np.array([[0.0, 0.0], [5.0, 0.0], [9.0, 0.0], [10.0, 0.0]])
    detected = landmarks[[0, 1, 3]] - [1.0, 0.0]
    C = np.broadcast_to(np.eye(2), (4, 4, 2, 2)) + uncorrelated(np.tile(1e-3 * np.eye(2), (4, 1, 1)))
    innovations = Innovations(
        detected[:, None] - landmarks[None], C, uncorrelated(np.tile(1e-3 * np.eye(2), (3, 1, 1)))
    )
    assert nearest_neighbour(innovations, 0.99).tolist() == [0, 1, 2]
    assert joint_compatibility(innovations, 0.99).tolist() == [0, 1, 3]


def single(distances: FloatArray, sigmas: FloatArray) -> Innovations:
    """One detection between landmarks at distances along x, each as uncertain as its sigma."""
    C = uncorrelated(sigmas[:, None, None] ** 2 * np.eye(2))
    y = np.stack([distances, np.zeros_like(distances)], axis=-1)[None]
    return Innovations(y, C, uncorrelated(np.full((1, 2, 2), 0.0)))


def test_the_likeliest_landmark_need_not_be_the_nearest() -> None:
    """d² is 1 for the vague one and 2.25 for the precise one; -2 log L differs by 4 log 10 the other way."""
    innovations = single(np.array([1.0, 0.15]), np.array([1.0, 0.1]))
    assert innovations.squared_distances == pytest.approx(np.array([[1.0, 2.25]]))
    assert nearest_neighbour(innovations, 0.99).tolist() == [0]
    assert maximum_likelihood(innovations, 0.99).tolist() == [1]


def test_likelihood_is_the_best_sum_over_all_assignments() -> None:
    for seed in range(20):
        innovations = drawn(np.random.default_rng(seed), 3, 3, spread=1.5)
        given = maximum_likelihood(innovations, 0.95)
        allowed = innovations.compatible(0.95)
        costs = innovations.squared_distances + innovations.log_determinants
        largest = np.where(allowed, innovations.log_determinants, -np.inf).max(axis=1)
        alone = np.where(allowed.any(axis=1), gate(2, 0.95) + largest, 0.0)

        def cost(pairs: list[tuple[int, int]], costs: FloatArray = costs, alone: FloatArray = alone) -> float:
            rows = {row for row, _ in pairs}
            free = sum(float(alone[row]) for row in range(3) if row not in rows)
            return sum(float(costs[pair]) for pair in pairs) + free

        best = min((p for p in hypotheses(3, 3) if all(allowed[pair] for pair in p)), key=cost)
        mine = [(row, int(column)) for row, column in enumerate(given) if column != NOBODY]
        assert cost(mine) == pytest.approx(cost(best))


@pytest.mark.parametrize("pair", [nearest_neighbour, maximum_likelihood, joint_compatibility])
def test_the_gate_holds_its_share_of_right_pairs(pair: object) -> None:
    """4000 innovations of the right covariance; binomial deviation 0.0047 of 0.9, bound four times that."""
    rng = np.random.default_rng(3)
    S = np.array([[2.0, 0.7], [0.7, 0.5]])
    passed = 0
    for y in rng.multivariate_normal(np.zeros(2), S, size=4000):
        innovations = Innovations(y[None, None], 0.6 * S[None, None], 0.4 * S[None, None])
        passed += int(pair(innovations, 0.9)[0] == 0)  # type: ignore[operator]
    assert passed / 4000 == pytest.approx(0.9, abs=0.019)


@pytest.mark.parametrize("pair", [nearest_neighbour, maximum_likelihood, joint_compatibility])
def test_nobody_twice_and_nothing_outside_the_gate(pair: object) -> None:
    for seed in range(20):
        innovations = drawn(np.random.default_rng(seed), 4, 3, spread=2.0)
        given: IntArray = pair(innovations, 0.9)  # type: ignore[operator]
        rows = np.flatnonzero(given != NOBODY)
        assert np.unique(given[rows]).size == rows.size
        assert innovations.compatible(0.9)[rows, given[rows]].all()


@pytest.mark.parametrize("seed", range(15))
def test_probabilities_are_those_of_the_sum_over_all_hypotheses(seed: int) -> None:
    rng = np.random.default_rng(seed)
    innovations = drawn(rng, 3, 3, spread=0.5)
    alone = innovations.compatible(0.999)
    # Where every detection has rivals, nothing is taken for granted.
    if (alone.sum(axis=1) < 2).any():
        pytest.skip("a detection without rivals")
    table, unknown = np.zeros((3, 4)), 0.05
    for pairs in hypotheses(3, 3):
        if not all(alone[pair] for pair in pairs):
            continue
        weight = unknown ** (3 - len(pairs)) * np.exp(-0.5 * distance(innovations, pairs))
        if pairs:
            S = joint_covariance(innovations, pairs)
            weight /= np.sqrt(np.linalg.det(2 * np.pi * S))
        given = dict(pairs)
        for row in range(3):
            table[row, given.get(row, 3)] += weight
    assert marginals(innovations, 0.999, unknown) == pytest.approx(table / table.sum(axis=1, keepdims=True))


def test_a_detection_between_two_equal_landmarks_is_either_s() -> None:
    """By symmetry a half each, less what nobody's density takes."""
    innovations = single(np.array([1.0, -1.0]), np.array([1.0, 1.0]))
    density = np.exp(-0.5) / (2 * np.pi)
    expected = density / (2 * density + 0.01)
    assert marginals(innovations, 0.99, 0.01)[0] == pytest.approx([expected, expected, 1 - 2 * expected])
