"""Noise fitted to innovations: against the noise that was drawn, and blind to the truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from slamcmp import geometry as g
from slamcmp.cli import app
from slamcmp.datasets.plain.plain_recording import recording
from slamcmp.errors import DataError, UsageError
from slamcmp.frontend.labelled import labelled
from slamcmp.metrics.noise_fit import fit_noise
from slamcmp.models.sensors import make_sensor
from slamcmp.types import Detections, FloatArray, Log, MeasurementStream, Problem
from tests.datasets.plain_drive import Drive

TRUE = np.array([2.0, 0.5, 0.4, 3.0])
"""Sigmas that are drawn, over those that are stated: translation, turn, range, bearing."""
COMPONENTS = [("range", (0,)), ("bearing", (1,))]


def driven(
    seed: int, *, frames: int = 120, true: FloatArray = TRUE
) -> tuple[MeasurementStream, list[tuple[str, FloatArray]]]:
    """A circle among landmarks, its noise ``true`` times what the log states."""
    rng = np.random.default_rng(seed)
    stated = np.array([0.02, 0.01, 0.02])
    z_stated = np.array([0.1, 0.01])
    sensor = make_sensor("range_bearing", {})
    places = rng.uniform((-6, -3), (6, 9), (12, 2))
    T = np.eye(3)
    step = g.exp([0.3, 0.0, 0.1])
    steps, seen = [np.eye(3)], []
    for k in range(frames):
        if k:
            noise = rng.standard_normal(3) * stated * true[[0, 0, 1]]
            T = T @ step @ g.exp(noise)
            steps.append(step)
        z = sensor.predict(T, places)
        ids = np.flatnonzero((z[:, 0] > 0.7) & (z[:, 0] < 5.0))
        noisy = z[ids] + rng.standard_normal((ids.size, 2)) * z_stated * true[2:]
        seen.append(Detections(noisy, np.tile(np.diag(z_stated**2), (ids.size, 1, 1)), ids))
    parts = [np.tile(np.diag(np.square(stated * on)), (frames, 1, 1)) for on in ([1, 1, 0], [0, 0, 1])]
    for part in parts:
        part[0] = 0
    log = Log(
        "circle",
        Problem(np.eye(3), 1e-8 * np.eye(3), sensor),
        np.arange(frames, dtype=float),
        np.array(steps),
        parts[0] + parts[1],
        tuple(seen),
    )
    named = [("translation", parts[0]), ("turn", parts[1])]
    return labelled(log, 0, gate_probability=None), named


@pytest.mark.parametrize("seeds", [range(2), pytest.param(range(100, 160), marks=pytest.mark.slow)])
def test_known_noise_is_within_the_intervals(seeds):
    inside, errors = [], []
    for seed in seeds:
        stream, parts = driven(seed, frames=80)
        fit = fit_noise(stream, parts, COMPONENTS)
        assert fit.names == ("translation", "turn", "range", "bearing")
        assert all(fit.is_identifiable(k) for k in range(4))
        inside.append((fit.lower <= TRUE) & (fit.upper >= TRUE))
        errors.append(np.log(fit.factors / TRUE) / (np.log(fit.upper / fit.lower) / 2 / 1.96))
    # Of n intervals that hold with 0.95 no more fail than chance lets in one of a thousand.
    from scipy.stats import binom

    failed = int(np.size(inside) - np.sum(inside))
    assert failed <= binom.isf(0.001, np.size(inside), 0.05)
    if len(errors) > 20:
        assert np.abs(np.mean(errors, axis=0)).max() < 4 / np.sqrt(len(errors))


def test_at_the_optimum_no_other_factor_is_likelier():
    """The maximum itself, by a second way: a coarse search around it."""
    from slamcmp.metrics.noise_fit import _Likelihood

    stream, parts = driven(0, frames=60)
    fit = fit_noise(stream, parts, COMPONENTS)
    likelihood = _Likelihood(stream, [Q for _, Q in parts], [which for _, which in COMPONENTS])
    best = likelihood(np.log(fit.factors)).sum()
    for k in range(4):
        for change in (-0.05, 0.05):
            x = np.log(fit.factors)
            x[k] += change
            assert likelihood(x).sum() < best
    assert fit.gained == pytest.approx(best - likelihood(np.zeros(4)).sum())


def test_what_a_log_does_not_say_is_told():
    short, parts = driven(1, frames=6)
    with pytest.raises(DataError, match="frames see a landmark again; at least 20 are needed"):
        fit_noise(short, parts, COMPONENTS)


SETTINGS = {"range_sigma_m": 0.1, "bearing_sigma_rad": 0.005}


def yaml_of(files: dict[str, Path]) -> str:
    lines = [f"  {name}: {path.name}" for name, path in files.items()]
    lines += [f"  {name}: {value}" for name, value in SETTINGS.items()]
    return "source:\n  name: recording\n" + "\n".join(lines) + "\nback_ends: [{name: ekf_slam}]\n"


def test_the_command_never_opens_the_truth_and_its_yaml_can_be_pasted(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    files = Drive(seconds=12).write(tmp_path)
    (tmp_path / "mine.yaml").write_text(yaml_of(files))
    app(["noise", "fit", "mine.yaml"], standalone_mode=False)
    told = capsys.readouterr().out
    values = dict(line.split(": ", 1) for line in told.splitlines() if not line.startswith("#"))
    # Drawn with 5 cm and 10 mrad.
    assert float(values["range_sigma_m"]) == pytest.approx(0.05, rel=0.15)
    assert float(values["bearing_sigma_rad"]) == pytest.approx(0.01, rel=0.15)
    assert values["noise"] == '"fitted from mine.yaml"'
    # Altered, removed: the equal answer; as plain files as well.
    files["truth"].write_text("rubbish")
    files["landmarks"].unlink()
    app(["noise", "fit", "mine.yaml"], standalone_mode=False)
    assert capsys.readouterr().out == told
    names = ["odometry.csv", "detections.csv", "truth.csv"]
    app(["noise", "fit", *names, *(f"--set={k}={v}" for k, v in SETTINGS.items())], standalone_mode=False)
    assert capsys.readouterr().out.replace("odometry.csv", "mine.yaml") == told
    # Pasted, the results say where the noise comes from.
    log = recording(
        odometry="odometry.csv", detections="detections.csv", noise="fitted from mine.yaml", **SETTINGS
    )
    assert log.warnings == ("noise: fitted from mine.yaml",)


@pytest.mark.parametrize(
    ("sensor", "column", "stated", "drawn"),
    [
        ("range_only", "bearing_rad", "range_sigma_m=0.1", 0.05),
        ("bearing_only", "range_m", "bearing_sigma_rad=0.02", 0.01),
    ],
)
def test_the_noise_of_a_range_or_a_bearing_alone(
    tmp_path, monkeypatch, capsys, sensor, column, stated, drawn
):
    monkeypatch.chdir(tmp_path)
    files = Drive(seconds=40).write(tmp_path)
    titles, *rows = files["detections"].read_text().splitlines()
    kept = [k for k, title in enumerate(titles.split(",")) if title != column]
    lines = [",".join(row.split(",")[k] for k in kept) for row in (titles, *rows)]
    files["detections"].write_text("\n".join(lines) + "\n")
    words = ["odometry.csv", "detections.csv", f"--set=sensor={sensor}", f"--set={stated}"]
    app(["noise", "fit", *words], standalone_mode=False)
    told = capsys.readouterr().out.splitlines()
    values = dict(line.split(": ", 1) for line in told if not line.startswith("#"))
    assert float(values[stated.split("=")[0]]) == pytest.approx(drawn, rel=0.15)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["quickstart"], "no parameter sets the noise; recording and mrclam have some"),
        (["detections.csv"], "needs odometry and detections"),
        (["odometry.csv", "detections.csv"], "range_sigma_m"),
        (
            ["odometry.csv", "detections.csv", "--set", "turn=1"],
            "did you mean 'turn_sigma_rad_sqrt_s'|NAME=VALUE",
        ),
    ],
)
def test_wrong_calls(tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    Drive(seconds=5).write(tmp_path)
    with pytest.raises((UsageError, DataError), match=message):
        app(["noise", "fit", *words], standalone_mode=False)
