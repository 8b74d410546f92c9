"""Fixed-lag smoothing: the last poses are estimated together, older ones are marginalised.

========  =====================================================================
symbol    meaning
========  =====================================================================
P         covariance of the newest pose, body tangent, (p, p)
========  =====================================================================

Dellaert and Kaess 2017, "Factor graphs for robot perception", section 5.3.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import gtsam
import numpy as np
from annotated_types import Ge, Gt

from slamcmp.backends.fit import MAX_CHI2_PER_DOF, require_fit, require_majority
from slamcmp.backends.gtsam_smoothers.factors import pose_key
from slamcmp.backends.gtsam_smoothers.graph import GraphBuilder, diverged, require_finite
from slamcmp.backends.gtsam_smoothers.incremental import Factorization, isam2_parameters
from slamcmp.backends.gtsam_smoothers.robust_factors import (
    Narrowing,
    is_observation,
    replace_observations,
)
from slamcmp.backends.recent_landmarks import MOST_LANDMARKS, RecentLandmarks
from slamcmp.backends.robust import RobustKernel
from slamcmp.errors import UsageError
from slamcmp.registry import back_ends
from slamcmp.types import Estimate, FloatArray, Frame, Landmarks, Problem, Trajectory


@back_ends.register("fixed_lag")
class FixedLag:
    """Smoother over the last ``lag_frames`` frames and the newest one.

    The lag counts frames, not seconds, so that the window's size does not depend on time stamps.

    GTSAM keeps what is marginalised as a prior in the body axes of the point where it was linearised, and the
    estimate moves away from it: the prior then claims what no sensor saw about where the map lies. In the
    world of dial.yaml this makes NEES 8 (median of 12 seeds, 3 expected), where ``sliding_window`` of the
    same length, whose prior has world axes, has 3.2. Not that points are pinned: with first-estimates
    Jacobians in world axes it has 3.4, with GTSAM's prior in its place 6.8.

    Args:
        problem: prior and sensor.
        lag_frames: a pose leaves the window when it is older than this.
        mode: ``incremental`` updates a Bayes tree; ``batch`` iterates Levenberg-Marquardt over the window.
        landmarks: ``keep`` holds every landmark in the window for ever; ``drop`` marginalises one that was
            not seen for ``lag_frames`` frames, and a later sighting starts a new variable with no memory of
            it (cost per frame stays flat, old landmarks close no loops). Where one measurement does not
            place a landmark (a single camera), a later sighting is dropped, and counted.
        most_landmarks: with ``keep``: where the window holds more, those leave it as with ``drop`` that have
            not been seen for longest, and not for ``lag_frames`` frames, so that from there on the cost of a
            frame grows no further; null keeps every one, at a cost that grows with their number.
        relinearize_threshold: as in ``isam2``; for ``incremental``.
        relinearize_skip: as in ``isam2``; for ``incremental``.
        factorization: as in ``isam2``; for ``incremental``. Default: ``cholesky`` with ``keep``, where ``qr``
            takes ten times as long, and ``qr`` with ``drop``, where the marginalised past becomes so vague
            beside odometry that ``cholesky`` fails on Victoria Park.
        extra_updates: further Gauss-Newton steps a frame; for ``incremental``.
        max_chi2_per_dof: as in ``batch``, of a run that is not longer than the window. What leaves a window
            takes with it how badly it fitted (GTSAM keeps no constant), and nothing tells a shorter window's
            chi-square of the whole run.
        robust: kernel on the observations' whitened residuals.
        robust_width: of the kernel; default the width with 95 % efficiency on Gaussian noise.

    Raises:
        UsageError: prior or odometry covariance is singular.
        DivergedError: GTSAM failed, an estimate is not finite, or the final solution cannot be right; feed no
            further frames.
    """

    relative_poses: Literal["used"] = "used"

    def __init__(
        self,
        problem: Problem,
        *,
        lag_frames: Annotated[int, Ge(1)] = 20,
        mode: Literal["incremental", "batch"] = "incremental",
        landmarks: Literal["keep", "drop"] = "keep",
        most_landmarks: Annotated[int, Ge(1)] | None = MOST_LANDMARKS,
        relinearize_threshold: Annotated[float, Ge(0)] = 0.1,
        relinearize_skip: Annotated[int, Ge(1)] = 1,
        factorization: Factorization | None = None,
        extra_updates: Annotated[int, Ge(0)] = 0,
        max_chi2_per_dof: Annotated[float, Gt(0)] = MAX_CHI2_PER_DOF,
        robust: RobustKernel = "none",
        robust_width: Annotated[float, Gt(0)] | None = None,
    ) -> None:
        self._builder = GraphBuilder(problem, robust=robust, robust_width=robust_width)
        self._lag = lag_frames
        self._drop = landmarks == "drop"
        self._recent = None if most_landmarks is None or self._drop else RecentLandmarks(most_landmarks)
        self._incremental = mode == "incremental"
        self._extra_updates = extra_updates if self._incremental else 0
        self._smoother: Any
        if self._incremental:
            parameters = isam2_parameters(
                relinearize_threshold=relinearize_threshold,
                relinearize_skip=relinearize_skip,
                factorization=factorization or ("qr" if self._drop else "cholesky"),
                optimizer="gauss_newton",
            )
            # The smoother removes factors, and without reuse its list of them grows for ever.
            parameters.findUnusedFactorSlots = True
            self._smoother = gtsam.IncrementalFixedLagSmoother(float(lag_frames), parameters)
        else:
            settings = gtsam.LevenbergMarquardtParams()
            # GTSAM stops at a relative 1e-5 by default, far from the window's optimum.
            settings.setRelativeErrorTol(1e-10)
            settings.setAbsoluteErrorTol(0.0)
            self._smoother = gtsam.BatchFixedLagSmoother(float(lag_frames), settings)
        planar = self._builder.space_dim == 2
        self._pose_at = (
            self._smoother.calculateEstimatePose2 if planar else self._smoother.calculateEstimatePose3
        )
        self._pose: Any = None
        self._marginals: Any = None
        self._last_seen: dict[int, int] = {}
        self._left: dict[int, Landmarks] = {}
        self._left_poses: list[FloatArray] = []
        self._t: list[float] = []
        self._max_chi2_per_dof = max_chi2_per_dof
        self._goodness: dict[str, float] = {}

    def update(self, frame: Frame) -> None:
        """Add the frame to the window, solve, and marginalise what is older than the lag.

        Raises:
            UsageError: the frame is related to a pose that has left the window.
        """
        k = frame.k
        if frame.relative_poses is not None and k - frame.relative_poses.frames.min() > self._lag:
            raise UsageError(
                f"fixed_lag: frame {k} is related to frame {frame.relative_poses.frames.min()}, which "
                "left the "
                f"window of lag_frames {self._lag}: a longer lag, isam2 or batch can use it"
            )
        self._goodness = {}
        graph, values = self._builder.extend(frame, self._pose)
        # Those that a camera saw after they had left cannot enter again: they have no variable.
        seen = [i for i in frame.ids.tolist() if i in self._builder.known]
        if frame.entries is not None:
            seen += frame.entries.ids.tolist()
        for landmark_id in seen:
            self._last_seen[landmark_id] = k
        leaving = self._too_many(frame)
        now = float(k)
        # A variable's time stamp decides when it leaves; kept landmarks are always as new as the frame.
        stamped = seen if self._drop else self._last_seen
        stamps = {self._builder.key(landmark_id): now for landmark_id in stamped}
        stamps[pose_key(k)] = now
        # Older than the lag: they are marginalised in this update.
        stamps.update((self._builder.key(landmark_id), now - self._lag - 1.0) for landmark_id in leaving)
        try:
            if self._builder.narrowing is None:
                self._smoother.update(graph, values, stamps)
            else:
                self._narrow(self._builder.narrowing, graph, values, stamps)
            for _ in range(self._extra_updates):
                self._smoother.update()
            self._pose = self._pose_at(pose_key(k))
        except RuntimeError as error:
            raise diverged("fixed_lag", k, error) from error
        self._marginals = None
        self._t.append(frame.t)
        if k >= self._lag:
            self._left_poses.append(self._pose_at(pose_key(k - self._lag)).matrix())
        for landmark_id in leaving:
            del self._last_seen[landmark_id]
            self._builder.known.discard(landmark_id)
        if self._drop:
            self._forget_and_remember(k)

    def estimate(self) -> Estimate:
        """The newest pose and its marginal covariance."""
        k = len(self._t) - 1
        pose = require_finite(self._pose.matrix(), "fixed_lag", k)
        return Estimate(pose, self._covariance(pose_key(k)))

    def landmarks(self) -> Landmarks:
        """Every landmark ever seen: those in the window now, the others as they left it."""
        builder = self._builder
        ids = builder.landmark_ids()
        current = builder.map(self._smoother.calculateEstimate(), self._covariance, ids)
        parts = [current, *(left for i, left in self._left.items() if i not in builder.known)]
        order = np.argsort(np.concatenate([part.ids for part in parts]))
        return Landmarks(
            np.concatenate([part.ids for part in parts])[order],
            np.concatenate([part.positions for part in parts])[order],
            np.concatenate([part.covariances for part in parts])[order],
        )

    def trajectory(self) -> Trajectory:
        """Fixed-lag smoothed: each pose as it was when it left the window, with ``lag_frames`` of hindsight.

        The poses still in the window have less. Not the optimum of the whole cost, and without covariances.

        Raises:
            DivergedError: a pose is not finite, more than 1 % of what the window's cameras saw is behind, or
                chi-square per dof of a run within the window is above ``max_chi2_per_dof``.
        """
        k = len(self._t) - 1
        first = len(self._left_poses)
        window = [self._pose_at(pose_key(j)).matrix() for j in range(first, k + 1)]
        poses = require_finite(np.array(self._left_poses + window), "fixed_lag", k)
        values = self._smoother.calculateEstimate()
        self._builder.require_images(values, poses[first:], "fixed_lag")
        if k <= self._lag:
            self._require_fit(values)
        return Trajectory(np.array(self._t), poses)

    def diagnostics(self) -> Mapping[str, float]:
        """``landmarks`` in the window, its ``variables``, the frame's measurements that were ``dropped``; for
        ``incremental`` also the last update's work. After ``trajectory()`` of a run within the window
        ``chi2, dof, chi2_per_dof`` as well."""
        known = len(self._builder.known)
        scalars = {"landmarks": float(known), "variables": float(known + min(len(self._t), self._lag + 1))}
        scalars["dropped"] = float(self._builder.dropped)
        if self._incremental:
            result = self._smoother.getISAM2Result()
            scalars["relinearized"] = float(result.getVariablesRelinearized())
            scalars["reeliminated"] = float(result.getVariablesReeliminated())
        return {**scalars, **self._goodness}

    def _narrow(self, narrowing: Narrowing, graph: Any, values: Any, stamps: dict[int, float]) -> None:
        """Add the frame under the first kernel, then put its observations under one after the other."""
        around = self._smoother.calculateEstimate()
        around.insert(values)
        stages = narrowing.stages(graph, around)

        def replace(some: Any, places: list[int]) -> list[int]:
            self._smoother.update(some, gtsam.Values(), {}, places)
            return self._places(some)

        self._smoother.update(stages[0], values, stamps)
        replace_observations(stages, self._places(stages[0]), replace)

    def _places(self, newest: Any) -> list[int]:
        """Where the smoother keeps the factors that it was just given."""
        if self._incremental:
            return list(self._smoother.getISAM2Result().getNewFactorsIndices())
        factors, key = self._smoother.getFactors(), pose_key(self._builder.next_frame - 1)
        held = {}
        for place in range(factors.size()):
            factor = factors.at(place)
            keys = () if factor is None else tuple(sorted(factor.keys()))
            if key in keys:
                held[keys, is_observation(factor)] = place
        new = (newest.at(row) for row in range(newest.size()))
        return [held.get((tuple(sorted(each.keys())), is_observation(each)), -1) for each in new]

    def _require_fit(self, values: Any) -> None:
        self._goodness = self._builder.goodness(2.0 * self._smoother.getFactors().error(values))
        chi2, dof = self._goodness["chi2"], self._goodness["dof"]
        judged = self._builder.believed(self._smoother.getFactors(), values)
        if judged is not None:
            require_majority(judged.outliers, judged.total, "fixed_lag")
            chi2, dof = judged.chi2, dof - judged.rows
        require_fit(
            chi2,
            dof,
            self._max_chi2_per_dof,
            "fixed_lag",
            "mode 'batch', or a smaller relinearize_threshold",
        )

    def _covariance(self, key: int) -> FloatArray:
        k = len(self._t) - 1
        try:
            if self._incremental:
                covariance: FloatArray = self._smoother.marginalCovariance(key)
            else:
                if self._marginals is None:
                    smoother = self._smoother
                    self._marginals = gtsam.Marginals(smoother.getFactors(), smoother.calculateEstimate())
                covariance = self._marginals.marginalCovariance(key)
        except RuntimeError as error:
            raise diverged("fixed_lag", k, error) from error
        return require_finite(covariance, "fixed_lag", k)

    def _too_many(self, frame: Frame) -> list[int]:
        """The landmarks that leave with this frame because they are too many, remembered as they stand."""
        if self._recent is None:
            return []
        self._recent.see(frame)
        held = self._builder.known
        leaving = self._recent.too_many(held, unseen_since=max(frame.k - self._lag, 0)) if self._t else []
        if leaving:
            self._remember(leaving)
        return leaving

    def _remember(self, leaving: list[int]) -> None:
        values = self._smoother.calculateEstimate([self._builder.key(i) for i in leaving])
        for landmark_id in leaving:
            self._left[landmark_id] = self._builder.map(values, self._covariance, [landmark_id])

    def _forget_and_remember(self, k: int) -> None:
        """Note the landmarks that left just now, and those whose last chance to be read this is."""
        oldest = k - self._lag
        for landmark_id in [i for i, seen in self._last_seen.items() if seen < oldest]:
            del self._last_seen[landmark_id]
            self._builder.known.discard(landmark_id)
        leaving = [i for i, seen in self._last_seen.items() if seen == oldest]
        if leaving:
            self._remember(leaving)
