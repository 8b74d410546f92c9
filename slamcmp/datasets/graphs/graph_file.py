"""Logs from graph files: the user's own, or those in the gtsam wheel."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Gt

from slamcmp.datasets.folders import find_data_file
from slamcmp.datasets.graphs.graph import Closures, graph_log
from slamcmp.datasets.graphs.graph_reader import Noise, read_graph
from slamcmp.datasets.time_stamps import TimeUnit
from slamcmp.datasets.trajectories import MAX_GAP_S, read_poses_at
from slamcmp.datasets.wheel import find_file
from slamcmp.geometry import se2
from slamcmp.registry import sources
from slamcmp.types import GroundTruth, Log

VERTICES = "vertices"
"""In place of a truth file: the graph's own vertices are the truth."""


def _files(*, path: str, truth: str | None = None, **_: Any) -> list[Path]:
    return [find_file(path), *([] if truth in (None, VERTICES) else [find_data_file(truth)])]


@sources.register("graph_file", seeded=False, files=_files, paths=("path", "truth"))
def graph_file(
    seed: int = 0,  # noqa: ARG001
    *,
    path: str,
    noise: Noise = "auto",
    steps: Annotated[int, Ge(2)] | None = None,
    time_step_s: Annotated[float, Gt(0)] = 1.0,
    closures: Closures = "factors",
    place_sigma_m: Annotated[float, Gt(0)] = 0.01,
    prior_position_sigma_m: Annotated[float, Gt(0)] = 1e-6,
    prior_heading_sigma_rad: Annotated[float, Gt(0)] = 1e-6,
    truth: str | None = None,
    truth_time_unit: TimeUnit = "auto",
    truth_max_gap_s: Annotated[float, Gt(0)] = MAX_GAP_S,
) -> Log:
    """A .graph or .g2o file: landmarks, loop closures between poses, or both.

    ``path`` is a file, seen from the experiment file's folder or else from the working directory, or the name
    of one in the gtsam wheel (``w100.graph``). ``closures`` says what becomes of edges between poses that are
    not neighbours: ``factors`` for smoothers, or ``places``, sights of places that every back end can use
    (:mod:`slamcmp.datasets.graphs.graph`).

    ``truth`` is ``vertices`` where the file's vertices are the truth (as a rule they are a first guess), or a
    file with lines ``t x y z qx qy qz qw`` here, beside the experiment file or under ``SLAMCMP_DATA``; of a
    planar graph x, y and the heading count. Its stamps are those of the graph (or ``time_step_s`` apart), in
    ``truth_time_unit``; between poses at most ``truth_max_gap_s`` apart it is interpolated.

    Raises:
        MissingDataError: there is no such file.
        DataError: a file cannot be read, the graph has no chain of odometry, or the truth other times.
    """
    file = find_file(path)
    log = graph_log(
        read_graph(file, noise=noise),
        name=file.name,
        steps=steps,
        time_step_s=time_step_s,
        closures=closures,
        place_sigma_m=place_sigma_m,
        prior_position_sigma_m=prior_position_sigma_m,
        prior_heading_sigma_rad=prior_heading_sigma_rad,
        vertices_are_truth=truth == VERTICES,
    )
    if truth is None or truth == VERTICES:
        return log
    told: list[str] = []
    poses = read_poses_at(
        find_data_file(truth),
        log.t,
        time_unit=truth_time_unit,
        max_gap_s=truth_max_gap_s,
        parameters=("truth_time_unit", "truth_max_gap_s"),
        told=told,
    )
    n = log.problem.sensor.space_dim
    if n == 2:
        poses = se2(poses[:, 0, 3], poses[:, 1, 3], np.arctan2(poses[:, 1, 0], poses[:, 0, 0]))
    known = GroundTruth(log.t, poses, np.empty(0, np.int64), np.empty((0, n)))
    return replace(log, truth=known, warnings=(*log.warnings, *told))
