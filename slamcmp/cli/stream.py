"""``slamcmp stream save|info``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def add_commands(app: typer.Typer) -> None:
    """Put this file's commands into the application."""
    stream = typer.Typer(
        help="Store measurement streams, and look into stored ones.",
        epilog="Example: slamcmp stream info victoria_park.npz",
        no_args_is_help=True,
    )
    stream.command(epilog="Example: slamcmp stream save victoria_park victoria_park.npz")(save)
    stream.command(epilog="Example: slamcmp stream info victoria_park.npz")(info)
    app.add_typer(stream, name="stream")


def save(
    config: Annotated[str, typer.Argument(help="Experiment file, or the name of a shipped experiment.")],
    out: Annotated[Path, typer.Argument(help="The npz file to write.")],
    trial: Annotated[int, typer.Option(min=0, help="Which trial's stream.")] = 0,
) -> None:
    """Make the stream that every back end of a trial gets, and store it."""
    from slamcmp.errors import UsageError
    from slamcmp.experiment.config.experiment import load_experiment
    from slamcmp.experiment.config.shipped import find_experiment
    from slamcmp.experiment.job.make_stream import make_stream
    from slamcmp.experiment.trials import make_trials
    from slamcmp.frontend.stream_file import save_stream

    trials = make_trials(load_experiment(find_experiment(config)))
    if trial >= len(trials):
        raise UsageError(f"--trial {trial}: the experiment has trials 0 to {len(trials) - 1}")
    job = trials[trial].stream
    choices = [(choice.spec, choice.arguments()) for choice in (job.source, job.front_end)]
    stream, _ = make_stream(choices[0], choices[1], job.seed)
    save_stream(stream, out)
    print(f"{out}: {len(stream.frames)} frames, digest {stream.digest}")


def info(file: Annotated[Path, typer.Argument(help="A stored stream.")]) -> None:
    """Show what a stored stream holds; its content is checked against its digest."""
    import numpy as np

    from slamcmp.frontend.stream_file import load_stream

    stream = load_stream(file)
    frames, sensor = stream.frames, stream.problem.sensor
    ids = np.concatenate([frame.ids for frame in frames])
    parameters = ", ".join(f"{name}={value}" for name, value in sensor.parameters().items())
    print(f"digest       {stream.digest}")
    print(f"sensor       {sensor.name}{f' ({parameters})' if parameters else ''}")
    print(f"frames       {len(frames)}, {frames[0].t:g} s to {frames[-1].t:g} s")
    print(f"observations {ids.size} of {np.unique(ids).size} landmarks")
    if stream.report is not None:
        totals = ", ".join(f"{name} {count}" for name, count in stream.report.totals().items())
        print(f"front end    {totals}")
