"""What docs/vision.md says of several levels is what ``benchmarks/levels.py`` wrote down."""

from __future__ import annotations

import json
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def test_the_cost_of_levels_is_the_measured_one() -> None:
    result = json.loads((ROOT / "benchmarks/results/levels.json").read_text())
    text = re.sub(r"\s+", " ", (ROOT / "docs/vision.md").read_text())
    for levels, words in ((4, "Four levels cost {} to {} times"), (8, "eight {} to {} times")):
        times = [each[f"levels_{levels}"]["time_ratio"] for each in result.values()]
        assert words.format(f"{min(times):.2f}", f"{max(times):.2f}") in text
    left = {name: f"{each['levels_4']['measurements_share']:.2f}" for name, each in result.items()}
    assert f"{left['rendered room, one camera']} are left in a rendered room" in text
    assert f"and {left['KITTI 06']} on KITTI 06" in text
    assert f"on 7-Scenes, {left['7-Scenes']} are left" in text
    one_camera = [float(left[name]) for name in ("rendered room, one camera", "KITTI 06")]
    assert all(abs(1.0 - share - 0.6) < 0.05 for share in one_camera)
