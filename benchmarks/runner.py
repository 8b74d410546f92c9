"""What does the runner cost? Two ratios, each within one run, medians.

* the loop around a back end (timing, collecting, checking) against a bare loop over the same calls,
* two workers against one on an experiment with several seeds.

Run ``python benchmarks/runner.py`` (about a minute; ``--json`` for numbers only). The machine should have
two idle cores.
"""

from __future__ import annotations

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.experiment.executors.fork_server import warm_up
from slamcmp.experiment.job.make_stream import make_stream
from slamcmp.experiment.job.run_back_end import run_back_end
from slamcmp.experiment.runner import run_experiment
from slamcmp.protocols import Diagnosed, JointEstimator, Mapper, Smoother
from slamcmp.registry import back_ends
from slamcmp.support.configuration.plugin_models import bind_parameters
from slamcmp.types import MeasurementStream

FRAMES = 1000
OVERHEAD_MAX = 0.05
TWO_WORKERS_MAX = 0.6
BACK_ENDS: dict[str, dict[str, Any]] = {
    "ekf_slam": {},
    "isam2": {"relinearize_skip": 10},
    "batch": {},
}
EXPERIMENT = """\
name: two_workers
source: {name: circle, steps: 400, landmarks: 40}
back_ends:
  - {name: ekf_slam}
  - {name: isam2, relinearize_skip: 10}
  - {name: batch}
seeds: 8
"""


def bare_loop(plugin: Any, parameters: dict[str, Any], stream: MeasurementStream) -> None:
    """Every call that the runner makes to the back end, and nothing else."""
    back_end = plugin.target(stream.problem, **parameters)
    diagnostics = back_end.diagnostics if isinstance(back_end, Diagnosed) else None
    for frame in stream.frames:
        back_end.update(frame)
        back_end.estimate()
        if diagnostics is not None:
            diagnostics()
    if isinstance(back_end, Smoother):
        back_end.trajectory()
    if isinstance(back_end, Mapper):
        back_end.landmarks()
    if isinstance(back_end, JointEstimator):
        back_end.joint_covariance()
    if diagnostics is not None:
        diagnostics()


def overhead(name: str, stream: MeasurementStream, rounds: int) -> tuple[float, float]:
    """Median over interleaved rounds of runner's / bare time - 1, and the median bare time [s].

    Of one thread's processor time, which equals the wall time on an idle machine and is not spoilt by others.
    """
    plugin = back_ends.get(name)
    parameters = bind_parameters(plugin, BACK_ENDS[name])
    ratios, bare_s = [], []
    for index in range(rounds):

        def bare() -> None:
            bare_loop(plugin, parameters, stream)

        def runner() -> None:
            run_back_end(
                lambda problem: plugin.target(problem, **parameters),
                stream,
                label=name,
                parameters=parameters,
            )

        # Alternate the order, so that a drift of the machine favours neither.
        order = (bare, runner) if index % 2 else (runner, bare)
        seconds = {}
        for work in order:
            begin = time.process_time()
            work()
            seconds[work.__name__] = time.process_time() - begin
        ratios.append(seconds["runner"] / seconds["bare"])
        bare_s.append(seconds["bare"])
    return float(np.median(ratios)) - 1.0, float(np.median(bare_s))


def two_workers(rounds: int) -> dict[str, float]:
    """Median wall times [s] of a whole experiment in one process, with one worker, and with two."""
    seconds: dict[str, list[float]] = {"serial": [], "one worker": [], "two workers": []}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "two_workers.yaml"
        path.write_text(EXPERIMENT)
        experiment = load_experiment(path)
        # The server loads its modules once a session; wait for it with a first, unmeasured run.
        warm_up()
        run_experiment(experiment, folder=Path(folder) / "first", jobs=2, seeds=[0], cache=False)
        for index in range(rounds):
            for name, options in (
                ("serial", {"executor": "serial"}),
                ("one worker", {"jobs": 1}),
                ("two workers", {"jobs": 2}),
            ):
                begin = time.perf_counter()
                place = Path(folder) / f"{name}{index}"
                run_experiment(experiment, folder=place, cache=False, **options)  # type: ignore[arg-type]
                seconds[name].append(time.perf_counter() - begin)
    return {name: float(np.median(each)) for name, each in seconds.items()}


def main() -> int:
    """Measure, print, and answer 1 where a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--json", action="store_true", help="numbers only")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--loop-only", action="store_true", help="leave the two workers out")
    options = parser.parse_args()
    parameters = {"steps": FRAMES, "landmarks": 100}
    stream, _ = make_stream(("circle", parameters), ("labelled", {}), 0)
    overheads = {name: overhead(name, stream, options.rounds) for name in BACK_ENDS}
    bare_total = sum(bare for _, bare in overheads.values())
    together = sum(share * bare for share, bare in overheads.values()) / bare_total
    walls = two_workers(max(1, options.rounds // 3))
    ratio = walls["two workers"] / walls["serial"]
    met = together <= OVERHEAD_MAX and ratio <= TWO_WORKERS_MAX
    if options.json:
        each = {name: {"overhead": share, "bare_s": bare} for name, (share, bare) in overheads.items()}
        print(json.dumps({"overhead": together, "back_ends": each, "walls_s": walls, "two_workers": ratio}))
        return 0 if met else 1
    print(f"runner's loop over {FRAMES} frames, {options.rounds} interleaved rounds")
    for name, (share, bare) in overheads.items():
        print(f"  {name:10} {share:+7.1%} of {bare * 1e6 / FRAMES:8.1f} µs a frame")
    print(f"  together   {together:+7.1%} (at most {OVERHEAD_MAX:.0%})")
    print("a whole experiment: " + ", ".join(f"{name} {wall:.2f} s" for name, wall in walls.items()))
    print(f"  two workers / serial {ratio:.2f} (at most {TWO_WORKERS_MAX})")
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
