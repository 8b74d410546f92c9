"""Every figure draws a run, or says plainly why it cannot."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from matplotlib.figure import Figure

import slamcmp
from slamcmp.registry import figures
from slamcmp.report.figures.draw import each_figure
from slamcmp.results.runs.of_runs import results_of_runs

CANNOT = {
    "association": "no back end gates for itself",
    "attribution": "was not run",
    "dial": "no sliding_window was run with two windows",
    "images": "the results do not tell source and front end",
    "harris_corners": "the results do not tell source and front end",
    "after_suppression": "the results do not tell source and front end",
    "matches": "the results do not tell source and front end",
    "ransac": "the results do not tell source and front end",
    "regimes": "a map needs two or three swept parameters, and none was",
    "honesty": "a map needs two or three swept parameters, and none was",
    "gain": "a map needs two or three swept parameters, and none was",
    "sparsity": "the stream is not there any more",
    "decisions": "no stream of a front end without labels",
    "frontier": "a map needs two or three swept parameters, and none was",
    "kl_from_batch": "no run was compared",
    "observability": "no run recorded it",
    "sweep": "nothing was swept",
}
"""What one run cannot show, and the words that say so."""


@pytest.fixture(scope="module")
def stream() -> slamcmp.SourceStream:
    return slamcmp.make_stream("circle", 2, landmarks=8, steps=30)


@pytest.fixture(scope="module")
def run(stream: slamcmp.SourceStream) -> slamcmp.Run:
    return slamcmp.run_back_end("isam2", stream)


@pytest.mark.parametrize("name", figures.names())
def test_every_figure_draws_a_run_or_says_why_not(
    name: str, run: slamcmp.Run, stream: slamcmp.SourceStream
) -> None:
    if name in CANNOT:
        with pytest.raises(slamcmp.UsageError) as error:
            slamcmp.plot(run, figure=name, truth=stream)
        assert str(error.value).startswith(f"figure {name!r} cannot be drawn: ")
        assert CANNOT[name] in str(error.value)
        assert "drawing it failed" not in str(error.value)
    else:
        drawn = slamcmp.plot(run, figure=name, truth=stream)
        assert isinstance(drawn, Figure)
        assert drawn.get_axes()


def test_a_run_without_truth_is_told_how_to_get_one(run: slamcmp.Run, stream: slamcmp.SourceStream) -> None:
    with pytest.raises(slamcmp.UsageError, match=r"plot\(run, 'errors', truth=stream\)"):
        slamcmp.plot(run, figure="errors")
    assert isinstance(slamcmp.plot(run), Figure)


def test_a_failed_run_is_drawn_or_told(run: slamcmp.Run, stream: slamcmp.SourceStream) -> None:
    empty = replace(
        run,
        status="crashed",
        message="frame 0: on purpose",
        online=slamcmp.Trajectory(run.online.t[:0], run.online.T_world_body[:0], run.online.P[:0]),
        final=None,
        landmarks=None,
        update_s=run.update_s[:0],
        estimate_s=run.estimate_s[:0],
        diagnostics={},
    )
    results = results_of_runs([empty], stream.truth)
    drawn = list(each_figure(results))
    assert [each.name for each in drawn if each.reason.startswith("drawing it failed")] == []
    assert all(each.figure is not None or each.reason for each in drawn)


def test_several_runs_of_one_stream_stand_side_by_side(
    run: slamcmp.Run, stream: slamcmp.SourceStream
) -> None:
    other = slamcmp.run_back_end("ekf_slam", stream)
    figure = slamcmp.plot([run, other], "errors", truth=stream.truth)
    assert [axes.get_title(loc="left") for axes in figure.get_axes()[:2]] == ["isam2", "ekf_slam"]
    with pytest.raises(slamcmp.UsageError, match="two runs are called 'isam2'"):
        slamcmp.plot([run, run])
    elsewhere = slamcmp.run_back_end("ekf_slam", slamcmp.make_stream("circle", 3, landmarks=8, steps=30))
    with pytest.raises(slamcmp.UsageError, match="different streams"):
        slamcmp.plot([run, elsewhere])
    with pytest.raises(slamcmp.UsageError, match="no run is given"):
        slamcmp.plot([])


def test_the_figure_shows_itself_in_a_notebook(run: slamcmp.Run) -> None:
    png, size = slamcmp.plot(run)._repr_png_()
    assert png.startswith(b"\x89PNG")
    width = int.from_bytes(png[16:20], "big")
    assert abs(width - 2 * size["width"]) <= 2


def test_the_results_of_an_experiment_are_drawn_too(here: Path) -> None:
    results = slamcmp.run(
        {"source": {"name": "circle", "landmarks": 5, "steps": 10}, "back_ends": ["ekf_slam"]},
        executor="serial",
        progress=False,
    )
    assert isinstance(slamcmp.plot(results, "consistency"), Figure)
    with pytest.raises(slamcmp.UsageError, match="unknown figure 'mpa'; did you mean 'map'"):
        slamcmp.plot(results, "mpa")
    with pytest.raises(slamcmp.UsageError, match="truth= is for runs"):
        slamcmp.plot(results, truth=slamcmp.make_stream("circle", steps=3, landmarks=3))
