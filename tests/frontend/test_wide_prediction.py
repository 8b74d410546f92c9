"""A landmark that comes into view again, expected to metres only: the test keeps its share all the same."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import bdtr, chdtri

from slamcmp.frontend.landmark_tracks import LandmarkTracks
from slamcmp.models.sensors import make_sensor


@pytest.mark.parametrize("sensor_name", ["range_bearing", "relative_position"])
def test_a_wide_prediction_rejects_no_more_than_its_share(sensor_name: str) -> None:
    """2000 landmarks 4 m away, expected within 2 m: at 99 % about 20 fail; above 41 is a chance of 1e-5."""
    rng = np.random.default_rng(5)
    sensor = make_sensor(sensor_name, {})
    count, spread = 2000, 2.0
    angle = rng.uniform(-np.pi, np.pi, count)
    expected = 4.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    R = np.broadcast_to(np.diag([0.1, 0.02 if sensor_name == "range_bearing" else 0.1]) ** 2, (count, 2, 2))
    tracks = LandmarkTracks(sensor, float(chdtri(2, 0.01)), 5, 1)
    ids = np.arange(count)
    tracks.test(ids, sensor.predict(np.eye(3), expected), R)
    tracks._C[:] = spread**2 * np.eye(2)
    z = sensor.predict(np.eye(3), expected + spread * rng.standard_normal((count, 2)))
    z += rng.standard_normal((count, 2)) * np.sqrt(np.diagonal(R, axis1=1, axis2=2))
    rejected = int(tracks.test(ids, z, R).rejected.sum())
    assert 1.0 - bdtr(rejected - 1, count, 0.01) > 1e-5
