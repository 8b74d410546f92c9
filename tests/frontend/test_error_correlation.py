"""Errors that repeat from image to image are measured, and stated as so much larger covariances."""

from __future__ import annotations

import numpy as np
import pytest

from slamcmp.frontend.vision.tracking.error_correlation import LAGS, ErrorCorrelation
from tests.frontend.given_features import PAIR, R_PAIR, Following, Points


def repeating(rng: np.random.Generator, rho: float, images: int, shape: tuple[int, ...]) -> np.ndarray:
    """An AR(1) series of unit variance, (images, *shape)."""
    errors = rng.standard_normal((images, *shape))
    for k in range(1, images):
        errors[k] = rho * errors[k - 1] + np.sqrt(1 - rho**2) * errors[k]
    return errors


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.8])
def test_the_measured_means_are_those_of_the_process(rho: float) -> None:
    errors = repeating(np.random.default_rng(0), rho, 200, (400, 2))
    measured = ErrorCorrelation()
    for k in range(LAGS, 200):
        measured.learn(errors[k], np.stack([errors[k - lag] for lag in range(1, LAGS + 1)], axis=1))
    lags = np.arange(LAGS + 1)
    np.testing.assert_allclose(measured.means, rho**lags, atol=0.02)
    expected = 1.0 + 2.0 * ((1 - lags[1:] / (LAGS + 1)) * rho ** lags[1:]).sum()
    assert measured.factor == pytest.approx(expected, abs=0.1)


def test_the_mean_of_a_track_is_as_uncertain_as_stated() -> None:
    """What the factor is for: eight sightings with lambda R each, against the spread of their mean."""
    rng = np.random.default_rng(1)
    errors = repeating(rng, 0.5, LAGS + 1, (20_000, 1))
    measured = ErrorCorrelation()
    for _ in range(20):
        some = repeating(rng, 0.5, LAGS + 1, (2000, 1))
        measured.learn(some[-1], np.swapaxes(some[-2::-1], 0, 1))
    stated = measured.factor / (LAGS + 1)
    assert errors.mean(axis=0).var() == pytest.approx(stated, rel=0.1)
    # Without the factor the mean's variance would be stated less than half as large as it is.
    assert errors.mean(axis=0).var() > 2.0 / (LAGS + 1)


def test_what_is_stated_is_a_floor() -> None:
    measured = ErrorCorrelation()
    nothing = np.full((50, LAGS, 3), np.nan)
    for _ in range(100):
        measured.learn(0.1 * np.ones((50, 3)), nothing)
    assert measured.means[0] < 0.05
    assert measured.factor == 1.0


def test_before_anything_is_measured_errors_are_taken_to_repeat() -> None:
    assert 2.5 < ErrorCorrelation().factor < 4.5


@pytest.mark.parametrize(("rho", "low", "high"), [(0.0, 1.0, 1.4), (0.7, 2.2, 6.0)])
def test_the_stream_states_what_its_tracks_innovations_show(
    monkeypatch: pytest.MonkeyPatch, rho: float, low: float, high: float
) -> None:
    """A standing camera whose corners have white errors, or such that repeat themselves."""
    points = Points()
    robot = Following(monkeypatch, PAIR)
    errors = 0.5 * repeating(np.random.default_rng(3), rho, 60, (60, 2))
    exact = points.view(np.eye(4))
    for k in range(60):
        seen = robot.see(exact.moved(slice(None), errors[k]))
    factors = seen.detections.R / R_PAIR.clip(1e-12)
    assert np.ptp(factors[:, 0, 0]) == 0.0
    np.testing.assert_allclose(seen.detections.R, factors[0, 0, 0] * np.tile(R_PAIR, (len(factors), 1, 1)))
    assert low <= factors[0, 0, 0] <= high


def test_a_track_that_was_out_of_sight_begins_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    points = Points()
    robot = Following(monkeypatch, PAIR)
    exact = points.view(np.eye(4))
    for k in range(7):
        robot.see(exact if k != 4 else exact.only(np.arange(1, 60)))
    known = np.isfinite(robot.tracker._tracks.innovation[:, :, 0]).sum(axis=1)
    # The two first innovations of a track are left out, and what came before a gap.
    assert known[0] == 2
    assert (known[1:] == 4).all()
