"""The noise that a suspect is measured in, from its parts by hand."""

from __future__ import annotations

import numpy as np
import pytest

from slamcmp.backends.dead_reckoning import DeadReckoning
from slamcmp.experiment.job.run_back_end import run_back_end
from slamcmp.geometry import se2
from slamcmp.metrics.divergence import find_suspect
from slamcmp.models.sensors import make_sensor
from slamcmp.types import Frame, MeasurementStream, Problem


@pytest.mark.parametrize("earlier", [1, 3])
@pytest.mark.parametrize("changed", ["sensor", "odometry", "place"])
def test_measurement_step_and_place_all_count(earlier: int, changed: str) -> None:
    """Along x, without any heading: variance of this measurement + of this step + of the mean before."""
    now, step, before = (9.0 if part == changed else 1.0 for part in ("sensor", "odometry", "place"))
    sensor = make_sensor("relative_position", {})
    z, moved = np.array([[5.0, 0.0]]), se2(1.0, 0.0, 0.0)
    frames = []
    for k in range(earlier):
        R = before * np.eye(2)[None]
        frames.append(Frame(k, float(k), np.eye(3), np.zeros((3, 3)), np.array([4]), z, R))
    late = np.array([[4.0 + 6.0, 0.0]])
    Q = step * np.diag([1.0, 1.0, 0.0])
    frames.append(Frame(earlier, float(earlier), moved, Q, np.array([4]), late, now * np.eye(2)[None]))
    stream = MeasurementStream(Problem(np.eye(3), 1e-12 * np.eye(3), sensor), tuple(frames))
    run = run_back_end(DeadReckoning, stream, label="odometry", parameters={})
    suspect = find_suspect(stream, run, None, earlier, window=1)
    assert suspect is not None
    assert (suspect.k, suspect.landmark) == (earlier, 4)
    assert suspect.residual == pytest.approx(6.0)
    assert suspect.sigmas == pytest.approx(6.0 / np.sqrt(now + step + before / earlier))
