"""Victoria Park, Sydney: trees seen by a laser on a utility car (Guivant and Nebot), as iSAM prepared it.

The gtsam wheel carries it with known associations: 6969 poses, 151 landmarks, 3640 observations. The file
has relative positions with covariance 0.4 I; there is no ground truth. Pose and landmark ids share one
numbering there, and landmarks keep theirs.

The file has no time stamps. Its poses are the instants of the laser's scans, but for 261 of the 7230 scans
that were left out while the car stood. Which ones, the log's own wheel speeds and steering tell: the sequence
of scans whose motion in between fits the file's odometry best (every step within 0.1 m, the whole 4 km within
0.1 %). The laser's clock is so even that scan i of the log is at 0.852 + 0.2136298 i s to within 1.3 ms.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge

from slamcmp.datasets.graphs.graph import graph_log
from slamcmp.datasets.graphs.graph_reader import read_graph
from slamcmp.datasets.wheel import wheel_file
from slamcmp.models.sensors import cartesian_to_polar, make_sensor
from slamcmp.registry import sources
from slamcmp.types import Detections, FloatArray, Log, Problem

PRIOR_SIGMA = 1e-6
"""Of the first pose [m, rad]: it is the origin."""

_FIRST_SCAN_S, _SCAN_PERIOD_S = 0.85199, 0.2136298
_LEFT_OUT = (
    *((0, 11), (59, 31), (638, 14), (2881, 11), (2934, 11), (3665, 2), (3679, 1), (3680, 7), (3714, 2)),
    *((3718, 83), (3727, 5), (4175, 1), (4216, 3), (5299, 5), (6388, 1), (6389, 27), (6846, 6), (6849, 1)),
    *((6852, 1), (6900, 1), (6902, 6), (6925, 1)),
)
"""After which pose how many scans have none; 30 more follow the last."""


def _files(**_: Any) -> list[Path]:
    return [wheel_file("victoria_park.txt")]


@sources.register("victoria_park", seeded=False, files=_files)
def victoria_park(
    seed: int = 0,  # noqa: ARG001
    *,
    sensor: Literal["range_bearing", "relative_position"] = "range_bearing",
    steps: Annotated[int, Ge(2)] | None = None,
) -> Log:
    """Victoria Park from the gtsam wheel: a car among trees, 6969 poses, no ground truth.

    ``relative_position`` is the data as stored; ``range_bearing`` turns each position into a range with
    sigma sqrt(0.4) m and a bearing with sigma sqrt(0.4)/range rad. ``steps`` keeps the first poses only. Time
    stamps are those of the log's laser scans.

    Raises:
        MissingDataError: the gtsam wheel is not installed.
    """
    graph = read_graph(wheel_file("victoria_park.txt"), noise="covariance")
    log = graph_log(
        graph,
        name="victoria_park",
        steps=steps,
        prior_position_sigma_m=PRIOR_SIGMA,
        prior_heading_sigma_rad=PRIOR_SIGMA,
    )
    log = replace(log, t=_scan_times(log.t.size))
    return log if sensor == "relative_position" else _as_range_bearing(log)


def _scan_times(poses: int) -> FloatArray:
    """Time of each pose, (poses,) [s] on the log's clock."""
    skipped = np.zeros(poses, dtype=np.int64)
    for pose, count in _LEFT_OUT:
        skipped[pose + 1 :] += count
    return np.asarray(_FIRST_SCAN_S + _SCAN_PERIOD_S * (np.arange(poses) + skipped), dtype=np.float64)


def _as_range_bearing(log: Log) -> Log:
    detections = tuple(Detections(*cartesian_to_polar(seen.z, seen.R), seen.ids) for seen in log.detections)
    problem = Problem(log.problem.T_world_body, log.problem.P, make_sensor("range_bearing", {}))
    return Log(log.name, problem, log.t, log.T_prev_body, log.Q, detections)
