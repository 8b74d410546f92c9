"""iSAM2: incremental smoothing on a Bayes tree.

========  =====================================================================
symbol    meaning
========  =====================================================================
P         covariance of the newest pose, body tangent, (p, p)
========  =====================================================================

Kaess et al. 2012, "iSAM2: Incremental smoothing and mapping using the Bayes tree".
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt

from slamcmp.backends.fit import MAX_CHI2_PER_DOF, require_fit, require_majority
from slamcmp.backends.gtsam_smoothers.factors import pose_key
from slamcmp.backends.gtsam_smoothers.graph import GraphBuilder, poses_in, require_finite
from slamcmp.backends.gtsam_smoothers.incremental import (
    Factorization,
    IncrementalOptimizer,
    IncrementalSolver,
    isam2_parameters,
)
from slamcmp.backends.robust import RobustKernel
from slamcmp.registry import back_ends
from slamcmp.types import Estimate, FloatArray, Frame, IntArray, Landmarks, Problem, Trajectory


@back_ends.register("isam2")
class Isam2:
    """iSAM2: re-solves only the part of the Bayes tree that a frame touches.

    Nothing leaves the graph: memory grows with the length of the run, and with every place that is seen again
    so does the part that a frame touches. For runs without an end take ``fixed_lag`` or ``sliding_window``,
    whose frames stay bounded by default.

    Args:
        problem: prior and sensor.
        relinearize_threshold: a variable is linearised anew when its step exceeds this (m and rad alike).
        relinearize_skip: look for such variables only every so many updates: over hundreds of frames 10 saves
            time and loses little; over tens of frames take 1.
        factorization: ``qr`` survives worse conditioning than ``cholesky``, at about twice the time.
        optimizer: the step of each update.
        extra_updates: further Gauss-Newton steps a frame; with threshold 0 and skip 1 the estimate then
            converges to the batch solution.
        max_chi2_per_dof: as in ``batch``: a final solution above it counts as diverged.
        final_covariances: give ``trajectory()`` a covariance for every pose (0.2 s for 7000 poses).
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
        relinearize_threshold: Annotated[float, Ge(0)] = 0.1,
        relinearize_skip: Annotated[int, Ge(1)] = 10,
        factorization: Factorization = "cholesky",
        optimizer: IncrementalOptimizer = "gauss_newton",
        extra_updates: Annotated[int, Ge(0)] = 0,
        max_chi2_per_dof: Annotated[float, Gt(0)] = MAX_CHI2_PER_DOF,
        final_covariances: bool = True,
        robust: RobustKernel = "none",
        robust_width: Annotated[float, Gt(0)] | None = None,
    ) -> None:
        parameters = isam2_parameters(
            relinearize_threshold=relinearize_threshold,
            relinearize_skip=relinearize_skip,
            factorization=factorization,
            optimizer=optimizer,
        )
        self._builder = GraphBuilder(problem, robust=robust, robust_width=robust_width)
        self._solver = IncrementalSolver(
            "isam2",
            self._builder.space_dim,
            parameters,
            extra_updates=extra_updates,
            narrowing=self._builder.narrowing,
        )
        self._final_covariances = final_covariances
        self._t: list[float] = []
        self._max_chi2_per_dof = max_chi2_per_dof
        self._final: tuple[float, bool] | None = None
        self._behind = 0

    def update(self, frame: Frame) -> None:
        """Add the frame's factors to the tree and solve; the pose's back-substitution is part of it."""
        solver = self._solver
        solver.update(*self._builder.extend(frame, solver.pose))
        self._t.append(frame.t)
        self._final = None

    def estimate(self) -> Estimate:
        """The newest pose and its marginal covariance."""
        solver = self._solver
        return Estimate(solver.pose_matrix(), solver.covariance(pose_key(solver.k)))

    def landmarks(self) -> Landmarks:
        """Every landmark with its marginal covariance."""
        builder, solver = self._builder, self._solver
        ids = builder.landmark_ids()
        return builder.map(solver.values(), solver.covariances(len(ids)), ids)

    def joint_covariance(self) -> FloatArray:
        """Of the newest pose and the landmarks in the order of :meth:`landmarks`."""
        builder, solver = self._builder, self._solver
        return builder.joint(solver.k, solver.joint_covariance, builder.landmark_ids())

    def local_map(self, ids: IntArray) -> tuple[IntArray, FloatArray, FloatArray]:
        """Those of the landmarks ``ids`` that are in the tree, and their joint covariance with the pose."""
        builder, solver = self._builder, self._solver
        known = sorted(builder.known.intersection(ids.tolist()))
        joint = builder.joint(solver.k, solver.joint_covariance, known)
        return np.array(known, dtype=np.int64), builder.positions(solver.values(), known), joint

    def trajectory(self) -> Trajectory:
        """Every pose, after updates until chi-square stands still; the tree stays there.

        Variables that have moved by less than ``relinearize_threshold`` keep the point of their Jacobians, so
        chi-square may stand a little above that of ``batch``.

        Raises:
            DivergedError: a pose is not finite, chi-square per dof is above ``max_chi2_per_dof``, or more
                than 1 % of what a camera saw is behind it.
        """
        if self._final is None:
            self._final = self._solver.converge()
        values = self._solver.values()
        poses = require_finite(
            poses_in(values, len(self._t), self._builder.space_dim), "isam2", self._solver.k
        )
        self._behind = self._builder.require_images(values, poses, "isam2")
        chi2, converged = self._final
        dof = self._builder.goodness(chi2)["dof"]
        if self._behind:
            constant, rows = self._builder.cost_without_image(self._solver.graph(), values, poses)
            chi2, dof = chi2 - constant, dof - rows
        judged = self._builder.believed(self._solver.graph(), values)
        if judged is not None:
            require_majority(judged.outliers, judged.total, "isam2")
            chi2, dof = judged.chi2, dof - judged.rows
        require_fit(
            chi2,
            dof,
            self._max_chi2_per_dof,
            "isam2" if converged else "isam2, without convergence",
            "a smaller relinearize_threshold or relinearize_skip",
        )
        covariances = None
        if self._final_covariances:
            covariance = self._solver.covariances(len(poses))
            covariances = np.array([covariance(pose_key(k)) for k in range(len(poses))])
        return Trajectory(np.array(self._t), poses, covariances)

    def diagnostics(self) -> Mapping[str, float]:
        """Work of the last update; after ``trajectory()`` the chi-square of the whole cost, whether it
        ``converged`` (1, else 0), and how many observations are of landmarks ``behind_camera``: each adds a
        constant that is no residual.

        ``relinearized`` and ``reeliminated`` count variables, ``cliques`` those of the tree that were redone.
        """
        if self._final is not None:
            chi2, converged = self._final
            about = {"converged": float(converged), "behind_camera": float(self._behind)}
            return {**self._builder.goodness(chi2), **about}
        result = self._solver.result
        return {
            "landmarks": float(len(self._builder.known)),
            "dropped": float(self._builder.dropped),
            "relinearized": float(result.getVariablesRelinearized()),
            "reeliminated": float(result.getVariablesReeliminated()),
            "cliques": float(result.getCliques()),
        }
