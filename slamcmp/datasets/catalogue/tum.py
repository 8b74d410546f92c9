"""TUM RGB-D sequences; the source is tum_rgbd."""

from __future__ import annotations

from functools import partial

from slamcmp.datasets.fetching.data_set import Archive, DataSet
from slamcmp.registry import data_sets

_SEQUENCES = {
    1: ("xyz", "rpy", "desk", "desk2", "room", "360", "floor", "plant", "teddy"),
    2: ("xyz", "rpy", "desk"),
    3: ("long_office_household",),
}


def _sequence(camera: int, scene: str) -> DataSet:
    full = f"rgbd_dataset_freiburg{camera}_{scene}"
    return DataSet(
        name=f"tum_fr{camera}_{scene}",
        title=f"TUM RGB-D fr{camera}/{scene}: a Kinect's colour and depth images, truth by motion capture",
        licence="CC BY 4.0, https://creativecommons.org/licenses/by/4.0/",
        citation="J. Sturm, N. Engelhard, F. Endres, W. Burgard, D. Cremers, A benchmark for the "
        "evaluation of "
        "RGB-D SLAM systems, IROS 2012",
        page="https://cvg.cit.tum.de/data/datasets/rgbd-dataset",
        folder=f"tum/{full}",
        required=("rgb.txt", "depth.txt", "groundtruth.txt", "rgb/*.png", "depth/*.png"),
        archives=(Archive(f"https://cvg.cit.tum.de/rgbd/dataset/freiburg{camera}/{full}.tgz"),),
        use=f"{{name: tum_rgbd, folder: tum/{full}}}",
    )


for _camera, _scenes in _SEQUENCES.items():
    for _scene in _scenes:
        data_sets.register(f"tum_fr{_camera}_{_scene}")(partial(_sequence, _camera, _scene))
