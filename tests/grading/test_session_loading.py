"""What of a submission is loaded, and what it may import."""

from __future__ import annotations

import sys

import pytest

from slamcmp.grading.hand_in.submission import Submission
from slamcmp.grading.sandbox.errors import (
    ProtocolViolation,
    SandboxUnavailable,
    StudentCrashed,
    StudentError,
)
from slamcmp.grading.sandbox.policy import Policy
from slamcmp.grading.sandbox.session import SandboxSession
from tests.grading.sandboxed import FUNCTIONS, submission

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the sandbox needs Linux")

# Writes to every descriptor there may be, the reply pipe among them.
_SCRIBBLE = """
import os
for descriptor in range(1, 1000):
    try:
        os.write(descriptor, b"x" * 99)
    except OSError:
        pass
"""


@pytest.mark.parametrize(
    ("source", "kind", "text"),
    [
        ("x = = 1", StudentError, "SyntaxError: invalid syntax\n  ekf.py, line 1, in <module>: x = = 1"),
        ("import nonexistent", StudentError, "ModuleNotFoundError: No module named 'nonexistent'"),
        ("import pandas", StudentError, "ModuleNotFoundError: No module named 'pandas'"),
        ("raise SystemExit(0)", StudentError, "SystemExit: 0"),
        ("import os\nos._exit(3)", StudentCrashed, "ended itself with exit code 3"),
        ("import os, signal\nos.kill(os.getpid(), signal.SIGSEGV)", StudentCrashed, "crashed with SIGSEGV"),
        (_SCRIBBLE, ProtocolViolation, "does not start like an answer"),
    ],
)
def test_a_failing_import_is_told_as_what_it_is(source: str, kind: type, text: str) -> None:
    with pytest.raises(kind) as caught:
        SandboxSession(submission(source), Policy(packages=("numpy",)), accept_weak=True)
    assert text in str(caught.value)


def test_a_notebook_s_exploration_does_not_run() -> None:
    source = (
        "GATE = 5.99\nprint('no')\nraise SystemExit\nBIG = print('neither')\ndef gate():\n    return GATE\n"
    )
    made = Submission("n", "notebook", {"n.py": source.encode()}, "n.py", definitions_only=True)
    with SandboxSession(made, accept_weak=True) as session:
        assert session.call("gate") == 5.99
        assert session.output == ""


def test_neighbours_and_data_of_a_folder_can_be_used() -> None:
    source = """
from pathlib import Path
from maths.double import double
def answer(x):
    return double(x) + float((Path(__file__).parent / "data.txt").read_text())
"""
    more = {"maths/double.py": "def double(x):\n    return 2 * x\n", "data.txt": "0.5"}
    with SandboxSession(submission(source, **more), accept_weak=True) as session:
        assert session.call("answer", 2) == 4.5


def test_gtsam_and_opencv_work_inside() -> None:
    source = """
import cv2, gtsam
import numpy as np
def both():
    graph = gtsam.NonlinearFactorGraph()
    graph.addPriorPose2(1, gtsam.Pose2(1, 2, 0.5), gtsam.noiseModel.Isotropic.Sigma(3, 0.1))
    values = gtsam.Values()
    values.insert(1, gtsam.Pose2())
    pose = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize().atPose2(1)
    image = np.zeros((64, 64), np.uint8)
    image[20:40, 20:40] = 255
    return pose.x(), pose.y(), pose.theta(), len(cv2.goodFeaturesToTrack(image, 10, 0.1, 5))
"""
    packages = ("numpy", "gtsam", "cv2")
    with SandboxSession(
        submission(source), Policy(packages=packages, preload=packages), accept_weak=True
    ) as session:
        assert session.call("both", deadline_s=20) == pytest.approx((1.0, 2.0, 0.5, 4))


def test_packages_that_cannot_be_allowed_are_refused() -> None:
    with pytest.raises(SandboxUnavailable, match="holds solutions"):
        SandboxSession(submission(FUNCTIONS), Policy(packages=("numpy", "slamcmp")))
    with pytest.raises(SandboxUnavailable, match="'nonexistent', which is not installed"):
        SandboxSession(submission(FUNCTIONS), Policy(packages=("numpy", "nonexistent")))


def test_plots_are_not_drawn_and_do_not_fail() -> None:
    source = """
import matplotlib
import matplotlib.pyplot as plt
from matplotlib.patches import Ellipse
matplotlib.use("TkAgg")
def f():
    figure, axes = plt.subplots(2, 2)
    axes[0, 1].plot([1, 2], label="x").set_color("red")
    for axis in axes.flat:
        axis.add_patch(Ellipse((0, 0), 1, 2))
    with plt.style.context("ggplot"):
        plt.show()
    return 1.5
"""
    with SandboxSession(submission(source), accept_weak=True) as session:
        assert session.call("f") == 1.5
    with pytest.raises(StudentError, match="No module named 'matplotlib'"):
        SandboxSession(submission(source), Policy(inert=()), accept_weak=True)
