"""EuRoC MAV sequences; the source is euroc."""

from __future__ import annotations

from functools import partial

from slamcmp.datasets.fetching.data_set import Archive, DataSet
from slamcmp.registry import data_sets

_ROOT = "http://robotics.ethz.ch/~asl-datasets/ijrr_euroc_mav_dataset"
_SEQUENCES = {
    "machine_hall": ("MH_01_easy", "MH_02_easy", "MH_03_medium", "MH_04_difficult", "MH_05_difficult"),
    "vicon_room1": ("V1_01_easy", "V1_02_medium", "V1_03_difficult"),
    "vicon_room2": ("V2_01_easy", "V2_02_medium", "V2_03_difficult"),
}


def _sequence(place: str, sequence: str) -> DataSet:
    return DataSet(
        name=f"euroc_{sequence.lower()}",
        title=f"EuRoC MAV {sequence}: stereo images and IMU of a micro aerial vehicle",
        licence="none is stated in the archive (ASL, ETH Zurich); cite the paper",
        citation="M. Burri and others, The EuRoC micro aerial vehicle datasets, International Journal of "
        "Robotics "
        "Research 35(10), 2016",
        page="https://projects.asl.ethz.ch/datasets/doku.php?id=kmavvisualinertialdatasets",
        folder=f"euroc/{sequence}",
        required=(
            *("mav0/cam0/data.csv", "mav0/cam0/sensor.yaml", "mav0/cam0/data/*.png"),
            *("mav0/cam1/data.csv", "mav0/imu0/data.csv"),
        ),
        archives=(Archive(f"{_ROOT}/{place}/{sequence}/{sequence}.zip"),),
        use=f"{{name: euroc, folder: euroc/{sequence}}}",
    )


for _place, _sequences in _SEQUENCES.items():
    for _name in _sequences:
        data_sets.register(f"euroc_{_name.lower()}")(partial(_sequence, _place, _name))
