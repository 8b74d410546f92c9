"""Kind "consistency": does the covariance tell how large the errors are?"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt
from scipy.special import chdtri

from slamcmp.errors import UsageError
from slamcmp.grading.results.scoring import log_linear
from slamcmp.grading.run.trial import Track, Trial, Verdict
from slamcmp.grading.run.watched import Watched
from slamcmp.registry import test_kinds

SAME_AS_REFERENCE = 1.02
"""Ratio to the reference's own NEES that is as good as the χ² band (an EKF may leave it a little)."""


@test_kinds.register("consistency")
def consistency(
    trial: Trial,
    *,
    procedure: str,
    runs: Annotated[int, Ge(5)] = 40,
    probability: Annotated[float, Gt(0)] = 1e-4,
    zero: Annotated[float, Gt(1)] = 1.5,
) -> Verdict:
    """Mean NEES at the last step of independent runs, against its χ² band.

    A run gives one sample: the steps within a run depend on one another. N ε̄ ~ χ²(N p), Bar-Shalom, Li and
    Kirubarajan 2001, sec. 5.4.

    Args:
        trial: what is tested.
        procedure: ``name(implementation, generator) -> Track`` of ``cases.py``.
        runs: how many.
        probability: that a consistent estimator misses the band by chance.
        zero: factor outside of the band from which no points are given.
    """
    drive, student = trial.procedure(procedure), Watched(trial.student, trial.reference)
    own = [drive(student, generator) for generator in trial.run_generators(runs)]
    best = [drive(trial.reference, generator) for generator in trial.run_generators(runs)]
    dof = own[0].errors.shape[1]
    low, high = (float(chdtri(len(own) * dof, p)) / len(own) for p in (1 - probability / 2, probability / 2))
    mean, mean_reference = _mean_nees(own), _mean_nees(best)
    if not math.isfinite(mean):
        return Verdict(0.0, "A covariance at the end of a run is not finite or not positive definite.")
    outside = max(mean / high, low / mean if mean > 0 else math.inf, 1.0)
    away = max(mean / mean_reference, mean_reference / mean if mean > 0 else math.inf)
    credit = 1.0 if away <= SAME_AS_REFERENCE else log_linear(outside, 1.0, zero)
    facts = f"mean NEES {mean:.3g} over {len(own)} runs; {dof} is right, {low:.3g} to {high:.3g} allowed"
    if credit == 1.0:
        return Verdict(1.0, f"Consistent: {facts}.")
    how = (
        "Overconfident: your covariance is too small for your errors"
        if mean > high
        else "Too cautious: your covariance is too large for your errors"
    )
    return Verdict(credit, f"{how}: {facts}.")


def _mean_nees(tracks: list[Track]) -> float:
    values = []
    for track in tracks:
        if track.covariances is None:
            raise UsageError("a test of consistency needs runs with covariances")
        error, covariance = track.errors[-1], track.covariances[-1]
        if not (np.isfinite(error).all() and np.isfinite(covariance).all()):
            return math.nan
        try:
            white = np.linalg.solve(np.linalg.cholesky(covariance), error)
        except np.linalg.LinAlgError:
            return math.nan
        values.append(float(white @ white))
    return float(np.mean(values))
