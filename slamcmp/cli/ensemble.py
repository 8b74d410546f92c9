"""``slamcmp ensemble``."""

from __future__ import annotations

import json
import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slamcmp.cli import completion

if TYPE_CHECKING:
    from slamcmp.ensembles.outcome import Ensemble
    from slamcmp.experiment.config.experiment import Experiment
    from slamcmp.results.judgements.verdict import PublishedVerdict

INTERRUPTED = 130


class Where(StrEnum):
    """Where an ensemble runs."""

    auto = "auto"
    cpu = "cpu"
    cuda = "cuda"


def add_commands(app: typer.Typer) -> None:
    """Put this file's commands into the application."""
    app.command(
        epilog="Examples: slamcmp ensemble anchors/p1 --seeds 100000 | "
        "slamcmp ensemble anchors/p2 --seeds 2000 --workers 1 | "
        "slamcmp ensemble my_circle.yaml --seeds 1000000 --target cuda"
    )(ensemble)


def ensemble(
    experiment: Annotated[
        str,
        typer.Argument(
            help="Experiment file or shipped name, in the world 'circle'.",
            autocompletion=completion.experiments,
        ),
    ],
    seeds: Annotated[int, typer.Option(min=2, max=100_000_000, help="Paired runs of each filter.")] = 1000,
    target: Annotated[
        Where,
        typer.Option(help="Where to run; auto: a GPU where there is one (extra 'cuda'), else the cores."),
    ] = Where.auto,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Threads on the CPU; default: one a core. No number changes.")
    ] = None,
    compare: Annotated[
        int, typer.Option(min=0, help="Runs of each filter that the ordinary back ends repeat.")
    ] = 2,
    samples: Annotated[
        int, typer.Option(min=0, help="Write the streams of so many runs, seeds 0, 1, …, as ordinary files.")
    ] = 0,
    results: Annotated[
        Path | None, typer.Option(help="Results folder; default: results/NAME-ensemble.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the numbers as JSON only.")] = False,
) -> None:
    """Run the planar filters of an experiment on very many paired seeds, as one compiled program.

    For ekf_slam, ekf_world, ekf_right_invariant, ekf_fej, ekf_oc and ekf_ideal in the world 'circle'. World,
    filter and scores are one loop on each core, or one block of threads a run on a GPU; nothing is stored of
    a run but its scores. Noise is counted, not drawn in turn: seed 7 is another world than seed 7 of
    `slamcmp run`, and the same on every machine. Some runs are repeated by the ordinary back ends, on the
    same stream; the table says how far apart they are.

    After Ctrl-C the table is of the runs that every filter has done; the same command goes on from there, and
    so does one with more seeds.
    """
    from slamcmp.experiment.config.experiment import load_experiment
    from slamcmp.experiment.config.shipped import find_experiment

    chosen = load_experiment(find_experiment(experiment))
    folder = results or Path("results") / f"{chosen.name}-ensemble"
    found, ended = _run(chosen, folder, seeds, target, workers, compare, quiet=as_json)
    if found is None or not found.runs:
        print("slamcmp: interrupted before any run was done", file=sys.stderr)
        raise typer.Exit(INTERRUPTED)
    written = _write_samples(found, folder, samples)
    if as_json:
        from slamcmp.cli.run import json_value
        from slamcmp.ensembles.stored import as_dict

        verdict = _verdict(found, chosen)
        more = {
            "published": None if verdict is None else json_value(verdict.as_dict()),
            "folder": str(folder),
        }
        print(json.dumps(as_dict(found) | more, indent=2, allow_nan=False))
    else:
        _print(found, chosen)
        for path in written:
            print(f"stream: {path}")
        print(f"results: {folder}")
    if not ended:
        print(
            f"slamcmp: interrupted after {found.seeds} of {seeds} seeds; the same command goes on from there",
            file=sys.stderr,
        )
        raise typer.Exit(INTERRUPTED)
    if any(each.failures for each in found.runs):
        raise typer.Exit(1)


def _run(
    chosen: Experiment,
    folder: Path,
    seeds: int,
    target: Where,
    workers: int | None,
    compared: int,
    *,
    quiet: bool,
) -> tuple[Ensemble | None, bool]:
    """What was found, and whether it is the whole."""
    from slamcmp.ensembles.ensemble import ensemble_in_steps
    from slamcmp.ensembles.problem import ensemble_problem
    from slamcmp.ensembles.stored import load_ensemble, save_ensemble
    from slamcmp.ensembles.targets import Target, why_no_gpu

    problem = ensemble_problem(chosen)
    where: Target = "cpu"
    if target is Where.cuda or (target is Where.auto and why_no_gpu() is None):
        where = "cuda"
    for line in () if quiet else problem.left_out:
        print(f"left out: {line}", file=sys.stderr)
    before = found = load_ensemble(problem, folder)
    about = {"command": " ".join(["slamcmp", *sys.argv[1:]]), "target": where}
    try:
        for step in ensemble_in_steps(
            problem,
            seeds,
            target=where,
            workers=workers,
            compared=compared,
            before=before,
            progress=None if quiet else _Progress(),
        ):
            found = step
            save_ensemble(found, folder, about)
    except KeyboardInterrupt:
        return found, False
    return found, True


class _Progress:
    """A line a step at most: on a terminal in place, elsewhere every tenth of the whole."""

    def __init__(self) -> None:
        self._told: dict[str, int] = {}

    def __call__(self, label: str, done: int, wanted: int) -> None:
        if sys.stderr.isatty():
            end = "\n" if done == wanted else ""
            print(f"\r{label}: {done} of {wanted} runs", end=end, file=sys.stderr, flush=True)
            return
        tenth = 10 * done // wanted
        if tenth > self._told.get(label, 0):
            self._told[label] = tenth
            print(f"{label}: {done} of {wanted} runs", file=sys.stderr, flush=True)


def _write_samples(found: Ensemble, folder: Path, samples: int) -> list[Path]:
    from slamcmp.ensembles.sample import sample_run
    from slamcmp.frontend.stream_file import save_stream

    paths = []
    for seed in range(samples):
        paths.append(folder / f"stream-{seed}.npz")
        save_stream(sample_run(found.problem, found.problem.filters[0], seed).stream, paths[-1])
    return paths


SHOWN = {
    "ensemble_heading_rmse_deg": "heading RMSE [deg]",
    "ensemble_position_rmse": "position RMSE [m]",
    "ensemble_nees_heading": "NEES heading",
    "ensemble_nees_position": "NEES position",
    "ensemble_nees_pose": "NEES pose",
    "ensemble_mean_heading_rmse_deg": "mean over frames of heading RMSE [deg]",
    "ensemble_mean_position_rmse": "mean over frames of position RMSE [m]",
}


def _print(found: Ensemble, chosen: Experiment) -> None:
    import pandas as pd

    from slamcmp.cli.run import print_table

    published = {} if chosen.published is None else {row.label: row.values for row in chosen.published.rows}
    ratios = found.ratios()
    first = found.runs[0].label
    rows = []
    for each in found.runs:
        row = {"back end": each.label, "runs": str(len(each.scores)), "failed": str(each.failures or "")}
        for name, number in each.metrics().items():
            error = (
                f" ± {number.standard_error:.1g}" if number.standard_error == number.standard_error else ""
            )
            row[SHOWN[name]] = f"{number.value:.4g}{error}"
            if name in published.get(each.label, {}):
                row[f"{SHOWN[name]}, published"] = f"{published[each.label][name]:g}"
        if each.label in ratios:
            ratio = ratios[each.label]
            row[f"position RMSE over {first}'s"] = f"{ratio.value:.4f} [{ratio.low:.4f}, {ratio.high:.4f}]"
            row["which is"] = ratio.verdict
        if each.label in found.deviations:
            row["from the ordinary back end"] = f"{found.deviations[each.label]:.0e}"
        rows.append(row)
    print_table(pd.DataFrame(rows).fillna(""), upright_rows=6)
    print("± standard error over the runs; in brackets the paired 95 % interval")
    verdict = _verdict(found, chosen)
    if verdict is not None:
        print(f"against {verdict.source}: {verdict.sentence()}")


def _verdict(found: Ensemble, chosen: Experiment) -> PublishedVerdict | None:
    from slamcmp.ensembles.published import judge_ensemble

    return None if chosen.published is None else judge_ensemble(found, chosen.published)
