"""Plaza 1 and 2: ranges to radio beacons from a mower; gtsam's wheel carries both."""

from __future__ import annotations

from functools import partial

from slamcmp.datasets.fetching.data_set import DataSet
from slamcmp.registry import data_sets

_SUMS = {
    1: {
        "Plaza1_.mat": "9ccbfec19942eabecfa3206bff983bf708b98d6c7db462d81c55376f92d75847",
        "Plaza1_DR.txt": "41233e2e97d482c12a6cd074583c15fb47918d015a3d59e90d8b3b3cfba8b09d",
        "Plaza1_TD.txt": "56b6cdd86327da38143c0f2b2a3e4337908e1d3447c32b2897005ebbd3326be8",
    },
    2: {
        "Plaza2_.mat": "72f0abe0fea2050eb5ee1cffc8c43823266a35785b7cdecac4ec5eae727561a2",
        "Plaza2_DR.txt": "afd63364d0650e90ca1a9f13ceb9105104f52ab6768beb1cdf584ab9aada024e",
        "Plaza2_TD.txt": "05e884e9e131b805db71bacd345b8606e8d53fe21a6b5a3acbbb4f33d0a68cfd",
    },
}
_SIZES = {1: "1.8 MB", 2: "0.8 MB"}


def _set(number: int) -> DataSet:
    return DataSet(
        name=f"plaza{number}",
        title=f"Plaza {number}: odometry and ranges to radio beacons, truth by GPS",
        licence="that of gtsam's wheel (BSD), which carries it; of the recording none is stated",
        citation="J. Djugash, B. Hamner, S. Roth, Navigating with ranging radios: five data sets with ground "
        "truth, Journal of Field Robotics 26(9), 2009",
        page="http://www.frc.ri.cmu.edu/projects/emergencyresponse/RangeData/",
        folder="",
        required=tuple(_SUMS[number]),
        size=_SIZES[number],
        notes=("Ranges are too long by a constant share, 6.9 % (by 2.8 m in the mean): range_scale: 0.935.",),
        use=f"{{name: plaza, number: {number}}}",
        in_wheel=_SUMS[number],
    )


for _number in _SUMS:
    data_sets.register(f"plaza{_number}")(partial(_set, _number))
