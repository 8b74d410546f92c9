"""The published EKF-SLAM variants: each a chart and a linearisation policy, nothing else.

========================  ======================  ==========================
name                      chart                   Jacobians at
========================  ======================  ==========================
``ekf_world``             world-additive          the latest estimate
``ekf_fej``               world-additive          each variable's first estimate
``ekf_oc``                world-additive          the nearest points that keep the gauge
``ekf_ideal``             world-additive          the truth
``ekf_right_invariant``   right-invariant         the latest estimate
========================  ======================  ==========================

``ekf_slam`` is ``ekf_world`` without this engine, sooner; ``ekf_robocentric`` has another order of steps and
a file of its own. For ``new_landmarks`` and ``smooth`` see error_state_ekf.py, for ``robust`` and its width
../robust.py.
"""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Gt

from slamcmp.backends.entries import places_by_itself
from slamcmp.backends.filters.error_state.charts import RightInvariantChart, WorldChart
from slamcmp.backends.filters.error_state.linearisation import (
    FirstEstimates,
    LatestEstimate,
    ObservabilityConstrained,
    Truth,
)
from slamcmp.backends.filters.error_state_ekf import ErrorStateEkf, NewLandmarks
from slamcmp.backends.filters.loops import Loops, Recipe
from slamcmp.backends.robust import RobustKernel, robust_kernel
from slamcmp.registry import back_ends
from slamcmp.types import GroundTruth, Problem


@back_ends.register("ekf_world")
class WorldEkf(ErrorStateEkf):
    """The textbook EKF-SLAM: error additive in the world, Jacobians at the latest estimate.

    The numbers of ``ekf_slam``; with ``smooth`` it is that filter's fair partner in hindsight.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        new_landmarks: NewLandmarks = "join_first",
        smooth: bool = False,
        robust: RobustKernel = "none",
        robust_width: Annotated[float, Gt(0)] | None = None,
    ) -> None:
        chart = WorldChart(problem.sensor.space_dim)
        kernel = robust_kernel(robust, robust_width)
        super().__init__(
            problem, chart, LatestEstimate(), new_landmarks=new_landmarks, smooth=smooth, kernel=kernel
        )
        self._loops = Loops(self, Recipe("WORLD", new_landmarks == "join_first"))


@back_ends.register("ekf_fej")
class FirstEstimatesEkf(ErrorStateEkf):
    """First-estimates-Jacobian EKF-SLAM (Huang, Mourikis, Roumeliotis 2008).

    ``new_landmark_jacobian`` matters with ``update_first`` only: "predicted" keeps the gauge, "updated" is
    how published code has it. A map that has moved too far from its first estimates makes every correction
    worse: the filter then gives up, and says so (far_points.py).
    """

    def __init__(
        self,
        problem: Problem,
        *,
        new_landmarks: NewLandmarks = "join_first",
        new_landmark_jacobian: Literal["predicted", "updated"] = "predicted",
        smooth: bool = False,
        robust: RobustKernel = "none",
        robust_width: Annotated[float, Gt(0)] | None = None,
    ) -> None:
        policy = FirstEstimates(problem.T_world_body, new_at_predicted=new_landmark_jacobian == "predicted")
        chart = WorldChart(problem.sensor.space_dim)
        kernel = robust_kernel(robust, robust_width)
        super().__init__(problem, chart, policy, new_landmarks=new_landmarks, smooth=smooth, kernel=kernel)
        first = "FIRST" if new_landmark_jacobian == "predicted" else "FIRST_BUT_NEW"
        self._loops = Loops(self, Recipe("WORLD", new_landmarks == "join_first", policy=first))


@back_ends.register("ekf_oc")
class ObservabilityConstrainedEkf(ErrorStateEkf):
    """Observability-constrained EKF-SLAM (Huang, Mourikis, Roumeliotis 2010).

    With a single camera the pose's point of linearisation stays at its estimate (linearisation.py). It gives
    up as ``ekf_fej`` does.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        new_landmarks: NewLandmarks = "join_first",
        smooth: bool = False,
        robust: RobustKernel = "none",
        robust_width: Annotated[float, Gt(0)] | None = None,
    ) -> None:
        # A single camera's landmarks are far less known than the pose that they would shift.
        shift_pose = places_by_itself(problem.sensor)
        policy = ObservabilityConstrained(problem.T_world_body, shift_pose=shift_pose)
        chart = WorldChart(problem.sensor.space_dim)
        kernel = robust_kernel(robust, robust_width)
        super().__init__(problem, chart, policy, new_landmarks=new_landmarks, smooth=smooth, kernel=kernel)
        self._loops = Loops(self, Recipe("WORLD", new_landmarks == "join_first", policy="CONSTRAINED"))


@back_ends.register("ekf_right_invariant")
class RightInvariantEkf(ErrorStateEkf):
    """Right-invariant EKF-SLAM (Barrau, Bonnabel 2015; Zhang, Wu, Huang 2017)."""

    def __init__(
        self,
        problem: Problem,
        *,
        new_landmarks: NewLandmarks = "join_first",
        smooth: bool = False,
        robust: RobustKernel = "none",
        robust_width: Annotated[float, Gt(0)] | None = None,
    ) -> None:
        chart = RightInvariantChart(problem.sensor.space_dim, problem.T_world_body)
        kernel = robust_kernel(robust, robust_width)
        super().__init__(
            problem, chart, LatestEstimate(), new_landmarks=new_landmarks, smooth=smooth, kernel=kernel
        )
        self._loops = Loops(self, Recipe("RIGHT", new_landmarks == "join_first"))


@back_ends.register("ekf_ideal", needs_truth=True)
class IdealEkf(ErrorStateEkf):
    """EKF-SLAM with every Jacobian at the truth: what linearisation alone costs is the distance to it.

    Args:
        problem: prior and sensor.
        truth: the true poses, one a frame, and every landmark the stream observes.
    """

    def __init__(
        self,
        problem: Problem,
        truth: GroundTruth,
        *,
        new_landmarks: NewLandmarks = "join_first",
        smooth: bool = False,
        robust: RobustKernel = "none",
        robust_width: Annotated[float, Gt(0)] | None = None,
    ) -> None:
        chart = WorldChart(problem.sensor.space_dim)
        kernel = robust_kernel(robust, robust_width)
        policy = Truth(truth)
        super().__init__(problem, chart, policy, new_landmarks=new_landmarks, smooth=smooth, kernel=kernel)
        self._loops = Loops(
            self, Recipe("WORLD", new_landmarks == "join_first", policy="TRUTH", truth=policy)
        )
