"""What callers rely on: right answers, the right error for each failure, and nothing left behind."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from slamcmp.grading.hand_in.submission import Submission
from slamcmp.grading.sandbox import kernel
from slamcmp.grading.sandbox.errors import (
    ProtocolViolation,
    SandboxError,
    SandboxUnavailable,
    StudentCrashed,
    StudentError,
    StudentTimeout,
)
from slamcmp.grading.sandbox.policy import Policy
from slamcmp.grading.sandbox.proofs import MEANING
from slamcmp.grading.sandbox.readable import world_reachable
from slamcmp.grading.sandbox.session import SandboxSession
from tests.toy_stream import toy_stream

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the sandbox needs Linux")

DEAD_RECKONING = """
import numpy as np
from slamcmp.types import Estimate, Landmarks, Trajectory

class DeadReckoning:
    def __init__(self, problem, *, inflation=1.0):
        self.T, self.P, self.inflation = problem.T_world_body, problem.P, inflation
        self.sensor, self.seen, self.path = problem.sensor, {}, []

    def update(self, frame):
        self.T = self.T @ frame.T_prev_body
        self.P = self.P + self.inflation * frame.Q
        self.path.append((frame.t, self.T))
        for i, z in zip(frame.ids, frame.z):
            self.seen.setdefault(int(i), self.sensor.invert(self.T, z))

    def estimate(self):
        return Estimate(self.T, self.P)

    def landmarks(self):
        positions = np.array(list(self.seen.values())).reshape(-1, 2)
        return Landmarks(list(self.seen), positions, np.tile(np.eye(2), (len(positions), 1, 1)))

    def joint_covariance(self):
        return np.eye(3 + 2 * len(self.seen))

    def trajectory(self):
        return Trajectory([t for t, _ in self.path], [T for _, T in self.path])
"""

FUNCTIONS = """
import time
import numpy as np
from slamcmp.types import Estimate

def swap(a, b, *, scale=1.0):
    return scale * b, a

def echo(value):
    return value

def bad(x):
    return helper(x)

def helper(x):
    raise ValueError(f"no good: {x}")

def nothing_to_see():
    return object()

def loop():
    while True:
        pass

def spend(seconds):
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass

def talk(n):
    print("x" * n)

def imports():
    import decimal, fractions, sqlite3, statistics, unittest
    import scipy.linalg, scipy.stats
    return float(scipy.linalg.norm(np.random.default_rng(0).normal(size=3)))

class Wrong:
    def __init__(self, kind):
        self.kind = kind
    def estimate(self):
        return {
            "tuple": (np.eye(3), np.eye(3)),
            "shape": Estimate.__new__(Estimate),
            "none": None,
        }[self.kind]
    def landmarks(self):
        class Made:
            ids, positions, covariances = np.arange(2), np.zeros((3, 2)), np.zeros((2, 2, 2))
        return Made()
"""

# Writes to every descriptor there may be, the reply pipe among them.
_SCRIBBLE = """
import os
for descriptor in range(1, 30):
    try:
        os.write(descriptor, b"x" * 99)
    except OSError:
        pass
"""


def submission(source: str, **more: str) -> Submission:
    files = {"ekf.py": source.encode(), **{name: text.encode() for name, text in more.items()}}
    return Submission("test", "folder", files, "ekf.py")


@pytest.fixture(scope="module")
def functions() -> Iterator[SandboxSession]:
    with SandboxSession(submission(FUNCTIONS), accept_weak=True) as session:
        yield session


def test_a_back_end_gives_the_same_bits_as_without_a_sandbox() -> None:
    stream, _, _ = toy_stream(frames=20)
    there: dict[str, type] = {}
    exec(DEAD_RECKONING, there)
    local = there["DeadReckoning"](stream.problem, inflation=2.0)
    with SandboxSession(submission(DEAD_RECKONING), accept_weak=True) as session:
        assert session.names == ("DeadReckoning",)
        handle = session.construct("DeadReckoning", stream.problem, {"inflation": 2.0})
        for frame in stream.frames:
            local.update(frame)
            answer = session.step(handle, frame, landmarks=True, joint_covariance=True)
            assert np.array_equal(answer.estimate.T_world_body, local.estimate().T_world_body)
            assert np.array_equal(answer.estimate.P, local.estimate().P)
            assert np.array_equal(answer.landmarks.ids, local.landmarks().ids)
            assert np.array_equal(answer.landmarks.positions, local.landmarks().positions)
            assert np.array_equal(answer.joint_covariance, local.joint_covariance())
            assert answer.trajectory is None
        path = session.trajectory(handle)
        assert np.array_equal(path.T_world_body, local.trajectory().T_world_body)
        assert path.P is None
        second = session.construct("DeadReckoning", stream.problem)
        session.update(second, stream.frames[0])
        assert np.array_equal(session.estimate(second).P, stream.problem.P)
        assert session.landmarks(second).ids.size == stream.frames[0].ids.size


def test_functions_get_and_give_arrays(functions: SandboxSession) -> None:
    a, b = np.arange(6.0).reshape(2, 3), np.array([True, False])
    first, second = functions.call("swap", a, b, scale=2.0)
    assert first.tolist() == [2.0, 0.0]
    assert np.array_equal(second, a)
    value = {"text": "Σ", "list": [1, None, (2.5, True)], "empty": np.zeros((0, 2))}
    arrived = functions.call("echo", value)
    assert arrived["text"] == "Σ"
    assert arrived["list"] == [1, None, (2.5, True)]
    assert arrived["empty"].shape == (0, 2)


def test_allowed_modules_can_be_imported_after_closing(functions: SandboxSession) -> None:
    expected = float(np.linalg.norm(np.random.default_rng(0).normal(size=3)))
    assert functions.call("imports", deadline_s=30) == pytest.approx(expected, rel=1e-15)


def test_an_exception_names_the_student_s_own_lines(functions: SandboxSession) -> None:
    with pytest.raises(StudentError) as caught:
        functions.call("bad", 3)
    error = caught.value
    assert (error.type_name, error.message) == ("ValueError", "no good: 3")
    assert [(at.file, at.line, at.function) for at in error.frames] == [
        ("ekf.py", 13, "bad"),
        ("ekf.py", 16, "helper"),
    ]
    assert error.frames[1].code == 'raise ValueError(f"no good: {x}")'
    assert "ekf.py, line 16, in helper" in error.text
    # And the session lives on.
    assert functions.call("echo", 1) == 1


def test_what_is_missing_or_wrong_is_said(functions: SandboxSession) -> None:
    with pytest.raises(StudentError, match="the submission has no 'predict'; it defines: Wrong, bad, echo"):
        functions.call("predict")
    with pytest.raises(StudentError, match="object is not an array, a number"):
        functions.call("nothing_to_see")
    with pytest.raises(StudentError, match="missing 1 required positional argument"):
        functions.call("bad")
    wrong = functions.construct("Wrong", None, {"kind": "tuple"})
    with pytest.raises(StudentError, match=r"estimate\(\) returned tuple, which has no 'T_world_body'"):
        functions.estimate(wrong)
    with pytest.raises(StudentError, match=r"estimate\(\) returned NoneType"):
        functions.estimate(functions.construct("Wrong", None, {"kind": "none"}))
    with pytest.raises(StudentError, match=r"shape \(3, 2\) where \(2, 'any'\) is needed|positions"):
        functions.landmarks(wrong)
    with pytest.raises(StudentError, match="AttributeError"):
        functions.trajectory(wrong)


def test_processor_time_is_the_kernel_s(functions: SandboxSession) -> None:
    before = functions.cpu_s()
    functions.call("spend", 0.2)
    assert 0.2 <= functions.cpu_s() - before < 0.3
    assert functions.last_wall_s >= 0.2


def test_output_is_kept_up_to_its_cap() -> None:
    policy = Policy(packages=("numpy",), output_bytes=1000)
    with SandboxSession(submission(FUNCTIONS), policy, accept_weak=True) as session:
        session.call("talk", 400)
        assert session.output == "x" * 400 + "\n"
        session.call("talk", 1000)
        assert session.output == "x" * 400 + "\n" + "x" * 599 + "\n[402 more bytes not kept]"
    assert session.output.endswith("[402 more bytes not kept]")


def test_control_characters_do_not_pass() -> None:
    source = r"""
def f():
    print("\x1b[2Jcleared\tü")
    raise type("A\nB", (Exception,), {})("\r\x9b2J")
"""
    with SandboxSession(submission(source), accept_weak=True) as session:
        with pytest.raises(StudentError) as caught:
            session.call("f")
        assert session.output == "�[2Jcleared\tü\n"
    assert (caught.value.type_name, caught.value.message) == ("A B", "��2J")


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


def test_a_broken_session_says_the_same_again() -> None:
    with SandboxSession(submission(FUNCTIONS), accept_weak=True) as session:
        with pytest.raises(StudentTimeout, match=r"loop\(…\): no answer within 0.2 s") as first:
            session.call("loop", deadline_s=0.2)
        with pytest.raises(StudentTimeout) as second:
            session.call("echo", 1)
        assert second.value is first.value
    with pytest.raises(SandboxError):
        session.call("echo", 1)


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


def test_hidden_grading_is_refused_without_read_protection() -> None:
    unprotected = ("private root", "own uid", "Landlock", "bubblewrap")
    with pytest.raises(SandboxUnavailable, match="cannot keep hidden tests from a submission") as caught:
        SandboxSession(submission(FUNCTIONS), without=unprotected)
    assert "read_public_file" in str(caught.value)
    with SandboxSession(submission(FUNCTIONS), without=unprotected, accept_weak=True) as session:
        assert session.level == "reads unprotected"
        assert session.proofs["read_public_file"] == "failed"
        assert session.proofs["open_socket"] == "proved"
        assert session.layers["Landlock"] == "not active: switched off"
    with SandboxSession(
        submission(FUNCTIONS), without=(*unprotected, "seccomp"), accept_weak=True
    ) as session:
        assert session.level == "weak"


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root")
def test_as_root_everything_is_proved(functions: SandboxSession) -> None:
    if "not active" in functions.layers["private root"] + functions.layers["Landlock"]:
        pytest.skip(f"this machine lacks a layer: {dict(functions.layers)}")
    assert functions.level == "strong"
    assert set(functions.layers.values()) == {"active"}
    assert dict(functions.proofs) == dict.fromkeys(MEANING, "proved")


def test_packages_that_cannot_be_allowed_are_refused() -> None:
    with pytest.raises(SandboxUnavailable, match="holds solutions"):
        SandboxSession(submission(FUNCTIONS), Policy(packages=("numpy", "slamcmp")))
    with pytest.raises(SandboxUnavailable, match="'nonexistent', which is not installed"):
        SandboxSession(submission(FUNCTIONS), Policy(packages=("numpy", "nonexistent")))


def test_nothing_is_left_behind(staging_area: Path) -> None:
    def state() -> tuple[int, int, int, list[str]]:
        staged = os.listdir(staging_area)
        children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
        return len(os.listdir("/proc/self/fd")), len(children), kernel.prctl(kernel.PR_GET_DUMPABLE), staged

    before = state()
    with SandboxSession(submission(FUNCTIONS), accept_weak=True) as session:
        assert kernel.prctl(kernel.PR_GET_DUMPABLE) == 0
        assert len(os.listdir(staging_area)) == 1
        session.call("talk", 10)
    for source in ("raise ValueError", "import os; os._exit(1)"):
        with pytest.raises(SandboxError):
            SandboxSession(submission(source), accept_weak=True)
    assert state() == before


def test_what_a_killed_grader_left_is_removed(staging_area: Path) -> None:
    gone, alive = 2**22 + 1, os.getpid()
    for name, age_s in ((f"slamcmp-{gone}-a", 7200), (f"slamcmp-{gone}-b", 60), (f"slamcmp-{alive}-c", 7200)):
        (staging_area / name / "submission").mkdir(parents=True)
        os.utime(staging_area / name, (time.time() - age_s,) * 2)
    SandboxSession(submission(FUNCTIONS), accept_weak=True).close()
    assert sorted(os.listdir(staging_area)) == sorted([f"slamcmp-{gone}-b", f"slamcmp-{alive}-c"])


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


def test_sessions_work_side_by_side_in_threads() -> None:
    results: dict[int, float] = {}

    def work(value: int) -> None:
        with SandboxSession(submission(FUNCTIONS), accept_weak=True) as session:
            time.sleep(0.1)
            results[value] = session.call("echo", value)

    threads = [threading.Thread(target=work, args=(value,)) for value in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert results == {0: 0, 1: 1, 2: 2}


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root to become another user")
def test_another_user_gets_read_protection_too(tmp_path: Path) -> None:
    if not all(world_reachable(path) for path in (sys.executable, os.__file__, np.__file__, __file__)):
        pytest.skip("the interpreter, numpy or slamcmp lie where another user may not read")
    script = """
from slamcmp.grading.sandbox.session import SandboxSession
from slamcmp.grading.hand_in.submission import Submission
with SandboxSession(Submission("s", "file", {"s.py": b"def f(x): return x"}, "s.py")) as session:
    assert session.call("f", 3) == 3
    print(session.level, *(name for name, outcome in session.proofs.items() if outcome != "proved"))
"""
    done = subprocess.run(
        [sys.executable, "-c", script], user=65534, group=65534, extra_groups=[], cwd="/",
        env={"PYTHONPATH": str(Path(__file__).parents[2]), "PATH": os.environ["PATH"]},
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    if "SandboxUnavailable" in done.stderr:
        pytest.skip(f"no Landlock and no bubblewrap here: {done.stderr.splitlines()[-1]}")
    assert done.stdout.strip() in ("strong", "names visible look_up_file"), done.stderr
