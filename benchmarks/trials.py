"""What does a trial cost beside its estimators, and how does that grow with their number?

* P1 (2500 frames, five compiled filters) as an experiment in one process, against the bare filters over the
  same streams: the ratio, and what a run and a stream cost beside them.
* Sweeps of short trials: processor time a trial of a first run, a dry run, and a resumed run with 1 % left.

All is processor time of one process (executor ``serial``), which other users of a machine disturb least. Run
``python benchmarks/trials.py`` (two minutes; ``--trials 100 1000 10000`` for the whole curve, ``--json`` for
numbers only).
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
from collections.abc import Callable
from pathlib import Path
from typing import Any

import slamcmp.experiment.job.preload  # noqa: F401  What workers have loaded before their first job.
from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.experiment.job.make_stream import make_stream
from slamcmp.experiment.planning.plan import plan_experiment
from slamcmp.experiment.runner import run_experiment
from slamcmp.support.configuration.plugin_models import bind_parameters
from slamcmp.types import MeasurementStream

P1 = Path(__file__).parents[1] / "experiments" / "anchors" / "p1.yaml"
RATIO_MAX = 2.5
BESIDE_MAX_S = 0.1
SHORT = """\
name: short
source: {{name: circle, steps: 20, landmarks: 6}}
back_ends: [{{name: ekf_slam}}]
seeds: {seeds}
"""


def seconds_of(work: Callable[[], Any]) -> float:
    begin = time.process_time()
    work()
    return time.process_time() - begin


def bare(component: Any, stream: MeasurementStream) -> None:
    """The filter's own calls and nothing else."""
    plugin = component.plugin()
    back_end = plugin.target(stream.problem, **bind_parameters(plugin, dict(component.parameters)))
    for frame in stream.frames:
        back_end.update(frame)
        back_end.estimate()


def of_p1(seeds: int) -> dict[str, float]:
    """Processor seconds of P1 with so many seeds, in one process and of its parts alone."""
    experiment = load_experiment(P1).with_seeds(range(seeds))
    source, front_end = ((each.spec, each.arguments()) for each in (experiment.source, experiment.front_end))
    with tempfile.TemporaryDirectory() as folder:
        # What is compiled or loaded with the first run is not measured.
        run_experiment(experiment.with_seeds([0]), folder=Path(folder) / "first", executor="serial")
        whole = seconds_of(lambda: run_experiment(experiment, folder=Path(folder) / "r", executor="serial"))
    making = estimating = 0.0
    for seed in range(seeds):
        streams: list[MeasurementStream] = []
        making += seconds_of(lambda: streams.append(make_stream(source, front_end, seed)[0]))  # noqa: B023
        for component in experiment.back_ends:
            estimating += seconds_of(lambda: bare(component, streams[0]))  # noqa: B023
    runs = seeds * len(experiment.back_ends)
    return {
        "ratio": whole / estimating,
        "whole_s_a_seed": whole / seeds,
        "estimators_s_a_seed": estimating / seeds,
        "stream_s": making / seeds,
        "beside_s_a_run": (whole - estimating - making) / runs,
    }


def of_sweep(trials: int) -> dict[str, float]:
    """Processor milliseconds a trial of short trials."""
    with tempfile.TemporaryDirectory() as folder:
        path, results = Path(folder) / "short.yaml", Path(folder) / "r"
        path.write_text(SHORT.format(seeds=trials))
        experiment = load_experiment(path)
        most = experiment.with_seeds(range(trials - max(1, trials // 100)))
        first = seconds_of(lambda: run_experiment(most, folder=results, executor="serial"))
        dry = seconds_of(lambda: plan_experiment(experiment, results))
        resumed = seconds_of(lambda: run_experiment(experiment, folder=results, executor="serial"))
    per = 1e3 / trials
    return {"trials": trials, "first_ms": per * first, "dry_ms": per * dry, "resumed_ms": per * resumed}


def main() -> int:
    """Measure, print, and answer 1 where a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--json", action="store_true", help="numbers only")
    parser.add_argument("--seeds", type=int, default=4, help="of P1")
    parser.add_argument("--trials", type=int, nargs="+", default=[100, 1000], help="of the sweeps")
    options = parser.parse_args()
    p1 = of_p1(options.seeds)
    sweeps = [of_sweep(trials) for trials in options.trials]
    met = p1["ratio"] <= RATIO_MAX and p1["stream_s"] <= BESIDE_MAX_S and p1["beside_s_a_run"] <= BESIDE_MAX_S
    if options.json:
        print(json.dumps({"p1": p1, "sweeps": sweeps}))
        return 0 if met else 1
    print(f"P1, {options.seeds} seeds, processor time in one process")
    print(f"  experiment over bare filters {p1['ratio']:.2f} (at most {RATIO_MAX})")
    print(f"  a seed {p1['whole_s_a_seed']:.3f} s, of it the five filters {p1['estimators_s_a_seed']:.3f} s")
    print(f"  a stream {p1['stream_s']:.3f} s (at most {BESIDE_MAX_S})")
    print(f"  a run beside its filter {p1['beside_s_a_run']:.3f} s (at most {BESIDE_MAX_S})")
    print(f"{'trials':>8} {'first':>9} {'dry run':>9} {'resumed with 1 % left':>22}   ms a trial")
    for row in sweeps:
        print(f"{row['trials']:8d} {row['first_ms']:9.2f} {row['dry_ms']:9.3f} {row['resumed_ms']:22.2f}")
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
