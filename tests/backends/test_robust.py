"""Kernels: each weight is its cost's derivative, GTSAM has the same, and the widths are what they claim."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from gtsam import noiseModel
from scipy.integrate import quad

from slamcmp.backends.robust import WIDTHS, Kernel, RobustKernel, robust_kernel
from slamcmp.errors import UsageError

NAMES = sorted(WIDTHS)
GTSAM = {
    "huber": noiseModel.mEstimator.Huber,
    "cauchy": noiseModel.mEstimator.Cauchy,
    "tukey": noiseModel.mEstimator.Tukey,
    "geman_mcclure": noiseModel.mEstimator.GemanMcClure,
    "gnc": noiseModel.mEstimator.GemanMcClure,
    "dcs": noiseModel.mEstimator.DCS,
}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("width", [0.7, 1.9, 5.0])
def test_the_weight_is_the_derivative_of_the_cost(name: str, width: float) -> None:
    """rho'(r) = w(r) r by central differences, away from the kinks at the width."""
    kernel = Kernel(name, width)
    r = np.array([1e-3, 0.3, 0.99, 1.01, 1.7, 4.0, 30.0]) * width
    h = 1e-6 * width
    slope = (kernel.rho(r + h) - kernel.rho(r - h)) / (2 * h)
    np.testing.assert_allclose(slope, kernel.weight(r) * r, rtol=1e-6, atol=1e-7 * width)


@pytest.mark.parametrize("name", NAMES)
def test_limits(name: str) -> None:
    """r²/2 and weight 1 near 0, a cost that never falls, a weight that never rises, least squares if wide."""
    kernel = Kernel(name, 1.5)
    assert kernel.weight(0.0) == 1.0
    assert float(kernel.rho(1e-4)) == pytest.approx(0.5e-8, rel=1e-6)
    r = np.linspace(0.0, 50.0, 2001)
    assert (np.diff(kernel.rho(r)) >= -1e-12).all()
    assert (np.diff(kernel.weight(r)) <= 1e-15).all()
    wide, r = Kernel(name, 1e9), np.linspace(0.0, 6.0, 61)
    np.testing.assert_array_equal(wide.weight(r), 1.0)
    np.testing.assert_allclose(wide.rho(r), 0.5 * r**2, rtol=1e-9)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("width", [0.7, 1.9])
def test_gtsam_has_the_same(name: str, width: float) -> None:
    estimator: Any = GTSAM[name](width**2 if name == "dcs" else width)
    kernel = Kernel(name, width)
    for r in (0.0, 0.4, 0.69, 0.71, 1.3, 2.5, 20.0):
        assert float(kernel.weight(r)) == pytest.approx(estimator.weight(r), abs=1e-12)
        assert float(kernel.rho(r)) == pytest.approx(estimator.loss(r), abs=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_default_widths_have_95_percent_efficiency(name: str) -> None:
    """E[r psi]² / E[psi²] of a Gaussian r: the variance of the mean over that of the kernel's location."""
    kernel = Kernel(name, WIDTHS[name])

    def psi(r: float) -> float:
        return float(kernel.weight(abs(r))) * r

    def over(f: Any) -> float:
        half = quad(lambda r: f(r) * math.exp(-0.5 * r * r), 0, 12, points=[kernel.width], limit=200)[0]
        return 2.0 * float(half) / math.sqrt(2.0 * math.pi)

    efficiency = over(lambda r: r * psi(r)) ** 2 / over(lambda r: psi(r) ** 2)
    assert efficiency == pytest.approx(0.95, abs=2e-5)


def test_graduated_non_convexity_begins_convex_and_ends_as_geman_mcclure() -> None:
    kernel = Kernel("gnc", 2.0)
    r = np.linspace(0.0, 40.0, 400)
    stages = kernel.stages(40.0)
    assert stages[-1] is kernel
    np.testing.assert_array_equal(kernel.rho(r), Kernel("geman_mcclure", 2.0).rho(r))
    assert (np.diff(stages[0].rho(r), 2) > 0).all()
    assert (np.diff(kernel.rho(r), 2) < 0).any()
    widths = [stage.width for stage in stages]
    assert widths == sorted(widths, reverse=True)
    assert len(set(widths)) == len(widths) > 3
    # Small residuals need no detour.
    assert kernel.stages(1.0) == [kernel]


@pytest.mark.parametrize("name", ["cauchy", "tukey", "geman_mcclure", "dcs"])
def test_other_kernels_that_are_not_convex_start_from_hubers_solution(name: str) -> None:
    first, last = Kernel(name, 2.0).stages(50.0)
    assert (first.name, last) == ("huber", Kernel(name, 2.0))
    assert Kernel("huber", 2.0).stages(50.0) == [Kernel("huber", 2.0)]


@pytest.mark.parametrize("name", NAMES)
def test_the_width_can_be_given(name: RobustKernel) -> None:
    assert robust_kernel(name, None) == Kernel(name, WIDTHS[name])
    assert robust_kernel(name, 3.0) == Kernel(name, 3.0)


def test_a_width_without_a_kernel_is_refused() -> None:
    assert robust_kernel("none", None) is None
    with pytest.raises(UsageError, match="robust_width has no meaning"):
        robust_kernel("none", 1.0)
