"""``slamcmp noise fit``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from slamcmp.errors import UsageError

if TYPE_CHECKING:
    from slamcmp.metrics.noise_fit import Fit

TRANSLATION, TURN = ("along_sigma_m_sqrt_s", "across_sigma_m_sqrt_s"), "turn_sigma_rad_sqrt_s"
SENSORS: dict[tuple[str, str], dict[str, tuple[tuple[str, ...], tuple[int, ...]]]] = {
    ("recording", "range_bearing"): {
        "range": (("range_sigma_m",), (0,)),
        "bearing": (("bearing_sigma_rad",), (1,)),
    },
    ("recording", "range_only"): {"range": (("range_sigma_m",), (0,))},
    ("recording", "bearing_only"): {"bearing": (("bearing_sigma_rad",), (0,))},
    ("recording", "relative_position"): {"position": (("position_sigma_m",), (0, 1))},
    ("plaza", "range_only"): {"range": (("range_sigma_m",), (0,))},
    ("mrclam", "range_bearing"): {
        "range": (("range_sigma_m", "range_sigma_per_m"), (0,)),
        "bearing": (("bearing_sigma_deg",), (1,)),
    },
}
"""Of each source and sensor the noises: the source's parameters, and which entries of z have them."""


def add_commands(app: typer.Typer) -> None:
    """Put this file's command into the application."""
    noise = typer.Typer(
        help="Noise of a log, from what a filter is surprised by.",
        epilog="Example: slamcmp noise fit mine.yaml",
        no_args_is_help=True,
    )
    noise.callback()(lambda: None)
    noise.command(
        epilog="Examples: slamcmp noise fit mine.yaml; slamcmp noise fit odometry.csv detections.csv "
        "--set range_sigma_m=0.1 --set bearing_sigma_rad=0.02"
    )(fit)
    app.add_typer(noise, name="noise")


def fit(
    log: Annotated[
        list[str],
        typer.Argument(
            help="An experiment (source recording, mrclam or plaza), or odometry and detections of one log."
        ),
    ],
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="NAME=VALUE", help="A parameter of the source, such as range_sigma_m=0.05."
        ),
    ] = None,
) -> None:
    """Fit the noise of odometry and sensor to an EKF's innovations; never to the truth.

    Prints YAML to paste into the experiment's source. Known landmarks are needed, and few outliers.
    """
    import numpy as np

    from slamcmp.frontend.delayed_start import delayed_start
    from slamcmp.frontend.labelled import labelled
    from slamcmp.metrics.noise_fit import fit_noise
    from slamcmp.registry import sources

    source, parameters = _source(log, settings or [])
    plugin = sources.get(source)
    stated = {**{key: p.default for key, p in plugin.parameters().items()}, **parameters}
    made = plugin.target(0, **parameters)
    # Q is linear in the variances: what is left with hardly any turn is the translation's share.
    translation = plugin.target(0, **{**parameters, TURN: 1e-9 * stated[TURN]}).Q
    noises = SENSORS[source, made.problem.sensor.name]
    places = made.problem.sensor.name not in ("range_only", "bearing_only")
    stream = labelled(made, 0, gate_probability=None) if places else delayed_start(made, 0)
    unset = [key for keys, _ in noises.values() for key in keys if stated[key] is None]
    if unset:
        raise UsageError(
            f"noise fit: {unset[0]} is what is fitted; set it (columns of sigmas are taken as they are)"
        )
    if np.array_equal(translation, made.Q):
        raise UsageError(
            "noise fit: the increments have covariances of their own (cov_…), which no parameter sets"
        )
    found = fit_noise(
        stream,
        [("translation", translation), ("turn", made.Q - translation)],
        [(name, which) for name, (_, which) in noises.items()],
    )
    keys = [TRANSLATION, (TURN,), *(keys for keys, _ in noises.values())]
    _print(found, keys, stated, Path(log[0]).name)


def _print(found: Fit, keys: list[tuple[str, ...]], stated: dict[str, Any], log: str) -> None:
    print(f"# Fitted to innovations of {found.frames} frames; likelihood e^{found.gained:.1f} × the stated")
    values: dict[str, float] = {}
    for k, (name, group) in enumerate(zip(found.names, keys, strict=True)):
        interval = f"{found.factors[k]:.3g} × stated, 95 % {found.lower[k]:.3g} to {found.upper[k]:.3g}"
        if found.is_identifiable(k):
            print(f"# {name}: {interval}")
            values |= {key: float(stated[key]) * float(found.factors[k]) for key in group}
        else:
            print(f"# {name}: not identifiable from this log ({interval}); the stated value stays")
            values |= {key: float(stated[key]) for key in group}
    for key, value in values.items():
        print(f"{key}: {value:.4g}")
    print(f'noise: "fitted from {log}"')


def _source(log: list[str], settings: list[str]) -> tuple[str, dict[str, Any]]:
    """Name and parameters of the source, without anything that is true.

    Raises:
        UsageError: a source whose noise is not known by name here.
    """
    from slamcmp.cli.data.data_convert import TABLES, checked_parameters

    if {Path(name).suffix for name in log} <= set(TABLES):
        from slamcmp.datasets.plain.plain_roles import files_by_role

        # Files that say that they are true are not even opened.
        measured = [Path(name) for name in log if not _says_true(name)]
        files = files_by_role(measured)
        if "odometry" not in files or "detections" not in files:
            raise UsageError(f"noise fit: {', '.join(log)}: needs odometry and detections")
        # What another kind of name hides is left out all the same.
        source = "recording"
        given: dict[str, Any] = {
            "odometry": str(files["odometry"]),
            "detections": str(files["detections"]),
        }
    else:
        from slamcmp.experiment.config.experiment import load_experiment
        from slamcmp.experiment.config.shipped import find_experiment

        if len(log) > 1:
            raise UsageError(f"noise fit: {', '.join(log)}: one experiment, or the files of one log")
        component = load_experiment(find_experiment(log[0])).source
        source, given = component.name, dict(component.arguments())
    if source not in ("recording", "mrclam", "plaza"):
        raise UsageError(
            f"noise fit: of source {source} no parameter sets the noise; recording and mrclam have some, "
            "plaza too"
        )
    for key in ("truth", "landmarks", "truth_offset_s", "truth_max_gap_s"):
        given.pop(key, None)
    if given.get("start_pose") is None:
        given["start"] = "origin"
    given.pop("noise", None)
    return source, checked_parameters(source, given, settings)


def _says_true(name: str) -> bool:
    from slamcmp.datasets.plain.plain_roles import TRUTH_NAMES

    return any(part in Path(name).stem.lower() for part in (*TRUTH_NAMES, "landmark"))
