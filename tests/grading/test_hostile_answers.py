"""What an answer does to the grader costs the test that it was given in, and nothing else."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slamcmp.errors import UsageError
from slamcmp.grading.assignment.description import Assignment, LimitFields, TestSpec, load_assignment
from slamcmp.grading.results.outcome import load_outcome
from slamcmp.grading.run.implementations import compact
from slamcmp.grading.run.judge import Judged, without_points
from slamcmp.grading.run.judging_process import Apart
from slamcmp.grading.sandbox.errors import SandboxUnavailable, StudentError
from tests.grading import toy_assignment

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the sandbox needs Linux")

LIMITS = LimitFields(grader_s=0.5, grader_mb=64)


@pytest.fixture
def toy(tmp_path: Path) -> Assignment:
    return load_assignment(toy_assignment.write(tmp_path))


class Doing:
    """A judge that does something of ours at each test, and counts what it has judged."""

    def __init__(
        self, assignment: Assignment, do: Mapping[int, Callable[[], Any]], late: bool = False
    ) -> None:
        self.tests = assignment.tests
        self.evidence_lost = False
        self._do, self._late = do, late

    def judged(self, number: int, spec: TestSpec, shares: Mapping[str, float]) -> Judged:
        if not self._late:
            self._do.get(number, int)()
        message = f"process {os.getpid()}, evidence {'lost' if self.evidence_lost else 'kept'}"
        outcome = without_points(number, spec, "passed", message)
        return Judged(outcome, (), "strong", {}, explained=not self._late)

    def explained(self, judged: Judged, spec: TestSpec) -> Judged:
        self._do.get(int(judged.test.number), int)()
        return judged


def recurse() -> None:
    recurse()


def crash() -> None:
    ctypes.string_at(0)


def compute() -> None:
    while True:
        pass


FAULTS = {
    "segfault": (crash, "killed by SIGSEGV", "ended the grader's own process"),
    "killed": (lambda: os.kill(os.getpid(), signal.SIGKILL), "killed by SIGKILL", "ended the grader's own"),
    "memory": (lambda: bytearray(1 << 27), "ran out of its 64 MB", "more memory than the grader has"),
    "hang": (compute, "ended after 0.5 s", "more than 0.5 s to look at it"),
    "exit": (lambda: os._exit(3), "exit code 3", "ended the grader's own process"),
    "recursion": (recurse, "exit code 1", "ended the grader's own process"),
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("late", [False, True], ids=["judging", "explaining"])
def test_a_test_that_ends_the_grader_is_lost_and_the_next_one_is_judged(
    toy: Assignment, fault: str, late: bool
) -> None:
    do, detail, told = FAULTS[fault]
    with Apart(Doing(toy, {2: do}, late), LIMITS) as judging:  # type: ignore[arg-type]
        first, second, third = (
            judging.judged(number, spec, {}).test for number, spec in enumerate(toy.tests, start=1)
        )
    assert first.message.endswith("evidence kept")
    assert third.message.endswith("evidence lost")
    assert first.message.split(",")[0] != third.message.split(",")[0]
    assert detail in second.staff_detail
    if late:
        # What it earned was known before.
        assert (second.status, second.judged) == ("passed", True)
    else:
        assert (second.status, second.score, second.judged) == ("error", 0.0, False)
        assert told in second.message


def test_one_process_judges_all_tests_that_go_well_and_ends_with_the_grading(toy: Assignment) -> None:
    with Apart(Doing(toy, {}), LIMITS) as judging:  # type: ignore[arg-type]
        messages = {judging.judged(number, spec, {}).test.message for number, spec in enumerate(toy.tests, 1)}
    (message,) = messages
    pid = int(message.split(",")[0].split()[1])
    assert pid != os.getpid()
    assert not Path("/proc", str(pid)).exists()


@pytest.mark.parametrize("kind", [UsageError, SandboxUnavailable])
def test_a_fault_of_the_assignment_or_the_machine_is_raised_here(toy: Assignment, kind: type) -> None:
    def fail() -> None:
        raise kind("cases.py: there is no function 'drive'")

    with Apart(Doing(toy, {1: fail}), LIMITS) as judging, pytest.raises(kind, match="no function 'drive'"):  # type: ignore[arg-type]
        judging.judged(1, toy.tests[0], {})


# Each is the whole of a function that should answer with twice the number it is given.
WRONG = {
    "15 megabytes": "return np.zeros(15 << 17)",
    "sixty thousand rows": "return np.zeros((60000, 1))",
    "empty": "return np.zeros(0)",
    "lists in lists": "y = [x]\n    for _ in range(14): y = [y, y]\n    return y",
    "a deep list": "y = []\n    for _ in range(100000): y = [y]\n    return y",
    "a list in itself": "y = []\n    y.append(y)\n    return y",
    "objects": "return np.array([None, {}, 'a'], dtype=object)",
    "16 megabytes of text": "return 'x' * (1 << 24)",
    "text that just passes": "return 'x' * (1 << 19)",
    "a million entries": "return dict.fromkeys(map(str, range(1000000)), 1)",
    "entries that just pass": "return {str(i): i for i in range(40000)}",
    "an enormous integer": "return 10 ** 100000",
    "a long integer": "return 10 ** 4000",
    "nan": "return float('nan')",
    "infinity": "return np.array(np.inf)",
    "a complex number": "return 2.0 * x + 0j",
    "structures": "return np.zeros(3, dtype=[('a', float), ('b', 'U10')])",
    "a text of the number": "return np.array(str(2 * x))",
    "dates": "return np.array('2024-01-01', dtype='datetime64[D]')",
    "nine axes": "return np.zeros((1,) * 9)",
    "a generator": "return (y for y in [x])",
    "a type": "return float",
    "prints": "for i in range(3000): print('\\x1b[2J' + 'x' * 1000)\n    return 3.0",
    "a generator without end": "import itertools\n    return (y for y in itertools.count())",
    "a list that lies": (
        "class Lying(list):\n"
        "        def __len__(self): return 1\n"
        "        def __iter__(self):\n"
        "            while True: yield 2.0 * x\n"
        "    return Lying([2.0 * x] * 3)"
    ),
    "masked": "return np.ma.masked_all(3)",
    "a deep tuple": "y = (2.0 * x,)\n    for _ in range(5000): y = (y,)\n    return y",
    "objects in themselves": "y = np.empty(2, dtype=object)\n    y[:] = [y, y]\n    return y",
    "a terabyte by strides": "return np.broadcast_to(np.float64(2.0), (1 << 20, 1 << 17))",
    "itself": "return double(x)",
    "an integer that is no number": (
        "class Odd(int):\n        def __index__(self): raise MemoryError\n    return [Odd(2)] * 3"
    ),
    "hostile subclass": (
        "class Evil(np.ndarray):\n"
        "        def __array_function__(self, *a): raise SystemExit\n"
        "        def __array_ufunc__(self, *a, **k): raise SystemExit\n"
        "        def __array_finalize__(self, other): pass\n"
        "        shape = property(lambda self: (1 << 40,))\n"
        "    return np.zeros(2).view(Evil)"
    ),
}
RIGHT = {
    "extended precision": "return np.longdouble(2.0) * x",
    "numpy's number": "return np.float64(2.0 * x)",
    "half precision's number": "return np.float16(8.0) if x == 4.0 else 2.0 * x",
    "no axes": "return np.array(2.0 * x)",
    "not contiguous": "return np.full((4, 4), 2.0 * x).T[::2, 1][0:1].reshape(())",
    "subclass": "return np.array(2.0 * x).view(type('Mine', (np.ndarray,), {}))",
}
CALLS = 10
"""Of ``double`` by the toy's test."""
AT_ONCE = 8


def submission(double: str) -> str:
    return f"import numpy as np\n{double}\ndef half(x): return x / 2.0\ndef square(x): return x * x\n"


@pytest.mark.parametrize("first", range(0, len(WRONG), AT_ONCE))
def test_no_answer_hurts_more_than_its_call(staging_area: Path, first: int) -> None:
    wrong = list(WRONG.values())[first : first + AT_ONCE]
    bodies = [*wrong, *RIGHT.values(), *RIGHT.values()][:CALLS]
    double = "".join(f"def double_{i}(x):\n    {body}\n" for i, body in enumerate(bodies))
    double += "calls = iter(range(99))\ndef double(x): return globals()[f'double_{next(calls)}'](x)\n"
    score, message = graded(staging_area, submission(double))
    right = CALLS - len(wrong)
    assert score == pytest.approx(right), message
    assert f"{right} of {CALLS} calls of double are right" in message


def test_an_answer_above_the_limit_ends_its_test(staging_area: Path) -> None:
    score, message = graded(staging_area, submission("def double(x): return np.zeros(7 << 20)"))
    assert score == 0
    assert "what is no answer: announces" in message


GRADE = """
import os, sys
from pathlib import Path
from slamcmp.grading.run.grade_process import GradeProcess, GradeRequest

assignment, submission, outcome, log = sys.argv[1:]
request = GradeRequest(
    assignment=assignment,
    submission=submission,
    student="ada",
    secret=b"a secret of the tests".hex(),
    outcome=outcome,
    accept_weak_sandbox=True,
)
process = GradeProcess(request, time_limit_s=60, log=Path(log))
_, status, usage = os.wait4(process._process.pid, 0)
process._process.returncode = os.waitstatus_to_exitcode(status)
process.kill()
print(usage.ru_maxrss)
sys.exit(1 if status else 0)
"""


def graded(place: Path, source: str) -> tuple[float, str]:
    """Score and message of the toy's first test; the others have to be right, and no process large."""
    spec = toy_assignment.write(place) / "assignment.yaml"
    # A busy machine may need its time for a million entries.
    spec.write_text(spec.read_text().replace("request_s: 2", "request_s: 30"))
    (place / "toy.py").write_text(source)
    outcome, log = place / "outcome.json", place / "log"
    asked = [str(place / "toy"), str(place / "toy.py"), str(outcome), str(log)]
    # From a small process of its own: Linux counts what the parent had at the fork as its child's, and this
    # one may have run hundreds of tests.
    told = subprocess.run([sys.executable, "-c", GRADE, *asked], capture_output=True, text=True)
    assert told.returncode == 0, told.stderr + (log.read_text() if log.exists() else "")
    first, *others = load_outcome(outcome).tests
    assert [test.score for test in others] == [10.0, 10.0]
    assert len(first.message) < 5000
    # Of any process of the grading, the submission's own among them [KiB].
    assert int(told.stdout) < 400 << 10
    return first.score, first.message


def test_long_lists_become_arrays_and_outputs_stay_apart() -> None:
    rows = [[1.0, 2.0]] * 1500
    means, covariances = compact("f", (rows, [[[0.5]]] * 60))
    assert (type(means), means.shape, covariances.shape) == (np.ndarray, (1500, 2), (60, 1, 1))
    assert compact("f", [[1, 2], [3.0, "x"], None]) == [[1, 2], [3.0, "x"], None]
    ragged = [[1.0], [1.0, 2.0]] * 30
    assert compact("f", ragged) == ragged
    assert compact("f", list(range(60))).dtype.kind == "i"


@pytest.mark.parametrize("answer", [dict.fromkeys(map(str, range(6000)), 1), [[[0.0, "x"]] * 2] * 1500])
def test_an_answer_of_very_many_parts_is_refused(answer: object) -> None:
    with pytest.raises(StudentError, match="f answers with more than 5000 parts outside of arrays"):
        compact("f", answer)
