"""Huang's simulated sets of OpenSLAM's 2d-i-slsjf; the source is slamcmp/datasets/slsjf.py."""

from __future__ import annotations

from slamcmp.datasets.fetching.data_set import DataSet
from slamcmp.registry import data_sets


@data_sets.register("slsjf_8240")
def _set_8240() -> DataSet:
    page = "https://openslam-org.github.io/2d-i-slsjf.html"
    parts = ("store_speed", "store_turnrate", "sensor_data", "store_robotTrue", "store_beaconsTrue")
    return DataSet(
        name="slsjf_8240",
        title="2-D I-SLSJF, simulated set 8240: 8241 poses, 40 524 sightings of 612 beacons, exact truth",
        licence="none lies in the set; see the page of OpenSLAM",
        citation="S. Huang, Z. Wang, G. Dissanayake, Sparse local submap joining filter for building "
        "large-scale "
        "maps, IEEE Transactions on Robotics 24(5), 2008",
        page=page,
        folder="slsjf_sim/8240",
        required=tuple(f"{part}.mat" for part in parts),
        how=f"download the simulated data sets from {page} and take the folder of set 8240",
        size="1.1 MB unpacked",
        use="{name: slsjf, path: slsjf_sim/8240}",
        notes=(
            "What parameters.txt calls variances are standard deviations; the turn rate's is really 2.85 "
            "deg/s.",
        ),
    )
