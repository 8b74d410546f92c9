"""What people write where ``T_body_camera`` is asked for, and what they meant."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamcmp.geometry import inverse
from slamcmp.models.camera import FORWARD_CAMERA
from slamcmp.types import FloatArray

WHAT_IT_MAPS = "T_body_camera maps points of the camera (x right, y down, z forward) to the body"
_BACKWARDS = np.diag([-1.0, 1.0, -1.0, 1.0])


def mounting_mistakes(given: FloatArray) -> Iterator[tuple[FloatArray, str]]:
    """What a mounting (4, 4) may have been meant to be, and in words what is the matter with it."""
    yield inverse(given), "T_body_camera is inverted"
    transposed = given.copy()
    transposed[:3, :3] = given[:3, :3].T
    yield transposed, "the rotation of T_body_camera is transposed"
    yield given @ FORWARD_CAMERA, "T_body_camera was given for a camera whose x axis points forward"
    yield given @ _BACKWARDS, "the camera looks the other way, or the odometry runs backwards"
