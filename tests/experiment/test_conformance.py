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
        ("Estimate(self.T, self.J @ self.P[:3, :3] @ self.J.T)", "Estimate(self.T, self.turned())"),
        (
            "    def estimate(self):",
            "    def turned(self):\n"
            "        B = np.eye(3)\n"
            "        B[:2, :2] = self.T[:2, :2]\n"
            "        return B @ self.J @ self.P[:3, :3] @ self.J.T @ B.T\n\n"
            "    def estimate(self):",
        ),
        "reports P in the body tangent, order (x, y, heading)",
        r"it is in world axes",
    ),
    "heading first": (
        (
            "self.J @ self.P[:3, :3] @ self.J.T)",
            "(self.J @ self.P[:3, :3] @ self.J.T)[np.ix_([2, 0, 1], [2, 0, 1])])",
        ),
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
            "self.sensor.residual(frame.z, z)",
            "(frame.z - z)",
        ),
        None,
        "uses its observations",
        r"not wrapped",
    ),
    "noise as standard deviation": (
        ("block_diag(*frame.R)", "block_diag(*(frame.R @ frame.R))"),
        None,
        "reports a covariance that fits its errors",
        r"overconfident; cause: R is taken for standard deviations",
    ),
    "mean is never corrected": (
        ("self.T, self.J = retract_in_world_axes(self.T, dx[:3])", "self.J = np.eye(3)"),
        None,
        "uses its observations",
        r"dead reckoning's",
    ),
    "one observation used twice": (
        ("block_diag(*frame.R)", "block_diag(*frame.R) / 2"),
        None,
        "reports a covariance that fits its errors",
        r"overconfident; cause: every observation is taken in twice",
    ),
    "lost symmetry": (
        ("self.P - K @ S @ K.T", "self.P - np.triu(K @ S @ K.T)"),
        None,
        "keeps P symmetric and positive definite",
        r"not symmetric",
    ),
    "wrong sign in the update": (
        ("self.P - K @ S @ K.T", "self.P + K @ S @ K.T"),
        None,
        "uses its observations",
        r"dead reckoning's",
    ),
    "more taken than there is": (
        ("self.P - K @ S @ K.T", "self.P - K @ S @ K.T - 1e-4 * np.eye(len(self.P))"),
        None,
        "keeps P symmetric and positive definite",
        r"smallest eigenvalue",
    ),
    "observation noise forgotten": (
        ("S = H @ self.P @ H.T + block_diag(*frame.R)", "S = H @ self.P @ H.T"),
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
        ("self.ids, self.map, self.J = [], np.empty((0, 2))", "self.map, self.J = np.empty((0, 2))"),
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
        ("Estimate(self.T, self.J @ self.P[:3, :3] @ self.J.T)", "(self.T, self.P[:3, :3])"),
        None,
        "answers with an Estimate of finite numbers after every frame",
        r"return slamcmp.types.Estimate",
    ),
    "writes into the frame": (
        ("        new = ~np", "        frame.z[:, 1] += 0.0\n        new = ~np"),
        None,
        "is constructed as Name(problem, **parameters)",
        r"copy an array before writing",
    ),
    "no odometry noise": (
        ("self.P[:3, :3] += frame.Q", "self.P[:3, :3] += 0 * frame.Q"),
        None,
        "uses its observations",
        r"dead reckoning's .* m; cause: Q is left out .*another fault may stand beside it",
    ),
    "pessimistic": (
        ("self.P[:3, :3] += frame.Q", "self.P[:3, :3] += 50 * frame.Q"),
        ("H @ self.P @ H.T + block_diag(*frame.R)", "H @ self.P @ H.T + 50 * block_diag(*frame.R)"),
        "reports a covariance that fits its errors",
        r"pessimistic; cause not found",
    ),
}


SUBTLE = {
    "new landmarks without their correlation to the pose": (
        "self.P = block_diag(self.P, 1e4 * np.eye(2 * new.sum()))",
        "G = self.sensor.jacobians(self.T, self.map[len(self.map) - new.sum() :])[1]\n"
        "        own = [np.linalg.inv(g) @ r @ np.linalg.inv(g).T for g, r in zip(G, frame.R[new])]\n"
        "        self.P = block_diag(self.P, *own)",
    ),
    "noise of range and bearing as metres": (
        "block_diag(*frame.R)",
        "block_diag(*(H_j @ r @ H_j.T for H_j, r in zip(H_land, frame.R)))",
    ),
    "half the measurement noise": ("block_diag(*frame.R)", "0.5 * block_diag(*frame.R)"),
    "a third of the odometry's noise": ("+= frame.Q", "+= frame.Q / 3"),
    "twice the measurement noise": ("block_diag(*frame.R)", "2.0 * block_diag(*frame.R)"),
    "cross-covariance cut down": (
        "self.P - K @ S @ K.T",
        "self.P - K @ S @ K.T\n        self.P[:3, 3:] *= 0.9\n        self.P[3:, :3] *= 0.9",
    ),
    "Jacobians of three frames before": (
        "z, H[:, :, :3], H_land = self.sensor.linearise(self.T, self.map[seen])",
        "z, _, _ = self.sensor.linearise(self.T, self.map[seen])\n"
        "        before = self.T @ np.linalg.matrix_power(np.linalg.inv(frame.T_prev_body), 3)\n"
        "        _, H[:, :, :3], H_land = self.sensor.linearise(before, self.map[seen])",
    ),
}
"""Faults that leave a filter running, and its answers near the truth."""


@pytest.mark.parametrize("fault", SUBTLE)
def test_a_covariance_outside_the_printed_band_is_a_fault(tmp_path: Path, fault: str) -> None:
    findings = findings_of(tmp_path, SUBTLE[fault])
    assert [finding for finding in findings.values() if not finding.passed] != []


NO_POSES = {
    "not a rotation": (
        "Estimate(self.T,",
        "Estimate(self.T * 1.001,",
        "keeps T_world_body a rigid",
        "off the identity",
    ),
    "a reflection": (
        "Estimate(self.T,",
        "Estimate(self.T @ np.diag([1.0, -1.0, 1.0]),",
        "keeps T_world_body a rigid",
        "det R is -1",
    ),
    "not finite": ("Estimate(self.T,", "Estimate(self.T * np.nan,", "answers with an Estimate", "not finite"),
    "of space": (
        "Estimate(self.T, ",
        "Estimate(np.eye(4), np.eye(6)); (",
        "answers with an Estimate",
        r"\(4, 4\) where",
    ),
    "a vector": ("Estimate(self.T,", "Estimate(self.T[:2, 2],", "answers with an Estimate", "T_world_body"),
    "the whole P": (
        "self.J @ self.P[:3, :3] @ self.J.T",
        "self.P",
        "answers with an Estimate",
        r"Estimate\.P",
    ),
}


@pytest.mark.parametrize("fault", NO_POSES)
def test_what_is_no_pose_is_refused(tmp_path: Path, fault: str) -> None:
    old, new, check, message = NO_POSES[fault]
    (finding,) = (each for name, each in findings_of(tmp_path, (old, new)).items() if name.startswith(check))
    assert not finding.passed
    assert re.search(message, finding.message), finding.message


@pytest.mark.parametrize(
    ("method", "check"),
    [
        (
            "def landmarks(self):\n"
            "        told = super().landmarks()\n"
            "        return Landmarks(told.ids, told.positions, 0.4 * told.covariances)",
            "reports landmark covariances that fit their errors",
        ),
        (
            "def joint_covariance(self):\n"
            "        P = super().joint_covariance()\n"
            "        own = np.kron(np.eye(len(P)), np.ones((1, 1))) * P\n"
            "        return 0.8 * P + 0.2 * own",
            "reports a joint covariance that fits pose and map together",
        ),
        (
            "def joint_covariance(self):\n"
            "        P = super().joint_covariance().copy()\n"
            "        P[:3, 3:], P[3:, :3] = 0.0, 0.0\n"
            "        return P",
            "has blocks in its joint covariance that agree with its other answers",
        ),
    ],
)
def test_map_and_joint_covariances_are_held_to_their_errors(tmp_path: Path, method: str, check: str) -> None:
    """The pose's part is right in both."""
    path = tmp_path / "mine.py"
    path.write_text(
        "import numpy as np\nfrom slamcmp.backends.filters.ekf_slam import EkfSlam\n"
        f"from slamcmp.types import Landmarks\n\n\nclass Mine(EkfSlam):\n    {method}\n",
        encoding="utf-8",
    )
    failed = {finding.check for finding in check_back_end(f"{path}:Mine") if not finding.passed}
    assert check in failed
    assert "reports a covariance that fits its errors" not in failed


@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_is_found_and_named(tmp_path: Path, fault: str) -> None:
    first, second, check, message = FAULTS[fault]
    finding = findings_of(tmp_path, *(change for change in (first, second) if change))[check]
    assert not finding.passed
    assert re.search(message, finding.message), finding.message
