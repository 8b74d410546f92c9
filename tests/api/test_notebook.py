"""In a real Jupyter kernel: a cell's class, figures inline, and a run that is interrupted half-way."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

manager = pytest.importorskip("jupyter_client.manager")
pytest.importorskip("ipykernel")

CELL_CLASS = """
import slamcmp

class Standing:
    def __init__(self, problem):
        self.problem = problem
    def update(self, frame):
        pass
    def estimate(self):
        return slamcmp.Estimate(self.problem.T_world_body, self.problem.P)
"""

INTERRUPTED = """
import time

class Slow(Standing):
    def update(self, frame):
        time.sleep(0.03)

asked = {
    "name": "half",
    "source": {"name": "circle", "landmarks": 5, "steps": 15},
    "back_ends": BACK_ENDS,
    "seeds": 30,
}
results = slamcmp.run(asked, jobs=1)
"""


class Kernel:
    """Runs cells one after the other."""

    def __init__(self, folder: Path) -> None:
        self.manager, self.client = manager.start_new_kernel(
            startup_timeout=120, kernel_name="python3", cwd=str(folder)
        )

    def run(self, code: str, *, interrupt_on: str = "") -> dict[str, Any]:
        """What a cell gave: ``text`` it printed, ``data`` it showed by type, ``error`` as (name, message).

        With ``interrupt_on`` the stop button is pressed as soon as these words were printed.
        """
        told: dict[str, Any] = {"text": "", "data": {}, "error": None}
        request = self.client.execute(code)
        end = time.monotonic() + 120
        while time.monotonic() < end:
            message = self.client.get_iopub_msg(timeout=120)
            if message["parent_header"].get("msg_id") != request:
                continue
            kind, content = message["msg_type"], message["content"]
            if kind == "stream":
                told["text"] += content["text"]
            elif kind in ("execute_result", "display_data"):
                told["data"] |= content["data"]
                told["text"] += content["data"].get("text/plain", "")
            elif kind == "error":
                told["error"] = content["ename"], content["evalue"]
            elif kind == "status" and content["execution_state"] == "idle":
                return told
            if interrupt_on and interrupt_on in told["text"]:
                self.manager.interrupt_kernel()
                interrupt_on = ""
        raise TimeoutError(told["text"])


@pytest.fixture(scope="module")
def kernel(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Kernel]:
    found = Kernel(tmp_path_factory.mktemp("notebook"))
    yield found
    found.client.stop_channels()
    found.manager.shutdown_kernel(now=True)


def test_a_cells_class_is_run_scored_and_drawn(kernel: Kernel) -> None:
    assert kernel.run(CELL_CLASS)["error"] is None
    made = kernel.run("stream = slamcmp.make_stream('circle', 1, landmarks=5, steps=12)\nstream")
    assert "12 frames" in made["text"], made
    ran = kernel.run("one = slamcmp.run_back_end(Standing, stream)\none")
    assert "12 of 12 frames" in ran["data"]["text/plain"], ran
    assert "<table>" in ran["data"]["text/html"]
    drawn = kernel.run("slamcmp.plot(one, truth=stream)")
    assert drawn["data"]["image/png"].startswith("iVBOR"), drawn
    whole = kernel.run(
        "slamcmp.run({'source': {'name': 'circle', 'landmarks': 5, 'steps': 12},"
        " 'back_ends': [Standing, 'dead_reckoning'], 'name': 'cell'})"
    )
    assert whole["error"] is None, whole
    assert "Standing: in this process" in whole["text"]
    assert (
        "class Standing"
        in kernel.run("print(slamcmp.load_results('cell').manifest['in_session']['Standing'])")["text"]
    )


@pytest.mark.parametrize("back_ends", ["['dead_reckoning']", "['dead_reckoning', Slow]"])
def test_an_interrupted_run_leaves_results_and_the_kernel_alive(kernel: Kernel, back_ends: str) -> None:
    kernel.run(CELL_CLASS)
    cell = INTERRUPTED.replace("BACK_ENDS", back_ends).replace("half", f"half{len(back_ends)}")
    stopped = kernel.run(cell, interrupt_on="dead_reckoning (seed 1): ok")
    assert stopped["error"] is not None, stopped
    assert stopped["error"][0] == "Interrupted", stopped
    assert "the same" in stopped["error"][1]
    name = f"half{len(back_ends)}"
    look = f"found = slamcmp.load_results({name!r})\nprint(len(found.trials), found.manifest['jobs_missing'])"
    rows, missing = map(int, kernel.run(look)["text"].split())
    assert rows > 0
    assert missing > 0
    # Fewer seeds, so that the rest of the test is short; what ran is found again.
    again = kernel.run(
        "asked['seeds'] = 3\nresults = slamcmp.run(asked, progress=False)\n"
        "print(results.manifest['jobs_reused'], results.manifest['jobs_missing'], len(results.trials))"
    )
    assert again["error"] is None, again
    reused, missing, rows = map(int, again["text"].split()[-3:])
    assert reused >= 2
    assert missing == 0
    assert rows == 3 * (1 + back_ends.count(","))
