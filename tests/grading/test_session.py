"""What callers of a session rely on: right answers, and the right error for each failure."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import numpy as np
import pytest

from slamcmp.grading.sandbox.errors import (
    SandboxError,
    StudentError,
    StudentTimeout,
)
from slamcmp.grading.sandbox.policy import Policy
from slamcmp.grading.sandbox.session import SandboxSession
from tests.grading.sandboxed import DEAD_RECKONING, FUNCTIONS, submission
from tests.toy_stream import toy_stream

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the sandbox needs Linux")


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


def test_a_broken_session_says_the_same_again() -> None:
    with SandboxSession(submission(FUNCTIONS), accept_weak=True) as session:
        with pytest.raises(StudentTimeout, match=r"loop\(…\): no answer within 0.2 s") as first:
            session.call("loop", deadline_s=0.2)
        with pytest.raises(StudentTimeout) as second:
            session.call("echo", 1)
        assert second.value is first.value
    with pytest.raises(SandboxError):
        session.call("echo", 1)
