"""``slamcmp advise``."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from slamcmp.advice.advice import Advice


def add_commands(app: typer.Typer) -> None:
    """Put this file's commands into the application."""
    app.command(
        epilog="Examples: slamcmp advise quickstart | slamcmp advise my_robot.yaml --budget-ms 5 --hindsight "
        "| slamcmp advise log_of_monday/ --set source.range_sigma_m=0.1 --html advice.html"
    )(advise)


def advise(
    config: Annotated[
        str,
        typer.Argument(
            help="Experiment file or shipped name; or a recording: its folder (odometry.csv, detections.csv, "
            "truth.csv, landmarks.csv), its odometry file, or a folder of such folders."
        ),
    ],
    hindsight: Annotated[
        bool,
        typer.Option(
            "--hindsight/--online", help="Judge the trajectory afterwards, or what is known at the time."
        ),
    ] = False,
    budget_ms: Annotated[
        float | None, typer.Option(min=0.0, help="Time there is for a frame, kept to in 95 of 100.")
    ] = None,
    memory_mb: Annotated[float | None, typer.Option(min=0.0, help="Memory that a run may add.")] = None,
    seeds: Annotated[int, typer.Option(min=1, help="Paired trials at most, of a seeded source.")] = 20,
    time_limit_s: Annotated[float, typer.Option(min=0.0, help="Wall time for the whole advice.")] = 300.0,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set", help="source.NAME=VALUE or front_end.NAME=VALUE, repeatable: in place of the file's."
        ),
    ] = None,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Jobs at a time; default: one a core. Times are truest with 1.")
    ] = None,
    results: Annotated[
        Path | None, typer.Option(help="Results folder; default: results/NAME-advice.")
    ] = None,
    html: Annotated[Path | None, typer.Option(help="Write the advice as a page, too.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the advice as JSON only.")] = False,
) -> None:
    """Say which back end to take for this robot, from a short paired experiment on its own problem.

    Odometry alone, EKF, right-invariant and iterated EKF, sliding windows, iSAM2, batch, and the filters with
    their RTS smoother run on the problem's own source, front end and noise, over as many seeds as the time
    allows. The advice is the cheapest whose error is within 5 % of the best, the whole 95 % interval, and
    that is not overconfident. What the runs do not tell is said to be so. A seeded source is then tried a
    little otherwise: what would change the advice?

    The results are an ordinary experiment's and are reused; after Ctrl-C the same command goes on from there.
    """
    from slamcmp.experiment.executors.fork_server import warm_up

    # It loads its modules while this process loads its own, and Ctrl-C leaves it alone.
    warm_up()
    from slamcmp.advice.advise import advise as make_advice

    found = make_advice(
        config,
        hindsight=hindsight,
        budget_ms=budget_ms,
        memory_mb=memory_mb,
        seeds=seeds,
        time_limit_s=time_limit_s,
        settings=settings or (),
        folder=results,
        jobs=jobs,
        progress=not as_json,
        command=" ".join(["slamcmp", *sys.argv[1:]]),
    )
    if html is not None:
        from slamcmp.advice.page import advice_html
        from slamcmp.support.files.atomic import write_atomically

        page = advice_html(found)
        write_atomically(html, lambda file: file.write(page.encode("utf-8", "replace")))
    if as_json:
        from slamcmp.cli.run import json_value

        print(json.dumps(json_value(found.as_dict()), indent=2, default=str, allow_nan=False))
        return
    _print(found)
    if html is not None:
        print(f"page: {html}")


def _print(found: Advice) -> None:
    import textwrap

    from slamcmp.cli.run import print_table

    for each in found.sentences:
        print(textwrap.fill(each.text, 100, initial_indent="* ", subsequent_indent="  "))
    print()
    print_table(found.table, upright_rows=0)
    print(f"results: {found.folder}", flush=True)
