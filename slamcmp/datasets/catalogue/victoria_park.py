"""Victoria Park: the log as it was recorded, and what iSAM made of it, which gtsam's wheel carries."""

from __future__ import annotations

from slamcmp.datasets.fetching.data_set import DataSet
from slamcmp.registry import data_sets

_CITATION = (
    "J. Guivant, E. Nebot, Optimization of the simultaneous localization and map-building algorithm for "
    "real-time implementation, IEEE Transactions on Robotics and Automation 17(3), 2001"
)
_PAGE = "http://www-personal.acfr.usyd.edu.au/nebot/victoria_park.htm"


@data_sets.register("victoria_park")
def _raw() -> DataSet:
    return DataSet(
        name="victoria_park",
        title="Victoria Park, Sydney: laser, dead reckoning and GPS of a utility car",
        licence="none is stated; cite the paper",
        citation=_CITATION,
        page=_PAGE,
        folder="victoria_park",
        required=("DRS.txt", "GPS.txt", "LASER.txt", "Sensors_manager.txt"),
        how=f"download the log in ASCII (DRS, GPS, LASER, Sensors_manager) from {_PAGE}",
        size="18 MB unpacked (ASCII)",
        use="{name: victoria_park_raw, path: victoria_park}",
        notes=(
            "LASER.txt is one single line of 362 numbers a scan; 81.91 m is no return.",
            "The GPS has gaps, one of 181 s.",
        ),
    )


@data_sets.register("victoria_park_wheel")
def _of_the_wheel() -> DataSet:
    return DataSet(
        name="victoria_park_wheel",
        title="Victoria Park as iSAM prepared it: 6969 poses, 151 trees, known association",
        licence="that of gtsam's wheel (BSD), which carries it; of the log none is stated",
        citation=_CITATION,
        page=_PAGE,
        folder="",
        required=("victoria_park.txt",),
        size="0.7 MB",
        use="{name: victoria_park}",
        in_wheel={"victoria_park.txt": "10596bac625acfe009080748b0ec9993fc9925a93370878c20288a22eeee5253"},
    )
