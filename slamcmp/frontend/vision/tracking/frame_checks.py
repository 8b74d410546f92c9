"""What is asked of each frame before it is used, and what the frames together say against their camera."""

from __future__ import annotations

from slamcmp.frontend.vision.checks.depth_share import DepthShare
from slamcmp.frontend.vision.checks.motion_check import frozen, same_picture
from slamcmp.frontend.vision.checks.pair_check import PairCheck
from slamcmp.frontend.vision.checks.seen_motion import SeenMotion
from slamcmp.frontend.vision.checks.travel_check import TravelCheck
from slamcmp.frontend.vision.image_pair import Features
from slamcmp.frontend.vision.tracking.measuring import Measured
from slamcmp.image_files import Size, image_problem
from slamcmp.models.camera import Camera, MonoCamera, RgbdCamera, StereoCamera
from slamcmp.types import CameraFrame, FloatArray

Increment = tuple[FloatArray, FloatArray]
"""T_prev_body (4, 4) and its covariance Q (6, 6)."""


class FrameChecks:
    """The checks of one recording, frame by frame.

    Args:
        camera: what the images were taken with.
        sensor: what the stream's measurements are made by.
        features: corners described in an image.
        depth_min_m: nearer points are not measured.
    """

    def __init__(
        self, camera: Camera, sensor: MonoCamera | StereoCamera, *, features: int, depth_min_m: float
    ) -> None:
        self._needs_right = isinstance(camera, StereoCamera)
        self._needs_depth = isinstance(camera, RgbdCamera)
        self._sensor = sensor
        self._features, self._depth_min_m = features, depth_min_m
        self._size: Size | None = None
        self._last, self._now = CameraFrame(None), CameraFrame(None)
        self._pair = PairCheck(camera) if isinstance(camera, StereoCamera) else None
        self._depth = DepthShare()
        self._travel = TravelCheck(camera)
        self._motion = SeenMotion(camera)

    def problem(self, frame: CameraFrame, since_image: Increment) -> str:
        """Why the frame cannot be used, ``since_image`` after the last that could; empty if it can.

        The first image that can be used sets the size of all.
        """
        if frame.image is None:
            return frame.problem or "no image"
        size = frame.image.shape[1], frame.image.shape[0]
        problem = image_problem(frame.image, size=self._size)
        if not problem and self._needs_right:
            of_right = image_problem(frame.right, size=size) or self._repeated_right(frame)
            problem = f"right image: {of_right}" if of_right else ""
        if not problem and self._needs_depth:
            if frame.depth_m is None:
                problem = "no depth image"
            elif frame.depth_m.shape != frame.image.shape:
                problem = "depth image of another size"
        problem = problem or frozen(self._now.image, frame.image, *since_image)
        if not problem:
            self._size = size
            self._last, self._now = self._now, frame
        return problem

    def look(self, features: Features, measured: Measured, since_image: Increment) -> None:
        """Take in what was found in the last frame without a problem."""
        frame, depth_m = self._now, None
        if self._pair is not None:
            self._pair.look(features, frame, self._features)
        if isinstance(self._sensor, StereoCamera):
            depth_m = self._sensor.depths(measured.z)
            repeated = same_picture(frame.depth_m, self._last.depth_m) and self._has_changed(frame)
            self._depth.look(depth_m, measured.valid, self._depth_min_m, repeated=repeated)
        self._travel.look(features, depth_m, since_image)
        self._motion.look(features, depth_m, since_image)

    def findings(self, step_s: float) -> list[str]:
        """What the images say against the calibration or the odometry, with the likely cause.

        ``step_s`` is the usual time between two images.
        """
        of_pair = [] if self._pair is None else self._pair.findings()
        # What is wrong with the pair is also why few points have a depth.
        of_depths = of_pair or self._depth.findings()
        of_travel = self._travel.findings()
        # Nor does the motion fit if the mounting is wrong, or the depths that it was found with.
        if of_pair or of_travel:
            return [*of_depths, *of_travel]
        return [*of_depths, *self._motion.findings(step_s, depths=not of_depths)]

    def _repeated_right(self, frame: CameraFrame) -> str:
        if same_picture(frame.right, frame.image):
            return "the same as the left one"
        if same_picture(frame.right, self._now.right) and not same_picture(frame.image, self._now.image):
            return "the same as before, while the left one changed: the right camera is frozen"
        return ""

    def _has_changed(self, frame: CameraFrame) -> bool:
        return not same_picture(frame.image, self._last.image)
