"""KITTI's odometry sequences, gray; the source is kitti_odometry. The site asks for a login."""

from __future__ import annotations

from slamcmp.datasets.fetching.data_set import DataSet
from slamcmp.registry import data_sets


@data_sets.register("kitti_odometry")
def _odometry() -> DataSet:
    page = "https://www.cvlibs.net/datasets/kitti/eval_odometry.php"
    return DataSet(
        name="kitti_odometry",
        title="KITTI odometry, sequences 00 to 21: gray stereo images, calibration, poses of 00 to 10",
        licence="CC BY-NC-SA 3.0 (not for commerce), https://creativecommons.org/licenses/by-nc-sa/3.0/",
        citation="A. Geiger, P. Lenz, R. Urtasun, Are we ready for autonomous driving? The KITTI vision "
        "benchmark "
        "suite, CVPR 2012",
        page=page,
        folder="kitti",
        required=("sequences/*/calib.txt", "sequences/*/image_0/*.png", "poses/*.txt"),
        how=f"register at {page}, download data_odometry_gray.zip, data_odometry_calib.zip and "
        "data_odometry_poses.zip, and unpack all three",
        size="22 GB (the page's word)",
        use="{name: kitti_odometry, folder: kitti/sequences/06}",
    )
