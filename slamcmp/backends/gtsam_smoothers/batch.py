"""Batch smoothing: every pose and landmark that the whole cost determines, iterated to convergence.

========  =====================================================================
symbol    meaning
========  =====================================================================
P, Q      covariance of the newest pose and of an odometry increment, body tangent, (p, p)
========  =====================================================================

From dead reckoning, Levenberg-Marquardt stalls in wrong basins on real data, and GTSAM does not say so;
hence the warm start and the test of chi-square. Dellaert and Kaess 2017, "Factor graphs for robot
perception", chapter 2.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import gtsam
import numpy as np
from annotated_types import Ge, Gt

from slamcmp.backends.fit import MAX_CHI2_PER_DOF, require_fit, require_majority
from slamcmp.backends.gtsam_smoothers.factors import pose_key
from slamcmp.backends.gtsam_smoothers.graph import (
    GraphBuilder,
    diverged,
    poses_in,
    require_finite,
    to_gtsam,
)
from slamcmp.backends.gtsam_smoothers.incremental import IncrementalSolver, isam2_parameters
from slamcmp.backends.gtsam_smoothers.linear_start import Edges
from slamcmp.backends.robust import RobustKernel
from slamcmp.errors import DivergedError
from slamcmp.geometry import adjoint, inverse
from slamcmp.registry import back_ends
from slamcmp.types import Estimate, FloatArray, Frame, Landmarks, Problem, Trajectory

Optimizer = Literal["lm", "gauss_newton", "dogleg"]
WarmStart = Literal["isam2", "dead_reckoning", "linear"]


@back_ends.register("batch")
class Batch:
    """Full least squares over all poses and landmarks.

    The *final* column is the converged optimum. The *online* column is a batch solution too only with
    ``every=1``, where each frame costs a full solve; by default it is the warm start's causal estimate
    (iSAM2's, or else dead reckoning), which is what a robot would have had at that time.

    Args:
        problem: prior and sensor.
        optimizer: Levenberg-Marquardt, Gauss-Newton or Powell's dogleg.
        warm_start: where a solve starts: the incremental solution, or the odometry chain with each landmark
            where it was first seen (which often ends in a wrong basin), or ``linear``: the same with the
            chain first fitted to the loop closures (linear_start.py), for large pose graphs: w10000, of
            10 000 poses and 64 311 edges, takes seconds with it, and minutes with iSAM2.
        every: solve causally at frames 0, every, 2 every, …, with odometry carrying the pose in between;
            0: only in the end.
        max_iterations: of one solve. A solution that was still moving then stands if it is better than where
            it started, and says so (``converged`` 0).
        relative_error_tol: a solve stops when an iteration lowers the cost by less than this share.
        max_chi2_per_dof: a final solution above it counts as diverged: a wrong basin, or noise that the
            covariances do not describe (fit.py: with few degrees of freedom chance is granted more).
        final_covariances: give ``trajectory()`` a covariance for every pose (0.2 s for 7000 poses).
        robust: kernel on the observations' whitened residuals.
        robust_width: of the kernel; default the width with 95 % efficiency on Gaussian noise.

    Raises:
        UsageError: prior or odometry covariance is singular.
        DivergedError: GTSAM failed, left its start for a worse solution, or ended in one that cannot be
            right.
    """

    relative_poses: Literal["used"] = "used"

    def __init__(
        self,
        problem: Problem,
        *,
        optimizer: Optimizer = "lm",
        warm_start: WarmStart = "isam2",
        every: Annotated[int, Ge(0)] = 0,
        max_iterations: Annotated[int, Ge(1)] = 100,
        relative_error_tol: Annotated[float, Ge(0)] = 1e-10,
        max_chi2_per_dof: Annotated[float, Gt(0)] = MAX_CHI2_PER_DOF,
        final_covariances: bool = True,
        robust: RobustKernel = "none",
        robust_width: Annotated[float, Gt(0)] | None = None,
    ) -> None:
        self._builder = GraphBuilder(problem, robust=robust, robust_width=robust_width)
        self._optimizer = optimizer
        self._every = every
        self._max_iterations = max_iterations
        self._relative_error_tol = relative_error_tol
        self._max_chi2_per_dof = max_chi2_per_dof
        self._final_covariances = final_covariances
        self._graph = gtsam.NonlinearFactorGraph()
        self._solving = self._graph
        """The graph as it is minimised: with ``gnc`` under one of its kernels."""
        self._chain = gtsam.Values()
        self._incremental: IncrementalSolver | None = None
        if warm_start == "isam2":
            parameters = isam2_parameters(
                relinearize_threshold=0.1,
                relinearize_skip=10,
                factorization="cholesky",
                optimizer="gauss_newton",
            )
            self._incremental = IncrementalSolver(
                "batch", self._builder.space_dim, parameters, narrowing=self._builder.narrowing
            )
        self._edges = Edges() if warm_start == "linear" else None
        self._entered: dict[int, int] = {}
        """Of ``linear``: the frame in which each landmark entered."""
        self._warm_pose: Any = None
        self._pose = problem.T_world_body
        self._P = problem.P
        self._t: list[float] = []
        self._solution: _Solution | None = None
        self._behind = 0

    def update(self, frame: Frame) -> None:
        """Add the frame to the cost and to the warm start; solve where ``every`` says so."""
        incremental = self._incremental
        graph, values = self._builder.extend(frame, self._warm_pose)
        self._graph.push_back(graph)
        self._t.append(frame.t)
        self._solution = None
        if incremental is None:
            self._chain.insert(values)
            if self._edges is not None:
                self._edges.add(frame)
                new = self._builder.known.difference(self._entered)
                self._entered.update(dict.fromkeys(new, frame.k))
            self._warm_pose = self._pose_in(values, frame.k)
        else:
            incremental.update(graph, values)
            self._warm_pose = incremental.pose
        if frame.k:
            A = adjoint(inverse(frame.T_prev_body))
            self._pose = self._pose @ frame.T_prev_body
            self._P = A @ self._P @ A.T + frame.Q
        if self._every and frame.k % self._every == 0:
            solution = self._solve()
            # Kept for the frames in between, which odometry carries on from here.
            self._pose = self._pose_in(solution.values, frame.k).matrix()
            self._P = solution.covariance(pose_key(frame.k))

    def estimate(self) -> Estimate:
        """The newest pose: at the optimum once solved for, else from the warm start (see the class)."""
        if self._solution is not None:
            k = len(self._t) - 1
            solution = self._solution
            return Estimate(self._pose_in(solution.values, k).matrix(), solution.covariance(pose_key(k)))
        if self._every or self._incremental is None:
            return Estimate(self._pose, self._P)
        incremental = self._incremental
        return Estimate(incremental.pose_matrix(), incremental.covariance(pose_key(incremental.k)))

    def trajectory(self) -> Trajectory:
        """Every pose at the optimum.

        Raises:
            DivergedError: a solve that went up, a result that is not finite, chi-square per dof above
                ``max_chi2_per_dof``, or more than 1 % of what a camera saw is behind it.
        """
        solution = self._checked_solution()
        poses = poses_in(solution.values, len(self._t), self._builder.space_dim)
        covariances = None
        if self._final_covariances:
            covariances = np.array([solution.covariance(pose_key(k)) for k in range(len(poses))])
        return Trajectory(np.array(self._t), poses, covariances)

    def landmarks(self) -> Landmarks:
        """Every landmark at the optimum, with its marginal covariance (solves if need be)."""
        solution, builder = self._checked_solution(), self._builder
        return builder.map(solution.values, solution.covariance, builder.landmark_ids())

    def joint_covariance(self) -> FloatArray:
        """At the optimum, of the newest pose and the landmarks in the order of :meth:`landmarks`."""
        solution, builder = self._checked_solution(), self._builder
        return builder.joint(len(self._t) - 1, solution.joint_covariance, builder.landmark_ids())

    def diagnostics(self) -> Mapping[str, float]:
        """``landmarks``, ``dropped`` measurements; once solved also ``chi2, dof, chi2_per_dof, iterations``
        of the solution, whether it ``converged`` (1, else 0), and how many observations are of landmarks
        ``behind_camera``."""
        builder = self._builder
        count = {"landmarks": float(len(builder.known)), "dropped": float(builder.dropped)}
        if self._solution is None:
            return count
        solved = {
            "iterations": float(self._solution.iterations),
            "converged": float(self._solution.converged),
            "behind_camera": float(self._behind),
        }
        return {**count, **builder.goodness(self._solution.chi2), **solved}

    def _pose_in(self, values: Any, k: int) -> Any:
        return (values.atPose2 if self._builder.space_dim == 2 else values.atPose3)(pose_key(k))

    def _checked_solution(self) -> _Solution:
        if self._solution is None:
            self._solve()
        solution = self._solution
        assert solution is not None
        poses = poses_in(solution.values, len(self._t), self._builder.space_dim)
        self._behind = self._builder.require_images(solution.values, poses, "batch")
        what = f"batch, after {solution.iterations} iterations"
        if not solution.converged:
            what += " without convergence"
        chi2, dof = solution.chi2, self._builder.goodness(solution.chi2)["dof"]
        judged = self._builder.believed(solution.graph, solution.values)
        if judged is not None:
            require_majority(judged.outliers, judged.total, "batch")
            chi2, dof = judged.chi2, dof - judged.rows
        require_fit(
            chi2,
            dof,
            self._max_chi2_per_dof,
            what,
            "start from warm_start 'isam2'",
        )
        return solution

    def _solve(self) -> _Solution:
        initial = self._start()
        k = len(self._t) - 1
        self._builder.bring_back(initial, poses_in(initial, k + 1, self._builder.space_dim))
        try:
            values, iterations = initial, 0
            narrowing = self._builder.narrowing
            for graph in [self._graph] if narrowing is None else narrowing.stages(self._graph, initial):
                start_chi2 = 2.0 * graph.error(values)
                self._solving = graph
                optimizer = self._make_optimizer(values)
                values, iterations = optimizer.optimize(), optimizer.iterations()
            solution = _Solution(graph, values, iterations, k, converged=iterations < self._max_iterations)
        except RuntimeError as error:
            raise diverged("batch", k, error) from error
        require_finite(poses_in(values, k + 1, self._builder.space_dim), "batch", k)
        require_finite(np.array(solution.chi2), "batch", k)
        if not solution.converged and solution.chi2 > start_chi2:
            raise DivergedError(
                f"batch: no convergence in {iterations} iterations, and χ² rose from {start_chi2:.4g} to "
                f"{solution.chi2:.4g}: take optimizer 'lm', which never goes up"
            )
        self._solution = solution
        return solution

    def _start(self) -> Any:
        if self._incremental is not None:
            return self._incremental.values()
        if self._edges is None or not self._edges.closures:
            return self._chain
        n = self._builder.space_dim
        chain = poses_in(self._chain, len(self._t), n)
        fitted = self._edges.poses(chain[0])
        start = gtsam.Values()
        for k, T in enumerate(fitted):
            start.insert(pose_key(k), to_gtsam(T))
        moved = (fitted @ inverse(chain))[list(self._entered.values())]
        ids = list(self._entered)
        seen_from_chain = self._builder.positions(self._chain, ids)
        positions = np.einsum("lij,lj->li", moved[:, :n, :n], seen_from_chain) + moved[:, :n, n]
        for landmark_id, position in zip(ids, positions, strict=True):
            start.insert(self._builder.key(landmark_id), self._builder.landmark_value(position))
        return start

    def _make_optimizer(self, initial: Any) -> Any:
        kinds = {
            "lm": (gtsam.LevenbergMarquardtOptimizer, gtsam.LevenbergMarquardtParams),
            "gauss_newton": (gtsam.GaussNewtonOptimizer, gtsam.GaussNewtonParams),
            "dogleg": (gtsam.DoglegOptimizer, gtsam.DoglegParams),
        }
        make, make_parameters = kinds[self._optimizer]
        parameters = make_parameters()
        parameters.setMaxIterations(self._max_iterations)
        parameters.setRelativeErrorTol(self._relative_error_tol)
        parameters.setAbsoluteErrorTol(0.0)
        return make(self._solving, initial, parameters)


class _Solution:
    """An optimum; its covariances are computed when first asked for."""

    def __init__(self, graph: Any, values: Any, iterations: int, k: int, *, converged: bool) -> None:
        self.values = values
        self.converged = converged
        self.iterations = iterations
        self.chi2: float = 2.0 * graph.error(values)
        self.graph = graph
        self._k = k
        self._marginals: Any = None

    def covariance(self, key: int) -> FloatArray:
        covariance: FloatArray = self._get_marginals().marginalCovariance(key)
        return require_finite(covariance, "batch", self._k)

    def joint_covariance(self, keys: list[int]) -> FloatArray:
        joint: FloatArray = self._get_marginals().jointMarginalCovariance(keys).fullMatrix()
        return require_finite(joint, "batch", self._k)

    def _get_marginals(self) -> Any:
        if self._marginals is None:
            try:
                self._marginals = gtsam.Marginals(self.graph, self.values)
            except RuntimeError as error:
                raise diverged("batch", self._k, error) from error
        return self._marginals
