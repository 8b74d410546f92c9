"""Parameters in words: their unit is read off the name, whole."""

from __future__ import annotations

import re

import pytest

from slamcmp.registry import back_ends, front_ends, sources
from slamcmp.results.words import parameter_words, parameters_in_words, setting_in_words


@pytest.mark.parametrize(
    ("path", "words", "setting"),
    [
        ("source.turn_sigma_deg_s", "turn sigma [°/s]", "turn sigma = 2°/s"),
        ("source.speed_m_s", "speed [m/s]", "speed = 2 m/s"),
        ("source.turn_sigma_rad_sqrt_s", "turn sigma [rad/√s]", "turn sigma = 2 rad/√s"),
        ("source.translation_sigma_per_m", "translation sigma [per m]", "translation sigma = 2 per m"),
        ("source.range_sigma_m", "range sigma [m]", "range sigma = 2 m"),
        ("source.bearing_sigma_deg", "bearing sigma [°]", "bearing sigma = 2°"),
        ("source.time_step_s", "time step [s]", "time step = 2 s"),
        ("source.steps", "steps", "steps = 2"),
        ("back_ends.w 5.lag_frames", "lag frames of w 5", "lag frames of w 5 = 2"),
        ("back_ends.A.heading_sigma_max_deg", "heading sigma max [°] of A", "heading sigma max of A = 2°"),
        ("seeds", "seeds", "seeds = 2"),
    ],
)
def test_words_and_a_value_with_its_unit(path, words, setting):
    assert parameter_words(path) == words
    assert setting_in_words(words, "2") == setting
    assert setting_in_words(words, "none").endswith("= none")


def test_no_parameter_of_any_plug_in_leaves_a_piece_of_its_unit_among_the_words():
    names = {
        name
        for registry in (sources, front_ends, back_ends)
        for plugin in registry
        for name in {*plugin.parameters(), *(plugin.traits.get("parameter_docs") or dict)()}
    }
    assert len(names) > 80
    for name in names:
        words = re.sub(r"\[.*?\]", "", parameter_words(f"source.{name}"))
        assert not re.search(r"\b(m|mm|m2|deg|rad|s|ms|px|hz|sqrt)\b", words), name
        assert "_" not in words


def test_two_that_read_alike_say_their_section():
    paths = ["source.max_range_m", "front_end.max_range_m", "source.steps"]
    assert parameters_in_words(paths) == {
        "source.max_range_m": "max range [m] (source)",
        "front_end.max_range_m": "max range [m] (front end)",
        "source.steps": "steps",
    }
    both = parameters_in_words(paths)
    assert setting_in_words(both["source.max_range_m"], "3") == "max range (source) = 3 m"
