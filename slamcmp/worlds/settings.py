"""What every planar landmark world can be told, in one place."""

from __future__ import annotations

import ast
import inspect
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Interval

from slamcmp.errors import UsageError
from slamcmp.worlds.outliers import OutlierRates

Positive = Annotated[float, Gt(0)]
NotNegative = Annotated[float, Ge(0)]
Share = Annotated[float, Interval(ge=0, le=1)]

SensorName = Literal["range_bearing", "relative_position", "range_only", "bearing_only"]
OdometryName = Literal["unicycle", "straight_then_turn", "bicycle", "encoders"]


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Parameters shared by all planar worlds; sigmas are standard deviations.

    Raises:
        UsageError: two values contradict each other.
    """

    steps: Annotated[int, Ge(2)] = 300
    """Frames, the first one included."""
    time_step_s: Positive = 1.0
    landmarks: Annotated[int, Ge(1)] = 40
    map_seed: Annotated[int, Ge(0)] | None = None
    """The landmarks' own seed: one map for all trials, as published studies have it; None: a map a seed."""
    speed_m_s: Positive = 1.0
    turn_deg_s: Positive = 6.0
    """Turn rate in bends: with the speed it sets their radius."""

    sensor: SensorName = "range_bearing"
    """Of ``range_only`` and ``bearing_only`` one sighting places no landmark: front end ``delayed_start``."""
    range_sigma_m: Positive = 0.1
    bearing_sigma_deg: Positive = 1.0
    position_sigma_m: Positive = 0.1
    """Per axis, for the sensor ``relative_position``."""
    range_min_m: Positive = 0.5
    """Nearer landmarks are not seen: a bearing at centimetres defeats any linearisation."""
    range_max_m: Positive = 8.0
    field_of_view_deg: Annotated[float, Interval(gt=0, le=360)] = 360.0
    """Full angle, centred on the direction of travel."""
    first_look: Annotated[int, Ge(0)] = 0
    """The first frame with detections; 1: the robot moves before it looks, as in published simulators. A look
    from an exactly known start ties the map's heading to the world and halves every error."""
    outlier_fraction: Annotated[float, Interval(ge=0, le=1)] = 0.0
    """Share of the detections that are replaced by a uniform draw from the field of view."""

    wrong_association_fraction: Share = 0.0
    """Share of the detections that measure another landmark of the same frame than their label says."""
    clutter_per_frame: NotNegative = 0.0
    """Mean number of ghosts a frame: draws from the field of view under labels of landmarks out of sight."""
    burst_probability: Share = 0.0
    """Chance that a burst begins with a frame: all that is seen in it is a draw from the field of view."""
    burst_frames: Annotated[int, Ge(1)] = 5
    """Frames that a burst lasts."""
    slip_probability: Share = 0.0
    """Chance that the wheels slip in a step: they turn further than the robot moves, and Q does not know."""
    slip_share: NotNegative = 0.5
    """How much further, as a share of the step; of ``encoders`` the left wheel's alone."""

    odometry: OdometryName = "unicycle"
    speed_sigma_m_s: NotNegative = 0.03
    turn_sigma_deg_s: NotNegative = 0.5
    """For ``unicycle`` and ``straight_then_turn``; 0 gives a known heading."""
    lateral_sigma_m: NotNegative = 0.005
    """Side slip a step; keeps Q positive definite, which factor graphs need."""
    process_substeps: Annotated[int, Ge(1)] = 1
    """Parts of a step with noise of their own, of the same total: from 2 on Q has full rank without side
    slip."""
    steering_sigma_deg: NotNegative = 0.5
    """For ``bicycle``."""
    wheelbase_m: Positive = 2.0
    """For ``bicycle``."""
    wheel_sigma_m: NotNegative = 0.01
    """Of the distance one wheel rolls in a step, for ``encoders``."""
    track_width_m: Positive = 0.5
    """For ``encoders``."""
    odometry_scale: Positive = 1.0
    """Multiplies the sigmas of the odometry alone, to study poor wheels among good sensors."""

    prior_position_sigma_m: NotNegative = 1e-6
    prior_heading_sigma_rad: NotNegative = 1e-6
    noise_scale: Positive = 1.0
    """Multiplies every sigma above, the prior's too: to study noise going to 0 (with resolution 0)."""
    resolution: NotNegative = 1e-9
    """What the sensors' numbers are rounded to, so that two machines' last bits agree; 0 keeps all bits."""

    def outlier_rates(self) -> OutlierRates:
        """What goes wrong on purpose, besides ``outlier_fraction``."""
        return OutlierRates(
            wrong_association_fraction=self.wrong_association_fraction,
            clutter_per_frame=self.clutter_per_frame,
            burst_probability=self.burst_probability,
            burst_frames=self.burst_frames,
            slip_probability=self.slip_probability,
            slip_share=self.slip_share,
        )

    def __post_init__(self) -> None:
        if self.range_max_m <= self.range_min_m:
            raise UsageError(
                f"range_max_m is {self.range_max_m} and range_min_m {self.range_min_m}: "
                "the largest range must be above the smallest"
            )
        if (
            min(self.range_min_m, self.noise_scale, self.odometry_scale) <= 0
            or self.steps < 2
            or self.landmarks < 1
        ):
            raise UsageError(
                "range_min_m, noise_scale and odometry_scale must be positive, steps at least 2, landmarks "
                f"at least 1; given {self.range_min_m}, {self.noise_scale}, {self.odometry_scale}, "
                f"{self.steps}, {self.landmarks}"
            )


def field_docs() -> dict[str, str]:
    """What stands below each field of :class:`Settings` that has such a text."""
    (definition,) = ast.parse(inspect.getsource(Settings)).body
    assert isinstance(definition, ast.ClassDef)
    return {
        field.target.id: inspect.cleandoc(str(text.value.value)).replace("\n", " ")
        for field, text in pairwise(definition.body)
        if isinstance(field, ast.AnnAssign)
        and isinstance(field.target, ast.Name)
        and isinstance(text, ast.Expr)
        and isinstance(text.value, ast.Constant)
    }
