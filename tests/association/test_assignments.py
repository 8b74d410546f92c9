"""Assignments of a frame against a sum over all of them, written out."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from slamcmp.association.assignments import Choice, assignments
from slamcmp.association.compatibility import NOBODY, Innovations, uncorrelated

EVERYTHING = Choice(1.0 - 1e-12, math.log(0.03), 1e3, 1e3)


def world(rng: np.random.Generator, detections: int, landmarks: int) -> Innovations:
    """Predictions correlated through one pose, and detections near them."""
    G = rng.normal(size=(2 * landmarks, 3))
    C = (G @ G.T + 0.1 * np.eye(2 * landmarks)).reshape(landmarks, 2, landmarks, 2).transpose(0, 2, 1, 3)
    y = rng.normal(size=(detections, landmarks, 2))
    return Innovations(y, C, uncorrelated(np.tile(0.2 * np.eye(2), (detections, 1, 1))))


@pytest.mark.parametrize(("detections", "landmarks"), [(1, 3), (2, 3), (3, 2)])
def test_every_assignment_has_the_density_of_its_innovations_together(
    detections: int, landmarks: int
) -> None:
    innovations = world(np.random.default_rng(landmarks), detections, landmarks)
    expected = {}
    for given in itertools.product([NOBODY, *range(landmarks)], repeat=detections):
        pairs = [(i, j) for i, j in enumerate(given) if j != NOBODY]
        if len({j for _, j in pairs}) < len(pairs):
            continue
        weight = (detections - len(pairs)) * math.log(0.03)
        if pairs:
            y = np.concatenate([innovations.y[pair] for pair in pairs])
            S = np.block([[innovations.covariance(one, other) for other in pairs] for one in pairs])
            weight += multivariate_normal(np.zeros(y.size), S).logpdf(y)
        expected[given] = weight
    found = {given: weight for weight, given in assignments(innovations, EVERYTHING)}
    assert found.keys() == expected.keys()
    assert [found[given] for given in expected] == pytest.approx(list(expected.values()), abs=1e-9)


def test_what_is_much_less_likely_is_left_out() -> None:
    C = np.zeros((2, 2, 2, 2))
    y = np.array([[[0.0, 0.0], [0.9, 0.0]]])
    innovations = Innovations(y, C, np.full((1, 1, 2, 2), 0.09) * np.eye(2))
    # The pairs differ by 4.5, a new landmark from the better one by 0.57 - log(density).
    near, far, new = (0,), (1,), (NOBODY,)
    for log_new, odds, odds_new, expected in [
        (-3.0, 5.0, 5.0, {near, far, new}),
        (-3.0, 4.0, 5.0, {near, new}),
        (-3.0, 5.0, 3.0, {near, far}),
        (4.0, 3.0, 5.0, {new}),
    ]:
        found = assignments(innovations, Choice(0.9999, log_new, odds, odds_new))
        assert {given for _, given in found} == expected
    # Nobody is left to choose from: new, whatever the odds.
    shut = Choice(0.01, -30.0, 1.0, 1.0)
    assert [given for _, given in assignments(Innovations(y + 9.0, C, innovations.R), shut)] == [new]
