"""Parameters of planar worlds: listed, explained, and refused where they contradict one another."""

from __future__ import annotations

import inspect

import pytest

from slamcmp.errors import UsageError
from slamcmp.registry import sources
from slamcmp.worlds.settings import Settings, field_docs
from tests.worlds.planar_logs import WORLDS, make


def test_parameters_are_listed_for_the_configuration():
    shared = sources.get("circle").parameters().keys() & sources.get("random").parameters().keys()
    assert {"steps", "landmarks", "sensor", "noise_scale", "outlier_fraction", "odometry"} <= shared
    assert sources.get("lawnmower").parameters()["rows"].default == 6
    assert sources.get("corridor").parameters()["turn_deg_s"].default == 45.0
    assert sources.get("circle").parameters()["turn_deg_s"].default == 6.0
    for name in WORLDS:
        plugin = sources.get(name)
        assert plugin.traits["seeded"] is True
        assert not plugin.summary.startswith("dict")
        for parameter in plugin.parameters().values():
            assert parameter.default is not inspect.Parameter.empty
            assert not isinstance(parameter.annotation, str)


@pytest.mark.parametrize(
    ("name", "parameters", "message"),
    [
        ("circle", {"range_min_m": 5.0, "range_max_m": 5.0}, "largest range must be above"),
        ("circle", {"range_min_m": 0.0}, "must be positive"),
        ("circle", {"steps": 1}, "steps at least 2"),
        ("circle", {"odometry": "tricycle"}, "tricycle"),
        ("circle", {"colour": 3}, "no parameter 'colour'"),
        ("lawnmower", {"rows": 3}, "even number"),
        ("circle", {"sensor": "sonar"}, "sonar"),
    ],
)
def test_contradictions_are_refused(name, parameters, message):
    with pytest.raises(UsageError, match=message):
        make(name, **parameters)


def test_walk_in_a_square_smaller_than_the_turning_circle_is_refused() -> None:
    # 1 m/s at 3 deg/s: the circle's diameter is 2 / (3 pi / 180) = 38.2 m.
    with pytest.raises(UsageError, match=r"half_size_m is 20: .* within 38\.2 m .*; 31\.8 or more"):
        make("random", turn_deg_s=3.0)
    assert len(make("random", turn_deg_s=3.0, half_size_m=31.9, steps=2000).t) == 2000


def test_annulus_whose_bounds_are_swapped_is_refused() -> None:
    with pytest.raises(UsageError, match="annulus_min_m is 6 and annulus_max_m 5: "):
        make("circle", annulus_min_m=6.0)


def test_texts_of_the_settings_are_found() -> None:
    docs = field_docs()
    assert docs["turn_deg_s"] == "Turn rate in bends: with the speed it sets their radius."
    assert "steering_sigma_deg" in docs
    assert docs.keys() <= Settings.__dataclass_fields__.keys()
