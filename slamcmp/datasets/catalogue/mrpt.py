"""MRPT's logs for its own Kalman-filter SLAM; no source reads them yet."""

from __future__ import annotations

from slamcmp.datasets.fetching.data_set import DataSet
from slamcmp.registry import data_sets


@data_sets.register("mrpt_kf_slam")
def _kf_slam() -> DataSet:
    page = "https://github.com/MRPT/mrpt/tree/master/share/mrpt/datasets"
    return DataSet(
        name="mrpt_kf_slam",
        title="MRPT kf-slam demos: simulated range-bearing logs in the plane and in space, with text truth",
        licence="BSD-3-Clause (MRPT)",
        citation="J.-L. Blanco and others, the Mobile Robot Programming Toolkit, https://www.mrpt.org",
        page=page,
        folder="mrpt_kf_slam",
        required=(
            "kf-slam*_demo*.rawlog",
            "kf-slam*_ground_truth.txt",
            "kf-slam*_ground_truth_robot_path.txt",
        ),
        how=f"download the files kf-slam_*demo* of {page} (Debian's package mrpt-common has them)",
        size="0.6 MB",
        notes=("The logs themselves are in MRPT's binary format (rawlog); truth is text.",),
    )
