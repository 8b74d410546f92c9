"""``slamcmp stream save|info|export``."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slamcmp.cli import completion
from slamcmp.cli.output import answer

if TYPE_CHECKING:
    from slamcmp.types import Log, MeasurementStream


class Format(StrEnum):
    """What a stream can be written as."""

    g2o = "g2o"


def add_commands(app: typer.Typer) -> None:
    """Put this file's commands into the application."""
    stream = typer.Typer(
        help="Store measurement streams, and look into stored ones.",
        epilog="Example: slamcmp stream info victoria_park.npz",
        no_args_is_help=True,
    )
    stream.command(epilog="Example: slamcmp stream save victoria_park victoria_park.npz")(save)
    stream.command(epilog="Example: slamcmp stream info victoria_park.npz")(info)
    stream.command(epilog="Example: slamcmp stream export victoria_park park.g2o")(export)
    app.add_typer(stream, name="stream")


def save(
    config: Annotated[
        str,
        typer.Argument(
            help="Experiment file, or the name of a shipped experiment.",
            autocompletion=completion.experiments,
        ),
    ],
    out: Annotated[Path, typer.Argument(help="The npz file to write.")],
    trial: Annotated[int, typer.Option(min=0, help="Which trial's stream.")] = 0,
) -> None:
    """Make the stream that every back end of a trial gets, and store it."""
    from slamcmp.frontend.stream_file import save_stream

    stream, _ = trial_stream(config, trial)
    save_stream(stream, out)
    answer(file=str(out), frames=len(stream.frames), digest=stream.digest)
    print(f"{out}: {len(stream.frames)} frames, digest {stream.digest}")


def export(
    stream: Annotated[
        str, typer.Argument(help="Stored stream (.npz), experiment file, or shipped experiment.")
    ],
    out: Annotated[Path, typer.Argument(help="The file to write.")],
    format: Annotated[
        Format, typer.Option(help="g2o text, with landmarks, bearing-range edges and loop closures.")
    ] = Format.g2o,
    trial: Annotated[int, typer.Option(min=0, help="Which trial's stream, of an experiment.")] = 0,
) -> None:
    """Write a stream as text that other programs read; the source graph_file reads it back."""
    from slamcmp.datasets.graphs.g2o_writer import write_g2o
    from slamcmp.errors import StorageError
    from slamcmp.frontend.stream_file import load_stream

    log = None
    if stream.endswith(".npz"):
        measured = load_stream(Path(stream))
    else:
        measured, log = trial_stream(stream, trial)
    try:
        write_g2o(out, measured, own_ids=None if log is None else log.own_ids)
    except OSError as error:
        raise StorageError(f"cannot write {out}: {error.strerror}") from error
    seen = sum(frame.ids.size for frame in measured.frames)
    answer(file=str(out), format=format.value, poses=len(measured.frames), observations=seen)
    print(f"{out}: {len(measured.frames)} poses, {seen} observations ({format.value})")


def trial_stream(config: str, trial: int) -> tuple[MeasurementStream, Log]:
    """The stream of an experiment's trial, and its log.

    Raises:
        UsageError: there is no such trial.
    """
    from slamcmp.errors import UsageError
    from slamcmp.experiment.config.experiment import load_experiment
    from slamcmp.experiment.config.shipped import find_experiment
    from slamcmp.experiment.job.make_stream import make_stream
    from slamcmp.experiment.planning.trials import make_trials

    trials = make_trials(load_experiment(find_experiment(config)))
    if trial >= len(trials):
        raise UsageError(f"--trial {trial}: the experiment has trials 0 to {len(trials) - 1}")
    job = trials[trial].stream
    choices = [(choice.spec, choice.arguments()) for choice in (job.source, job.front_end)]
    return make_stream(choices[0], choices[1], job.seed)


def info(file: Annotated[Path, typer.Argument(help="A stored stream.")]) -> None:
    """Show what a stored stream holds; its content is checked against its digest."""
    import numpy as np

    from slamcmp.frontend.stream_file import load_stream

    stream = load_stream(file)
    frames, sensor = stream.frames, stream.problem.sensor
    ids = np.concatenate([frame.ids for frame in frames])
    parameters = ", ".join(f"{name}={value}" for name, value in sensor.parameters().items())
    answer(
        digest=stream.digest,
        sensor={"name": sensor.name, **sensor.parameters()},
        frames=len(frames),
        begin_s=frames[0].t,
        end_s=frames[-1].t,
        observations=int(ids.size),
        landmarks=int(np.unique(ids).size),
        front_end={} if stream.report is None else dict(stream.report.totals()),
    )
    print(f"digest       {stream.digest}")
    print(f"sensor       {sensor.name}{f' ({parameters})' if parameters else ''}")
    print(f"frames       {len(frames)}, {frames[0].t:g} s to {frames[-1].t:g} s")
    print(f"observations {ids.size} of {np.unique(ids).size} landmarks")
    if stream.report is not None:
        totals = ", ".join(f"{name} {count}" for name, count in stream.report.totals().items())
        print(f"front end    {totals}")
