"""``slamcmp import trajectory`` and ``slamcmp export``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from slamcmp.cli import completion
from slamcmp.errors import UsageError

if TYPE_CHECKING:
    from slamcmp.results.store import Results
    from slamcmp.types import Run


class ImportFormat(StrEnum):
    """What a trajectory can be read from."""

    tum = "tum"
    kitti = "kitti"
    euroc = "euroc"
    csv = "csv"
    parquet = "parquet"


class ExportFormat(StrEnum):
    """What a run can be written as."""

    tum = "tum"
    kitti = "kitti"
    euroc = "euroc"
    g2o = "g2o"
    csv = "csv"
    parquet = "parquet"


class Which(StrEnum):
    """Which of a run's trajectories."""

    online = "online"
    final = "final"


SUFFIXES = {"tum": "txt", "kitti": "txt", "euroc": "csv"}


def add_commands(app: typer.Typer) -> None:
    """Put this file's commands into the application."""
    group = typer.Typer(
        help="Take in what other programs estimated.",
        epilog="Example: slamcmp import trajectory orb.txt --truth truth.txt --as ORB --online",
        no_args_is_help=True,
    )
    group.command(
        epilog="Examples: slamcmp import trajectory orb.txt --truth truth.txt --as ORB --online | slamcmp "
        "import trajectory w1.csv w10.csv --truth gt.txt --as w1 --as w10 --online --results results/euroc"
    )(trajectory)
    app.add_typer(group, name="import")
    app.command(epilog="Example: slamcmp export results/quickstart --back-end EKF --trial 0 --format tum")(
        export
    )


def trajectory(
    files: Annotated[
        list[Path], typer.Argument(help="Trajectories; their formats are told by their content.")
    ],
    truth: Annotated[list[Path], typer.Option(help="True trajectory; one for all, or one for each file.")],
    label: Annotated[
        list[str],
        typer.Option("--as", help="Label; one for all (then they are repetitions), or one for each."),
    ],
    online: Annotated[
        bool | None,
        typer.Option("--online/--final", help="What was known at its time, or with hindsight: must be said."),
    ] = None,
    results: Annotated[Path, typer.Option(help="Results folder to add to.")] = Path("results/imported"),
    file_format: Annotated[ImportFormat | None, typer.Option("--format", help="Of the trajectories.")] = None,
    truth_format: Annotated[ImportFormat | None, typer.Option(help="Of the truth.")] = None,
    times: Annotated[Path | None, typer.Option(help="One stamp [s] a line, for poses of KITTI.")] = None,
    max_gap: Annotated[
        float, typer.Option(min=0.0, help="Longest gap [s] of the truth that is interpolated over.")
    ] = 0.2,
    time_offset: Annotated[float, typer.Option(help="Added to the trajectories' stamps [s].")] = 0.0,
    parameter: Annotated[
        list[str] | None, typer.Option(help="NAME=VALUE: what the system was set to, repeatable; window=10.")
    ] = None,
    replace: Annotated[bool, typer.Option("--replace", help="Replace a run that is there already.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print machine-readable results only.")] = False,
) -> None:
    """Make runs of trajectories that other programs estimated.

    Tables, figures, compare and paired statistics treat them like any other; they are marked "imported". The
    truth is interpolated at each pose's own instant, linearly and by SLERP. Without a covariance (columns
    P_00 … of a CSV or Parquet file, in the body tangent) there is no NEES.
    """
    if online is None:
        raise UsageError(
            "say --online (each pose is what was known at its time) or --final (with hindsight, as after "
            "loop closures): nothing in a file tells, and the two are never compared as one"
        )
    _require_one_or_each("--truth", truth, files)
    _require_one_or_each("--as", label, files)
    from slamcmp.results.runs.imported import Import, import_runs

    counts: dict[tuple[str, Path], int] = {}
    imports = []
    for index, file in enumerate(files):
        name = label[index if len(label) > 1 else 0]
        true = truth[index if len(truth) > 1 else 0]
        repetition = counts[name, true] = counts.get((name, true), -1) + 1
        imports.append(
            Import(
                file,
                true,
                name,
                "online" if online else "final",
                repetition,
                None if file_format is None else file_format.value,
                None if truth_format is None else truth_format.value,
                times,
                max_gap,
                time_offset,
                _parameters(parameter or ()),
            )
        )
    found = import_runs(results, imports, replaced=replace)
    _print(found, as_json=as_json)


def _require_one_or_each(option: str, given: Sequence[Any], files: Sequence[Path]) -> None:
    if len(given) not in (1, len(files)):
        raise UsageError(
            f"{option} is given {len(given)} times for {len(files)} files; once or once for each"
        )


def _parameters(given: Sequence[str]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for text in given:
        name, sign, value = text.partition("=")
        if not (name and sign) or name in ("name", "label"):
            raise UsageError(
                f"--parameter {text!r}: expected NAME=VALUE, and another name than name and label"
            )
        try:
            found[name] = json.loads(value)
        except ValueError:
            found[name] = value
    return found


def _print(found: Results, *, as_json: bool) -> None:
    from slamcmp.cli.run import json_rows, json_value, print_table, with_stable_keys
    from slamcmp.results.judgements.summary import summary_table

    table = summary_table(found)
    if as_json:
        content = {
            "folder": str(found.folder),
            "imports": json_value(found.manifest["imports"]),
            "summary": json_rows(with_stable_keys(table, found)),
            "trials": json_rows(found.trials),
        }
        print(json.dumps(content, default=str, allow_nan=False))
        return
    print_table(table)
    for text in found.manifest["warnings"]:
        print(text)
    print(f"results: {found.folder}")


def export(
    run: Annotated[
        str,
        typer.Argument(
            help="Results folder or name below results/, or a run's npz file.",
            autocompletion=completion.results_folders,
        ),
    ],
    file_format: Annotated[
        ExportFormat,
        typer.Option("--format", help="csv and parquet have covariances; g2o the whole graph of the stream."),
    ],
    back_end: Annotated[str | None, typer.Option(help="Label; default: all.")] = None,
    trial: Annotated[int | None, typer.Option(min=0, help="Trial; default: all.")] = None,
    which: Annotated[
        Which | None, typer.Option("--trajectory", help="Default: final where the run has one, else online.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option(help="File (of several runs: folder) to write; default: named by the run.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print machine-readable results only.")] = False,
) -> None:
    """Write estimated trajectories for other programs.

    Planar poses become ones in space at z = 0 where the format knows nothing else (tum, kitti, euroc); kitti
    has no time stamps. 'slamcmp import trajectory' reads all but g2o back, the source graph_file reads g2o.
    """
    runs, root, name = _chosen(run, back_end, trial)
    many = len(runs) > 1
    suffix = SUFFIXES.get(file_format.value, file_format.value)
    written = []
    for number, each in runs:
        kind, poses = _poses_of(each, which)
        own = "_".join(
            map(_file_name, [name, each.back_end, *([] if number is None else [str(number)]), kind])
        )
        place = output or Path(f"{name}_{file_format.value}" if many else f"{own}.{suffix}")
        path = place / f"{own}.{suffix}" if many else place
        _write(path, each, poses, file_format, root)
        written.append({"file": str(path), "back_end": each.back_end, "trial": number, "trajectory": kind})
        if not as_json:
            print(f"{path}: {poses.t.size} poses of {each.back_end}, {kind} ({file_format.value})")
    if as_json:
        print(json.dumps({"format": file_format.value, "files": written}))


def _chosen(run: str, label: str | None, trial: int | None) -> tuple[list[tuple[int | None, Run]], Path, str]:
    """The runs with their trials, the results folder they lie in, and a name for files."""
    from slamcmp.errors import DataError, MissingDataError
    from slamcmp.results.runs.run_file import load_run
    from slamcmp.results.runs.stored_runs import stored_run
    from slamcmp.results.store import find_results, load_results

    path = Path(run)
    if run.endswith(".npz"):
        if not path.is_file():
            raise MissingDataError(f"{path}: there is no such file")
        stored = load_run(path)
        if stored is None:
            raise DataError(f"{path}: is no run (a results folder keeps them in runs/)")
        return [(None, stored.run)], path.resolve().parent.parent, path.stem
    found = load_results(find_results(run))
    rows = found.trials
    rows = rows if label is None else rows[rows["label"] == label]
    rows = rows if trial is None else rows[rows["trial"] == trial]
    if len(rows) <= 1:
        only = stored_run(found, label, trial)
        number = int(rows["trial"].iloc[0]) if len(rows) else trial
        return [(number, only)], found.folder, found.folder.name
    ok = rows[rows["status"] == "ok"]
    pairs = [(int(row["trial"]), str(row["label"])) for row in ok.to_dict("records")]
    return (
        [(number, stored_run(found, name, number)) for number, name in pairs],
        found.folder,
        found.folder.name,
    )


def _poses_of(run: Run, which: Which | None) -> tuple[str, Any]:
    if which is Which.final or (which is None and run.final is not None):
        if run.final is None:
            raise UsageError(f"{run.back_end} has no final trajectory (it is a filter, or the run failed)")
        return "final", run.final
    return "online", run.online


def _file_name(text: str) -> str:
    return "".join(letter if letter.isalnum() or letter in "-." else "-" for letter in text)


def _write(path: Path, run: Run, poses: Any, file_format: ExportFormat, root: Path) -> None:
    from slamcmp.datasets.graphs.g2o_writer import write_g2o
    from slamcmp.datasets.trajectory_files import write_trajectory
    from slamcmp.errors import MissingDataError, StorageError
    from slamcmp.frontend.stream_file import load_stream
    from slamcmp.support.files.packed_files import is_there

    if file_format is not ExportFormat.g2o:
        write_trajectory(path, poses, file_format.value)  # type: ignore[arg-type]
        return
    stream = root / "streams" / f"{run.digest}.npz"
    if not is_there(stream):
        raise MissingDataError(
            f"{stream}: the stream of this run is not there, whose edges a g2o file holds (imported runs "
            "have none); tum, kitti, euroc, csv and parquet need none"
        )
    measured = load_stream(stream)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_g2o(path, measured, poses=poses.T_world_body, landmarks=run.landmarks)
    except OSError as error:
        raise StorageError(f"cannot write {path}: {error.strerror}") from error
