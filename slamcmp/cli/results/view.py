"""``slamcmp view``."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slamcmp.cli import completion
from slamcmp.cli.output import answer, is_quiet
from slamcmp.errors import MissingDataError

if TYPE_CHECKING:
    from slamcmp.results.store import Results


def add_commands(app: typer.Typer) -> None:
    """Put this file's commands into the application."""
    app.command(epilog="Example: slamcmp view quickstart --back-end EKF --trial 0")(view)


def view(
    run: Annotated[
        str,
        typer.Argument(
            help="Results folder or name below results/, or a run's npz file.",
            autocompletion=completion.results_folders,
        ),
    ],
    back_end: Annotated[list[str] | None, typer.Option(help="Label, repeatable; default: all.")] = None,
    trial: Annotated[int | None, typer.Option(min=0, help="Default: the one with the median error.")] = None,
    output: Annotated[
        Path | None, typer.Option(help="The .rrd file; default: in the results folder's view/.")
    ] = None,
    no_open: Annotated[bool, typer.Option("--no-open", help="Write the file only.")] = False,
) -> None:
    """Replay a trial in Rerun: paths, ellipses, landmarks, measurements, images with features and matches.

    An .rrd file is written, and opened in Rerun's viewer where there is a screen. Needs the extra view.
    """
    from slamcmp.report.figures.drawable import typical_trial
    from slamcmp.report.replay import write_replay
    from slamcmp.results.store import find_results, load_results

    labels = back_end or None
    if run.endswith(".npz"):
        found, trial, label = _trial_of(Path(run))
        labels = labels or [label]
    else:
        found = load_results(find_results(run))
    trial = typical_trial(found) if trial is None else trial
    output = output or found.folder / "view" / f"trial-{trial}.rrd"
    shown = write_replay(found, output, trial=trial, back_ends=labels)
    answer(file=str(output), back_ends=shown)
    if not is_quiet():
        print(f"{output}: {', '.join(shown)}")
    if no_open:
        return
    if sys.platform.startswith("linux") and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        print(f"there is no screen here; elsewhere: rerun {output}", file=sys.stderr)
        return
    subprocess.Popen(
        [sys.executable, "-m", "rerun", str(output)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def _trial_of(path: Path) -> tuple[Results, int, str]:
    """The results that a run's file lies in, its trial and its label.

    Raises:
        MissingDataError: it is no run of theirs.
    """
    from slamcmp.results.runs.run_file import load_run
    from slamcmp.results.store import load_results

    stored = load_run(path)
    if stored is None:
        raise MissingDataError(f"{path}: no run that can be read")
    results = load_results(path.resolve().parent.parent)
    own = results.trials[results.trials["digest"] == stored.run.digest]
    own = own[own["label"] == stored.run.back_end]
    if own.empty:
        raise MissingDataError(f"{path}: {results.folder} has no trial of this run")
    return results, int(own["trial"].iloc[0]), stored.run.back_end
