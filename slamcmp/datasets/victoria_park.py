"""Victoria Park, Sydney: trees seen by a laser on a utility car (Guivant and Nebot), as iSAM prepared it.

The gtsam wheel carries it with known associations: 6969 poses, 151 landmarks, 3640 observations. The file
has relative positions with covariance 0.4 I; there is no ground truth. Pose and landmark ids share one
numbering there, and landmarks keep theirs.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from annotated_types import Ge

from slamcmp.datasets.graph import graph_log
from slamcmp.datasets.graph_reader import read_graph
from slamcmp.datasets.wheel import wheel_file
from slamcmp.models.sensors import cartesian_to_polar, make_sensor
from slamcmp.registry import sources
from slamcmp.types import Detections, Log, Problem

PRIOR_SIGMA = 1e-6
"""Of the first pose [m, rad]: it is the origin."""


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
    sigma sqrt(0.4) m and a bearing with sigma sqrt(0.4)/range rad. ``steps`` keeps the first poses only.

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
    return log if sensor == "relative_position" else _as_range_bearing(log)


def _as_range_bearing(log: Log) -> Log:
    detections = tuple(Detections(*cartesian_to_polar(seen.z, seen.R), seen.ids) for seen in log.detections)
    problem = Problem(log.problem.T_world_body, log.problem.P, make_sensor("range_bearing", {}))
    return Log(log.name, problem, log.t, log.T_prev_body, log.Q, detections)
