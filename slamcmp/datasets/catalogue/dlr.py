"""The DLR spatial-cognition landmarks."""

from __future__ import annotations

from slamcmp.datasets.fetching.data_set import DataSet
from slamcmp.registry import data_sets


@data_sets.register("dlr")
def _dlr() -> DataSet:
    page = "http://www.sfbtr8.spatial-cognition.de/insidedataassociation/"
    return DataSet(
        name="dlr",
        title="DLR spatial cognition: discs on the floor of a building, with associations made by hand",
        licence="none is stated; cite the report",
        citation="J. Kurlbaum, U. Frese, A benchmark data set for data association, SFB/TR 8 report "
        "017-02/2009",
        page=page,
        folder="dlr",
        required=("map.circles",),
        how=f"download the data set (map.circles) from {page}",
        size="1.6 MB (map.circles)",
        use="{name: dlr, path: dlr}",
        notes=(
            "The robot's frame is -Y ahead and X to the right; id -1 is a landmark that nobody identified.",
            "There is no metric truth.",
        ),
    )
