"""``slamcmp seeds``: how many seeds does a difference need?"""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slamcmp.cli import completion

if TYPE_CHECKING:
    from slamcmp.results.judgements.power import SeedPlan


def add_commands(app: typer.Typer) -> None:
    """Put this file's commands into the application."""
    app.command(
        epilog="Examples: slamcmp seeds quickstart --metric online_ate --difference 0.01 | "
        "slamcmp seeds results/pilot --metric final_ate --difference 0.05 --relative --power 0.9"
    )(seeds)


def seeds(
    experiment: Annotated[
        str,
        typer.Argument(
            help="Results folder of a pilot, or the experiment (file or name) it belongs to.",
            autocompletion=completion.results_folders,
        ),
    ],
    metric: Annotated[
        str,
        typer.Option(help="Column of the trials table, e.g. online_ate.", autocompletion=completion.metrics),
    ],
    difference: Annotated[float, typer.Option(min=0.0, help="Difference to be seen, in the metric's unit.")],
    relative: Annotated[
        bool,
        typer.Option("--relative", help="The difference is a share of the first back end's mean."),
    ] = False,
    power: Annotated[
        float, typer.Option(min=0.01, max=0.999, help="Probability of seeing the difference.")
    ] = 0.8,
    alpha: Annotated[
        float, typer.Option(min=0.0001, max=0.5, help="Probability of seeing one that is not there.")
    ] = 0.05,
    as_json: Annotated[bool, typer.Option("--json", help="Print the plan as JSON only.")] = False,
) -> None:
    """Say how many seeds a difference between back ends needs, paired and unpaired, from a pilot's seeds.

    The paired number is for the test that the report shows: Student's t on the log of the ratio, seed by
    seed. Means are geometric.
    """
    from slamcmp.results.judgements.power import plan_seeds
    from slamcmp.results.store import load_results

    found = load_results(_pilot(experiment))
    plans = plan_seeds(found, metric, difference, relative=relative, power=power, alpha=alpha)
    if as_json:
        rows = [
            {name: None if value != value else value for name, value in asdict(each).items()}
            for each in plans
        ]
        about = {"metric": metric, "power": power, "alpha": alpha, "pilot": str(found.folder)}
        print(json.dumps({**about, "plans": rows}, indent=2, default=str))
        return
    for each in plans:
        _print(each, metric, power, alpha)


def _pilot(experiment: str) -> Path:
    """The results folder meant: itself, ``results/NAME``, or that of the experiment's file."""
    from slamcmp.errors import MissingDataError
    from slamcmp.experiment.config.experiment import load_experiment
    from slamcmp.experiment.config.shipped import find_experiment
    from slamcmp.results.store import find_results
    from slamcmp.support.files.paths import is_dir

    folder = find_results(experiment)
    if not is_dir(folder):
        name = load_experiment(find_experiment(experiment)).name
        folder = Path("results") / name
        if not is_dir(folder):
            raise MissingDataError(
                f"{folder}: no pilot yet; run one with 10 or more seeds: slamcmp run {experiment}"
            )
    return folder


def _print(plan: SeedPlan, metric: str, power: float, alpha: float) -> None:
    from slamcmp.results.grid import point_name

    where = point_name(plan.point)
    print(f"{plan.back_end} against {plan.compared_with}{f' at {where}' if where else ''}")
    lost = f", {plan.lost} not finished by both" if plan.lost else ""
    correlation = "" if math.isnan(plan.correlation) else f", correlation {plan.correlation:.2f}"
    print(f"  pilot: {plan.pairs} pairs{lost}, ratio {plan.ratio:.3g}{correlation}")
    print(
        f"  to see a ratio of {plan.goal:.4g} in {metric} (a difference of {plan.difference:.3g}) with "
        f"probability {power:g} (alpha {alpha:g}):"
    )
    print(
        f"  paired:   {plan.paired} seeds (simulated {plan.paired_simulated}; the pilot leaves "
        f"{plan.paired_low} to {plan.paired_high} possible)"
    )
    print(f"  unpaired: {plan.unpaired} seeds a back end (simulated {plan.unpaired_simulated})")
    if plan.lost:
        share = plan.pairs / (plan.pairs + plan.lost)
        print(f"  with as many failures as in the pilot: {math.ceil(plan.paired / share)} paired seeds")
