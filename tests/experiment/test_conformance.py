"""The conformance suite on the README's example, and on that example with one fault at a time."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from slamcmp.experiment.conformance.check import Finding, check_back_end

README = Path(__file__).parents[2] / "README.md"


def example() -> str:
    """The back end printed in the README: what a reader copies must pass."""
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), flags=re.DOTALL)
    (code,) = [block for block in blocks if "class MyEkf" in block]
    return code


def findings_of(tmp_path: Path, *changes: tuple[str, str]) -> dict[str, Finding]:
    code = example()
    for old, new in changes:
        assert old in code, f"the README's example no longer contains {old!r}"
        code = code.replace(old, new)
    path = tmp_path / "my_backend.py"
    path.write_text(code, encoding="utf-8")
    return {finding.check: finding for finding in check_back_end(f"{path}:MyEkf")}


def test_the_readme_example_passes_every_check(tmp_path: Path) -> None:
    findings = findings_of(tmp_path)
    assert [finding for finding in findings.values() if not finding.passed] == []
    assert len(findings) == 12
    assert len(example().splitlines()) <= 33


@pytest.mark.parametrize(
    "name",
    [
        "ekf_slam",
        "ekf_ideal",
        "iterated_ekf",
        pytest.param("sliding_window", marks=pytest.mark.slow),
        "msckf",
        "kalman_filter",
        "isam2",
        "batch",
        "fixed_lag",
    ],
)
def test_every_registered_back_end_passes(name: str) -> None:
    assert [finding for finding in check_back_end(name) if not finding.passed] == []


FAULTS = {
    "covariance in world axes": (
        ("Estimate(self.T, self.P[:3, :3])", "Estimate(self.T, self.turned())"),
        (
            "    def estimate(self):",
            "    def turned(self):\n"
            "        B = np.eye(3)\n"
            "        B[:2, :2] = self.T[:2, :2]\n"
            "        return B @ self.P[:3, :3] @ B.T\n\n"
            "    def estimate(self):",
        ),
        "reports P in the body tangent, order (x, y, heading)",
        r"it is in world axes",
    ),
    "heading first": (
        ("self.P[:3, :3])", "self.P[np.ix_([2, 0, 1], [2, 0, 1])])"),
        None,
        "reports P in the body tangent, order (x, y, heading)",
        r"its order is \(heading, x, y\)",
    ),
    "transposed prediction": (
        ("A @ self.P @ A.T", "A.T @ self.P @ A"),
        None,
        "reports P in the body tangent, order (x, y, heading)",
        r"not A\^T P A",
    ),
    "motion composed on the wrong side": (
        ("self.T @ frame.T_prev_body", "frame.T_prev_body @ self.T"),
        None,
        "follows odometry alone exactly",
        r"T_world_body @ T_prev_body",
    ),
    "unwrapped bearing": (
        (
            "self.sensor.residual(z, self.sensor.predict(self.T, self.map[j]))",
            "(z - self.sensor.predict(self.T, self.map[j]))",
        ),
        None,
        "uses its observations",
        r"not wrapped",
    ),
    "noise as standard deviation": (
        ("H @ self.P @ H.T + R", "H @ self.P @ H.T + R @ R"),
        None,
        "reports a covariance that fits its errors",
        r"overconfident",
    ),
    "mean is never corrected": (
        ("retract(self.T, dx[:3])", "self.T"),
        None,
        "uses its observations",
        r"dead reckoning's",
    ),
    "one observation used twice": (
        ("zip(frame.ids, frame.z, frame.R)", "[*zip(frame.ids, frame.z, frame.R)] * 6"),
        None,
        "reports a covariance that fits its errors",
        r"overconfident",
    ),
    "lost symmetry": (
        ("self.P = self.P - K @ S @ K.T", "self.P = self.P - np.triu(K @ S @ K.T)"),
        None,
        "keeps P symmetric and positive definite",
        r"not symmetric",
    ),
    "wrong sign in the update": (
        ("self.P - K @ S @ K.T", "self.P + K @ S @ K.T"),
        None,
        "keeps P symmetric and positive definite",
        r"smallest eigenvalue",
    ),
    "observation noise forgotten": (
        ("S = H @ self.P @ H.T + R", "S = H @ self.P @ H.T"),
        None,
        "answers with an Estimate of finite numbers after every frame",
        r"inverse of a singular S",
    ),
    "random numbers": (
        ("self.P[:3, :3] += frame.Q", "self.P[:3, :3] += frame.Q * (1 + 1e-6 * np.random.rand())"),
        None,
        "gives the same answer twice",
        r"unseeded random numbers",
    ),
    "state kept on the class": (
        ("self.ids, self.map = [], np.empty((0, 2))", "self.map = np.empty((0, 2))"),
        ("    def __init__", "    ids = []\n\n    def __init__"),
        "answers with an Estimate of finite numbers after every frame",
        r"my_backend\.py, line \d+",
    ),
    "estimate changes the state": (
        ("        return Estimate(", "        self.P = self.P * 1.01\n        return Estimate("),
        None,
        "may be asked any number of times",
        r"a second estimate\(\) differs",
    ),
    "returns a tuple": (
        ("Estimate(self.T, self.P[:3, :3])", "(self.T, self.P[:3, :3])"),
        None,
        "answers with an Estimate of finite numbers after every frame",
        r"return slamcmp.types.Estimate",
    ),
    "writes into the frame": (
        ("        for landmark, z, R in", "        frame.z[:, 1] += 0.0\n        for landmark, z, R in"),
        None,
        "is constructed as Name(problem, **parameters)",
        r"copy an array before writing",
    ),
    "pessimistic": (
        ("self.P[:3, :3] += frame.Q", "self.P[:3, :3] += 50 * frame.Q"),
        ("H @ self.P @ H.T + R", "H @ self.P @ H.T + 50 * R"),
        "reports a covariance that fits its errors",
        r"pessimistic",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_is_found_and_named(tmp_path: Path, fault: str) -> None:
    first, second, check, message = FAULTS[fault]
    finding = findings_of(tmp_path, *(change for change in (first, second) if change))[check]
    assert not finding.passed
    assert re.search(message, finding.message), finding.message
