"""Detections of all frames at once against a sensor that looks frame by frame."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from slamcmp.geometry import wrap
from slamcmp.models.sensors import make_sensor
from slamcmp.randomness import random_streams
from slamcmp.registry import sources
from slamcmp.support.configuration.plugin_models import bind_parameters
from slamcmp.types import Log
from slamcmp.worlds.outliers import OutlierDraws
from slamcmp.worlds.settings import Settings

CASES: list[dict[str, Any]] = [
    {},
    {"sensor": "relative_position", "resolution": 0.0, "first_look": 1},
    {"outlier_fraction": 0.2},
    {"outlier_fraction": 0.2, "sensor": "relative_position"},
    {"wrong_association_fraction": 0.3, "clutter_per_frame": 1.5, "burst_probability": 0.05},
    {"wrong_association_fraction": 0.3, "clutter_per_frame": 1.5, "sensor": "relative_position"},
    {"range_min_m": 2.0, "field_of_view_deg": 100.0, "range_sigma_m": 2.0},
]


def frame_by_frame(
    log: Log, settings: Settings, seed: int
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Readings, labels and which of them are outliers, as the world's docstrings describe them."""
    assert log.truth is not None
    streams = random_streams(seed)
    draws = OutlierDraws(settings.outlier_rates(), streams.outliers)
    draws.slips(settings.steps - 1)
    polar, is_polar = make_sensor("range_bearing", {}), settings.sensor == "range_bearing"
    sensor = polar if is_polar else make_sensor("relative_position", {"space_dim": 2})
    half = math.radians(settings.field_of_view_deg) / 2
    sigmas = [settings.range_sigma_m, math.radians(settings.bearing_sigma_deg)]
    sigmas = np.array(sigmas if is_polar else [settings.position_sigma_m] * 2) * settings.noise_scale
    low, high = np.array([settings.range_min_m, -half]), np.array([settings.range_max_m, half])
    landmarks = log.truth.positions
    found = []
    for k, T in enumerate(log.truth.T_world_body):
        noise = streams.sensor.standard_normal(landmarks.shape)
        luck = streams.outliers.random((len(landmarks), 3))
        geometry = polar.predict(T, landmarks)
        seen = ((geometry >= low) & (geometry <= high)).all(axis=1) & (k >= settings.first_look)
        of = draws.measured_instead(seen)
        ghosts = draws.ghosts(seen) & (k >= settings.first_look)
        wild = (luck[:, 0] < settings.outlier_fraction) | ghosts | draws.in_burst()
        readings = sensor.predict(T, landmarks)[of] + sigmas * noise
        false = low + (high - low) * luck[:, 1:]
        readings[wild] = false[wild] if is_polar else polar.invert(np.eye(3), false[wild])
        if settings.resolution:
            readings = np.round(readings / settings.resolution) * settings.resolution
        seen = seen | ghosts
        if is_polar:
            readings[:, 1] = wrap(readings[:, 1])
            seen = seen & (readings[:, 0] > 0)
        ids = np.flatnonzero(seen)
        found.append((readings[ids], ids, (wild | (of != np.arange(of.size)))[ids]))
    return found


@pytest.mark.parametrize("case", CASES)
def test_all_frames_at_once_are_the_frames_one_by_one(case: dict[str, Any]) -> None:
    plugin = sources.get("circle")
    parameters = bind_parameters(plugin, {"steps": 120, "landmarks": 15, **case})
    log = plugin.target(3, **parameters)
    assert log.truth is not None
    assert log.truth.outliers is not None
    known = {name: value for name, value in parameters.items() if name in Settings.__dataclass_fields__}
    expected = frame_by_frame(log, Settings(**known), 3)
    for detections, outliers, (z, ids, spoilt) in zip(
        log.detections, log.truth.outliers, expected, strict=True
    ):
        np.testing.assert_array_equal(detections.ids, ids)
        np.testing.assert_array_equal(detections.z, z)
        np.testing.assert_array_equal(outliers, spoilt)
    assert sum(ids.size for _, ids, _ in expected) > 100
