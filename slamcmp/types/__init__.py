"""The frozen dataclasses that flow from source to report.

n = 2 or 3 is the space, p = 3 or 6 the pose's tangent, m the observations of a frame, d their dimension,
K the frames, L the landmarks. Poses are homogeneous matrices ``T_world_body (n+1, n+1)`` in metres. Every
covariance of a pose is in the body tangent, ``T = T_hat exp(xi)``, in the order (x, y, theta) for SE(2) and
(omega, v) for SE(3). All arrays are float64 (ids: int64), checked for shape and made read-only.
"""

from __future__ import annotations

from slamcmp.types.arrays import BoolArray, FloatArray, IntArray
from slamcmp.types.association import Association
from slamcmp.types.checks import TANGENT_DIM, frozen
from slamcmp.types.log import CameraFrame, Detections, GroundTruth, Log, Problem, RelativePoses
from slamcmp.types.results import Estimate, Landmarks, Run, Status, Trajectory
from slamcmp.types.sensor import SensorModel
from slamcmp.types.stream import Frame, FrontEndReport, MeasurementStream

__all__ = [
    "TANGENT_DIM",
    "Association",
    "BoolArray",
    "CameraFrame",
    "Detections",
    "Estimate",
    "FloatArray",
    "Frame",
    "FrontEndReport",
    "GroundTruth",
    "IntArray",
    "Landmarks",
    "Log",
    "MeasurementStream",
    "Problem",
    "RelativePoses",
    "Run",
    "SensorModel",
    "Status",
    "Trajectory",
    "frozen",
]
