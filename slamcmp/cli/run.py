"""``slamcmp run``."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from slamcmp.cli import completion
from slamcmp.cli.output import is_quiet
from slamcmp.errors import UsageError

if TYPE_CHECKING:
    import pandas as pd

    from slamcmp.experiment.planning.plan import Plan
    from slamcmp.results.judgements.verdict import PublishedVerdict
    from slamcmp.results.store import Results

UPRIGHT_ROWS = 6
"""A table with at most so many rows is printed with one line a column, unless told otherwise."""
FILE_WIDTH = 160
COLUMNS_HELP = "Metric columns of the tables, separated by commas; 'slamcmp list metrics' shows them."
EMPTY = "–"


def add_commands(app: typer.Typer) -> None:
    """Put this file's commands into the application."""
    app.command(epilog="Example: slamcmp run experiments/victoria_park.yaml --jobs 2")(run)


def run(
    config: Annotated[
        str,
        typer.Argument(
            help="Experiment file, or the name of a shipped experiment.",
            autocompletion=completion.experiments,
        ),
    ],
    jobs: Annotated[int | None, typer.Option(min=1, help="Jobs at a time; default: one a core.")] = None,
    rerun_failed: Annotated[
        bool, typer.Option("--rerun-failed", help="Run again what did not end well.")
    ] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show what would run, and stop.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print machine-readable results only.")] = False,
    seed: Annotated[
        int | None, typer.Option(min=0, help="This seed only, beside the table of others.")
    ] = None,
    results: Annotated[Path | None, typer.Option(help="Results folder; default: results/NAME.")] = None,
    executor: Annotated[
        str,
        typer.Option(help="Where jobs run: processes, serial, or dask (a cluster; extra dask)."),
    ] = "processes",
    scheduler: Annotated[
        str | None,
        typer.Option(help="With --executor dask: tcp://host:port; default: workers on this machine."),
    ] = None,
    times: Annotated[
        bool,
        typer.Option("--times", help="When all is done, time each run alone, one job after the other."),
    ] = False,
    no_report: Annotated[bool, typer.Option("--no-report", help="Write no HTML report.")] = False,
    columns: Annotated[str | None, typer.Option(help=COLUMNS_HELP)] = None,
    no_cache: Annotated[
        bool, typer.Option("--no-cache", help="Take nothing from the shared cache, and keep nothing there.")
    ] = False,
    open_page: Annotated[
        bool, typer.Option("--open", help="Show the report in the browser when it is written.")
    ] = False,
) -> None:
    """Run an experiment, or what is left of it, and print its table.

    With published numbers in the file they stand beside the measured ones, with a verdict. The exit code is 1
    where a run failed, whatever the verdict is.

    Results are reused while code, data and settings are the same, also those of other experiments and
    results folders (slamcmp cache info); --no-cache in a new folder measures times anew. A plug-in of your
    own that may have read files through a library in C is run anew each time, unless it declares them:
    register(..., files=[...]).
    """
    from slamcmp.experiment.executors.fork_server import warm_up

    if executor == "processes" and not dry_run:
        # It loads its modules while this process loads its own.
        warm_up()
    from slamcmp.experiment.config.experiment import load_experiment
    from slamcmp.experiment.config.shipped import find_experiment
    from slamcmp.experiment.gathering.manifest import folder_for_seeds
    from slamcmp.experiment.planning.plan import plan_experiment
    from slamcmp.experiment.runner import Interrupted, run_experiment
    from slamcmp.experiment.shared_cache import shared_cache
    from slamcmp.support.interruption import ignore_further

    if open_page and no_report:
        raise UsageError("--open shows the report that --no-report does not write: leave one of them out")
    experiment = load_experiment(find_experiment(config))
    chosen = _checked_columns(columns)
    seeds = None if seed is None else [seed]
    folder = results or folder_for_seeds(Path("results") / experiment.name, seeds)
    if folder.name != experiment.name and results is None and not is_quiet():
        print(
            f"results/{experiment.name} keeps the table of its seeds; this run's is {folder}", file=sys.stderr
        )
    if dry_run:
        plan = plan_experiment(
            experiment if seeds is None else experiment.with_seeds(seeds), folder, rerun_failed=rerun_failed
        )
        cache = None if no_cache else shared_cache()
        _print_plan(plan, folder, 0 if cache is None else cache.offers(plan.runs), as_json)
        return
    interruption: Interrupted | None = None
    try:
        found = run_experiment(
            experiment,
            folder=folder,
            jobs=jobs,
            rerun_failed=rerun_failed,
            seeds=seeds,
            executor=executor,
            progress=not (as_json or is_quiet()),
            command=" ".join(["slamcmp", *sys.argv[1:]]),
            cache=not no_cache,
            scheduler=scheduler,
            times=times,
        )
    except Interrupted as error:
        # A further Ctrl-C would cost the table and the message.
        ignore_further()
        # The table now; figures and page take a while, and `slamcmp report` makes them when they are wanted.
        found, interruption, no_report = error.results, error, True
    from slamcmp.report import summary_table, write_report
    from slamcmp.results.answers.answer import answer
    from slamcmp.results.judgements.summary import in_words, terminal_table, with_columns
    from slamcmp.results.judgements.verdict import judge
    from slamcmp.results.partial import missing_runs

    found = with_columns(found, chosen) if chosen else found
    summary = summary_table(found) if as_json else in_words(terminal_table(found))
    failed = found.trials[found.trials["status"] != "ok"]
    verdict, missing = judge(found), missing_runs(found)
    if not as_json:
        if found.manifest["jobs_from_cache"] and not is_quiet():
            print(
                f"{found.manifest['jobs_from_cache']} runs are from the shared cache, with the times that "
                "they took then (slamcmp cache info; --no-cache does without)",
                file=sys.stderr,
            )
        _print_results(found, summary, failed)
        if verdict is not None:
            _print_verdict(verdict)
    report, fault = None, None
    try:
        report = None if no_report else write_report(found, folder / "report.html")
    except Exception as error:
        # A page that cannot be made must not cost the answer.
        fault = error
    if as_json:
        print(
            json.dumps(
                {
                    "folder": str(found.folder),
                    "report": None if report is None else str(report),
                    "manifest": json_value(found.manifest),
                    "answer": asdict(answer(found)),
                    "summary": json_rows(with_stable_keys(summary, found)),
                    "trials": json_rows(found.trials),
                    "missing": None if missing is None else json_value(missing.as_dict()),
                    "published": None if verdict is None else json_value(verdict.as_dict()),
                },
                default=str,
                allow_nan=False,
            )
        )
    elif report is not None:
        print(f"report: {report}")
    if open_page and report is not None:
        show_page(report)
    if fault is not None:
        raise fault
    if interruption is not None:
        raise interruption
    if len(failed):
        raise typer.Exit(1)


def show_page(path: Path) -> None:
    """Open a page in the browser; where there is none, say so, and where the page is."""
    import webbrowser

    if not webbrowser.open(path.resolve().as_uri()):
        print(f"no browser was found; the page is {path}", file=sys.stderr)


def _checked_columns(text: str | None) -> list[str]:
    """What --columns names.

    Raises:
        UsageError: one of them is no metric column, before anything runs.
    """
    if text is None:
        return []
    from slamcmp.results.judgements.summary import checked_columns

    return checked_columns([name.strip() for name in text.split(",")], "--columns")


def with_stable_keys(summary: pd.DataFrame, results: Results) -> pd.DataFrame:
    """The summary with columns called as in the trials table: headings are words, and words change."""
    from slamcmp.results.judgements.summary import summary_columns

    known = {column.full_header: column.name for column in summary_columns(results)}
    return summary.rename(columns=lambda name: known.get(name, str(name).replace(" ", "_")))


def json_rows(table: pd.DataFrame) -> list[dict[str, Any]]:
    """The rows of a table as JSON knows them: null for what is missing or not finite."""
    plain = table.astype(object).where(table.notna(), None)
    return [{str(key): json_value(value) for key, value in row.items()} for row in plain.to_dict("records")]


def json_value(value: Any) -> Any:
    """Null in place of numbers that JSON does not know, Python's types in place of numpy's."""
    if isinstance(value, dict):
        return {str(key): json_value(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [json_value(each) for each in value]
    if hasattr(value, "item"):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def print_table(table: pd.DataFrame, *, upright_rows: int = UPRIGHT_ROWS) -> None:
    """A table on standard output: upright where it has few rows, else in blocks of columns that fit."""
    from rich.console import Console
    from rich.table import Table

    console = Console(width=None if sys.stdout.isatty() else FILE_WIDTH, highlight=False, markup=False)
    columns = [[str(name), *map(_cell, table[name])] for name in table.columns]
    columns = [column for column in columns if set(column[1:]) - {"", EMPTY}]
    if len(table) <= upright_rows:
        upright = [list(row) for row in zip(*columns, strict=True)]
        blocks = _blocks(upright[:1], upright[1:], console.width)
    else:
        # Everything up to "runs" names a row; it is repeated in every block.
        names = [column[0] for column in columns]
        keys = names.index("runs") if "runs" in names else 1
        blocks = _blocks(columns[:keys], columns[keys:], console.width)
    for block in blocks:
        shown = Table(box=None, header_style="bold", pad_edge=False)
        for index, column in enumerate(block):
            shown.add_column(column[0], justify="left" if index == 0 else "right", no_wrap=True)
        for row in list(zip(*block, strict=True))[1:]:
            shown.add_row(*row)
        console.print(shown)


def _blocks(keys: list[list[str]], columns: list[list[str]], width: int) -> list[list[list[str]]]:
    """Columns in groups as wide as fit beside the keys."""
    gap = 2

    def wide(column: list[str]) -> int:
        return max(map(len, column)) + gap

    left = width - sum(map(wide, keys))
    blocks: list[list[list[str]]] = []
    room = 0
    for column in columns:
        if not blocks or wide(column) > room:
            blocks.append([*keys])
            room = left
        blocks[-1].append(column)
        room -= wide(column)
    return blocks


def _cell(value: Any) -> str:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return EMPTY
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _print_plan(plan: Plan, folder: Path, in_cache: int, as_json: bool) -> None:
    from slamcmp.results.grid import point_name

    if as_json:
        print(
            json.dumps(
                {
                    "folder": str(folder),
                    "trials": len(plan.trials),
                    "streams_to_make": sorted(plan.streams),
                    "runs_to_do": sorted(plan.runs),
                    "runs_reused": plan.reused,
                    "runs_in_cache": in_cache,
                }
            )
        )
        return
    for trial in plan.trials:
        swept = [f"{point_name(trial.swept)},"] if trial.swept else []
        seed = [] if trial.seed is None else [f"seed={trial.seed}"]
        jobs = [f"{job.back_end.label}{'' if job.key in plan.runs else ' (done)'}" for job in trial.runs]
        place = " ".join([*swept, *seed]).removesuffix(",")
        print(f"trial {trial.number}: {f'{place}: ' if place else ''}{', '.join(jobs)}")
    known = f" ({in_cache} of them are in the shared cache)" if in_cache else ""
    print(
        f"{len(plan.trials)} trials; to do: {len(plan.streams)} streams, {len(plan.runs)} runs{known}; "
        f"reused: {plan.reused} runs; results: {folder}"
    )


def _print_results(results: Results, summary: pd.DataFrame, failed: pd.DataFrame) -> None:
    from slamcmp.results.answers.answer import answer
    from slamcmp.results.judgements.departures import departure_lines
    from slamcmp.results.judgements.hindsight import filters_without_hindsight
    from slamcmp.results.judgements.summary import priors_in_body_axes, warm_started
    from slamcmp.results.partial import missing_runs

    missing = missing_runs(results)
    if not summary.empty:
        print_table(summary)
        print(f"\n{answer(results)}\n")
    if missing is not None:
        print(missing.sentence())
    for row in failed.itertuples():
        seed = "" if row.seed is None or str(row.seed) == "<NA>" else f", seed {row.seed!s}"
        print(f"{row.status!s}: {row.label!s} (trial {row.trial!s}{seed}): {row.message!s}", file=sys.stderr)
    for text in results.manifest.get("warnings", []):
        print(f"warning: {text}", file=sys.stderr)
    for text in departure_lines(results):
        print(f"left what its covariance allows: {text}")
    alone = filters_without_hindsight(results)
    if alone:
        print(
            f"final columns are the smoothers' alone: {', '.join(alone)} have none; with "
            "{name: ekf_world, smooth: true} a filter has its own hindsight (RTS)"
        )
    borrowed = warm_started(results)
    if borrowed:
        print(f"online columns of {', '.join(borrowed)}: the warm start's (iSAM2's by default), not its own")
    lags = priors_in_body_axes(results)
    if lags:
        print(
            f"covariances of {', '.join(lags)}: too small where poses have left the lag, for GTSAM keeps "
            "their prior in body axes; sliding_window keeps it in the world's"
        )
    search = results.manifest.get("until")
    if search:
        coverage = search.get("coverage")
        real = f" (each holds its median with {100 * coverage:.0f} %)" if coverage is not None else ""
        print(f"seeds: {search['reason']}{real if search['reached'] else ''}")
    # Before what may follow on standard error.
    print(f"results: {results.folder}", flush=True)


def _print_verdict(verdict: PublishedVerdict) -> None:
    from slamcmp.report.published import order_rows, value_rows
    from slamcmp.results.judgements.summary import in_words

    print(f"\npublished: {verdict.source.strip()}")
    for table in (value_rows(verdict), order_rows(verdict)):
        if len(table):
            print_table(in_words(table), upright_rows=0)
    print(f"verdict: {verdict.sentence()}")
