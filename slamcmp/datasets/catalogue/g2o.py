"""Pose graphs in g2o's format from Luca Carlone's collection; the source is graph_file."""

from __future__ import annotations

from functools import partial

from slamcmp.datasets.fetching.data_set import Archive, DataSet
from slamcmp.registry import data_sets

_PAGE = "https://lucacarlone.mit.edu/datasets/"
_PLANAR = (
    "L. Carlone, A. Censi, From angular manifolds to the integer lattice: guaranteed orientation "
    "estimation with "
    "application to pose graph optimization, IEEE Transactions on Robotics 30(2), 2014"
)
_SPATIAL = (
    "L. Carlone, R. Tron, K. Daniilidis, F. Dellaert, Initialization techniques for 3D SLAM: a survey on "
    "rotation "
    "estimation and its use in pose graph optimization, ICRA 2015"
)
_GRAPHS = {
    "g2o_intel": ("Intel Research Lab, planar", "vcz8cag7bo0zlaj/input_INTEL_g2o.g2o", _PLANAR),
    "g2o_mit": ("MIT Killian Court, planar", "d8fcn1jg1mebx8f/input_MITb_g2o.g2o", _PLANAR),
    "g2o_m3500": ("Manhattan world M3500, planar, simulated", "gmdzo74b3tzvbrw/input_M3500_g2o.g2o", _PLANAR),
    "g2o_parking_garage": ("a parking garage, in space", "zu23p8d522qccor/parking-garage.g2o", _SPATIAL),
}


def _graph(name: str) -> DataSet:
    title, place, citation = _GRAPHS[name]
    file_name = place.rsplit("/", 1)[-1]
    return DataSet(
        name=name,
        title=f"Pose graph: {title}",
        licence="none is stated; cite the papers of the page",
        citation=citation,
        page=_PAGE,
        folder=f"g2o/{name.removeprefix('g2o_')}",
        required=(file_name,),
        archives=(Archive(f"https://www.dropbox.com/s/{place}?dl=1", called=file_name),),
        use=f"{{name: graph_file, path: g2o/{name.removeprefix('g2o_')}/{file_name}}}",
        notes=("Pose graphs have no landmarks: filters that need them see odometry alone.",),
    )


for _name in _GRAPHS:
    data_sets.register(_name)(partial(_graph, _name))
