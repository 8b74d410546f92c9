"""Same seed, same digest: in every process, and where the last bits of another machine differ."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from slamcmp import geometry as g
from slamcmp.models.motion import Unicycle
from slamcmp.models.sensors import RangeBearing
from tests.worlds.planar_logs import ODOMETRY, WORLDS, as_stream, make


@pytest.mark.parametrize("odometry", ODOMETRY)
def test_sensed_numbers_are_rounded(odometry):
    log = make("random", odometry=odometry, steps=50)
    numbers = [g.se2_coordinates(log.T_prev_body)[:, :2].ravel()]
    numbers += [seen.z[:, 0] for seen in log.detections]
    scaled = np.concatenate(numbers) * 1e9
    np.testing.assert_allclose(scaled, np.round(scaled), rtol=0, atol=1e-5)


@pytest.mark.parametrize("name", WORLDS)
def test_seeds_differ_and_repeat(name):
    digests = [as_stream(make(name, seed, steps=40)).digest for seed in (1, 2, 1)]
    assert digests[0] == digests[2] != digests[1]


def test_two_processes_agree_on_the_digest():
    code = (
        "from tests.worlds.planar_logs import *\n"
        "print(*(as_stream(make(name, 5, steps=60, outlier_fraction=0.1)).digest for name in WORLDS))"
    )
    there = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    here = [as_stream(make(name, 5, steps=60, outlier_fraction=0.1)).digest for name in WORLDS]
    assert there.stdout.split() == here


@pytest.mark.parametrize("name", WORLDS)
def test_last_bits_of_another_machine_leave_the_digest(name, monkeypatch):
    """Another libm's sines differ in the last bit; every number that went through one is moved by that."""
    here = as_stream(make(name, 3, steps=60)).digest

    def nudge(owner, method):
        original = getattr(owner, method)

        def nudged(*arguments):
            result = original(*arguments)
            return np.nextafter(result, np.where(result == 0, 0, np.inf))

        monkeypatch.setattr(owner, method, nudged)

    nudge(Unicycle, "increment")
    nudge(Unicycle, "jacobian")
    nudge(RangeBearing, "predict")
    moved = make(name, 3, steps=60)
    assert as_stream(moved).digest == here
    # With every bit kept, the same nudges show.
    exact = as_stream(make(name, 3, steps=60, resolution=0.0)).digest
    monkeypatch.undo()
    assert as_stream(make(name, 3, steps=60, resolution=0.0)).digest != exact
