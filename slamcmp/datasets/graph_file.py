"""Logs from graph files: the user's own, or those in the gtsam wheel."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from annotated_types import Ge, Gt

from slamcmp.datasets.graph import Closures, graph_log
from slamcmp.datasets.graph_reader import Noise, read_graph
from slamcmp.datasets.wheel import find_file
from slamcmp.registry import sources
from slamcmp.types import Log


def _files(*, path: str, **_: Any) -> list[Path]:
    return [find_file(path)]


@sources.register("graph_file", seeded=False, files=_files, paths=("path",))
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
) -> Log:
    """A .graph or .g2o file with landmarks, or a pose graph whose revisited poses become place landmarks.

    ``path`` is a file, seen from the experiment file's folder or else from the working directory, or the name
    of one in the gtsam wheel (``w100.graph``). What a pose graph loses on
    the way is told in :mod:`slamcmp.datasets.graph`.

    Raises:
        MissingDataError: there is no such file.
        DataError: the file cannot be read, or has no chain of odometry.
    """
    file = find_file(path)
    return graph_log(
        read_graph(file, noise=noise),
        name=file.name,
        steps=steps,
        time_step_s=time_step_s,
        closures=closures,
        place_sigma_m=place_sigma_m,
        prior_position_sigma_m=prior_position_sigma_m,
        prior_heading_sigma_rad=prior_heading_sigma_rad,
    )
