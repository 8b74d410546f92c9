"""GTSAM's iSAM2 with its failures translated: the solver of ``isam2`` and the warm start of ``batch``.

Kaess et al. 2012, "iSAM2: Incremental smoothing and mapping using the Bayes tree".
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Literal

import gtsam

from slamcmp.backends.gtsam_smoothers.factors import pose_key
from slamcmp.backends.gtsam_smoothers.graph import diverged, require_finite
from slamcmp.backends.gtsam_smoothers.robust_factors import Narrowing, replace_observations
from slamcmp.types import FloatArray

Factorization = Literal["cholesky", "qr"]
IncrementalOptimizer = Literal["gauss_newton", "dogleg"]


def isam2_parameters(
    *,
    relinearize_threshold: float,
    relinearize_skip: int,
    factorization: Factorization,
    optimizer: IncrementalOptimizer,
) -> Any:
    """``ISAM2Params`` with these settings and GTSAM's defaults for the rest."""
    parameters = gtsam.ISAM2Params()
    parameters.setOptimizationParams(
        gtsam.ISAM2GaussNewtonParams() if optimizer == "gauss_newton" else gtsam.ISAM2DoglegParams()
    )
    parameters.setRelinearizeThreshold(relinearize_threshold)
    parameters.relinearizeSkip = relinearize_skip
    parameters.setFactorization(factorization.upper())
    return parameters


MANY = 1000
"""Marginal covariances from which on a tree of their own is worth its making."""


FINAL_UPDATES = 50
"""Most updates after the last frame."""
STANDS_STILL = 1e-9
"""Relative change of chi-square by an update that is taken for none."""


class IncrementalSolver:
    """Holds the Bayes tree and the pose of the newest frame.

    Args:
        name: of the back end, for messages.
        space_dim: n.
        parameters: from :func:`isam2_parameters`.
        extra_updates: further ``update`` calls a frame, each one more Gauss-Newton step.
        narrowing: what the graphs' observations go through; None: they come as they are to be.
    """

    def __init__(
        self,
        name: str,
        space_dim: int,
        parameters: Any,
        *,
        extra_updates: int = 0,
        narrowing: Narrowing | None = None,
    ) -> None:
        self.k = -1
        self.pose: Any = None
        """GTSAM pose of the newest frame, causal."""
        self.result: Any = None
        """``ISAM2Result`` of the last update."""
        self._name = name
        self._extra_updates = extra_updates
        self._narrowing = narrowing
        self._isam = gtsam.ISAM2(parameters)
        self._pose_at = (
            self._isam.calculateEstimatePose2 if space_dim == 2 else self._isam.calculateEstimatePose3
        )

    def update(self, graph: Any, values: Any) -> None:
        """Add the next frame's factors and initial values and solve.

        Raises:
            DivergedError: GTSAM could not solve the linear system; the solver cannot be used afterwards.
        """
        self.k += 1
        try:
            if self._narrowing is None:
                self.result = self._isam.update(graph, values)
            else:
                self._narrow(self._narrowing, graph, values)
            for _ in range(self._extra_updates):
                self.result = self._isam.update()
            self.pose = self._pose_at(pose_key(self.k))
        except RuntimeError as error:
            raise diverged(self._name, self.k, error) from error

    def converge(self) -> tuple[float, bool]:
        """Update until chi-square stands still, looking each time for variables to linearise anew.

        During the run that happens only every ``relinearize_skip`` frames, and what the last frames brought
        may not have reached the older poses yet. What has moved by less than ``relinearize_threshold`` keeps
        its point.

        Returns:
            chi-square of the whole cost, and whether it stands still.

        Raises:
            DivergedError: GTSAM could not solve the linear system; the solver cannot be used afterwards.
        """
        graph = self.graph()
        chi2 = 2.0 * graph.error(self.values())
        for _ in range(FINAL_UPDATES):
            try:
                result = self._isam.update(force_relinearize=True)
            except RuntimeError as error:
                raise diverged(self._name, self.k, error) from error
            last, chi2 = chi2, 2.0 * graph.error(self.values())
            if not result.getVariablesRelinearized() or abs(last - chi2) <= STANDS_STILL * (1.0 + chi2):
                return chi2, True
        return chi2, False

    def _narrow(self, narrowing: Narrowing, graph: Any, values: Any) -> None:
        """Add the frame under the first kernel, then put its observations under one after the other."""
        around = self._isam.calculateEstimate()
        around.insert(values)
        stages = narrowing.stages(graph, around)

        def replace(some: Any, places: list[int]) -> list[int]:
            self.result = self._isam.update(some, gtsam.Values(), places, force_relinearize=True)
            return list(self.result.getNewFactorsIndices())

        self.result = self._isam.update(stages[0], values)
        replace_observations(stages, list(self.result.getNewFactorsIndices()), replace)

    def pose_matrix(self) -> FloatArray:
        """``T_world_body`` of the newest frame."""
        matrix: FloatArray = self.pose.matrix()
        return require_finite(matrix, self._name, self.k)

    def covariance(self, key: int) -> FloatArray:
        """Marginal covariance of one variable."""
        try:
            covariance: FloatArray = self._isam.marginalCovariance(key)
        except RuntimeError as error:
            raise diverged(self._name, self.k, error) from error
        return require_finite(covariance, self._name, self.k)

    def covariances(self, count: int) -> Callable[[int], FloatArray]:
        """What gives the marginal covariance of a variable, for ``count`` of them.

        The tree has the newest pose at its root, and a variable far from it costs a long way up. For many,
        a tree of the same linear factors in an order made for that is sooner there.
        """
        if count < MANY:
            return self.covariance
        try:
            marginals = gtsam.Marginals(self.graph(), self._isam.getLinearizationPoint())
        except RuntimeError as error:
            raise diverged(self._name, self.k, error) from error
        return lambda key: require_finite(marginals.marginalCovariance(key), self._name, self.k)

    def joint_covariance(self, keys: Sequence[int]) -> FloatArray:
        """Joint covariance of several variables, blocks in the order of ``keys``."""
        try:
            joint: FloatArray = self._isam.jointMarginalCovariance(list(keys)).fullMatrix()
        except RuntimeError as error:
            raise diverged(self._name, self.k, error) from error
        return require_finite(joint, self._name, self.k)

    def values(self) -> Any:
        """The current estimate of every variable, from a complete back-substitution."""
        return self._isam.calculateBestEstimate()

    def graph(self) -> Any:
        """Every factor so far."""
        return self._isam.getFactorsUnsafe()
