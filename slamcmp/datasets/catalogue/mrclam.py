"""UTIAS MRCLAM, sets 1 to 9; the source is slamcmp/datasets/mrclam.py."""

from __future__ import annotations

from functools import partial

from slamcmp.datasets.fetching.data_set import NOT_KNOWN, Archive, DataSet
from slamcmp.registry import data_sets

_ROBOT_FILES = tuple(
    f"Robot{robot}_{kind}.dat" for robot in range(1, 6) for kind in ("Odometry", "Measurement", "Groundtruth")
)
_SIZES = {6: "26 MB unpacked"}
_NOTES = (
    "Measurement files name barcodes, whatever their header says; Barcodes.dat tells whose they are.",
    "Odometry is commanded velocity: it leads the motion by about 0.2 s and is 5 to 13 % too long.",
)
_OF_ONE = {
    1: "The barcodes of subjects 11 and 17 are exchanged; the source changes them back.",
    4: "The archive's own folder is called MRSLAM_Dataset4; it is renamed.",
    9: "Barriers stood between the robots: few landmarks are seen at a time.",
}


def _set(number: int) -> DataSet:
    return DataSet(
        name=f"mrclam{number}",
        title=f"UTIAS Multi-Robot Cooperative Localization and Mapping, set {number}",
        licence="none is stated; cite the paper",
        citation="K. Leung, Y. Halpern, T. Barfoot, H. Liu, The UTIAS multi-robot cooperative localization "
        "and "
        "mapping dataset, International Journal of Robotics Research 30(8), 2011",
        page="http://asrl.utias.utoronto.ca/datasets/mrclam/",
        folder=f"mrclam/MRCLAM_Dataset{number}",
        required=("Barcodes.dat", "Landmark_Groundtruth.dat", *_ROBOT_FILES),
        archives=(Archive(f"ftp://asrl3.utias.utoronto.ca/MRCLAM/MRCLAM{number}.zip"),),
        size=_SIZES.get(number, NOT_KNOWN),
        use=f"{{name: mrclam, path: mrclam/MRCLAM_Dataset{number}, robot: 1}}",
        notes=(*_NOTES, *([_OF_ONE[number]] if number in _OF_ONE else [])),
    )


for _number in range(1, 10):
    data_sets.register(f"mrclam{_number}")(partial(_set, _number))
