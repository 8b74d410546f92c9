"""The interactive figures: thinned without losing a peak, readable in both themes, alive in a browser."""

from __future__ import annotations

import asyncio
import dataclasses
import json
import re
import shutil
import subprocess
import time

import numpy as np
import pandas as pd
import pytest
from tornado.httpclient import AsyncHTTPClient
from tornado.websocket import websocket_connect

import slamcmp
from slamcmp.geometry import se2
from slamcmp.report import write_report
from slamcmp.report.figures.drawable import typical_trial
from slamcmp.report.figures.runs.sparsity import (
    filled_pattern,
    marginal_pattern,
    minimum_degree,
    pattern,
    shared_measurements,
    shown_frames,
)
from slamcmp.report.html import report_html
from slamcmp.report.live import (
    DARK,
    LIGHT,
    kept_indices,
    live_captions,
    live_data,
    live_figures,
    pareto_front,
)
from slamcmp.report.live_sparsity import fill_steps

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
PAGE_LIMIT = 8_000_000


@pytest.mark.parametrize("size", [10, 1200, 1201, 7000, 50_000])
def test_thinning_keeps_every_peak_and_the_ends(size):
    rng = np.random.default_rng(size)
    values = rng.normal(size=size)
    peak, dip = (size // 3, 2 * size // 3)
    values[[peak, dip]] = 50.0, -50.0
    kept = kept_indices(values)
    assert {0, peak, dip, size - 1} <= set(kept)
    assert len(kept) <= min(size, 1200)
    assert (np.diff(kept) > 0).all()
    # In each stretch of the series the drawn extremes are the series' own.
    for stretch in np.array_split(np.arange(size), max(1, min(size, 1198) // 2)):
        drawn = values[np.intersect1d(kept, stretch)]
        assert (drawn.min(), drawn.max()) == (values[stretch].min(), values[stretch].max())


def test_thinning_passes_over_what_is_no_number():
    values = np.full(5000, np.nan)
    values[1234] = 7.0
    assert set(kept_indices(values)) == {0, 1234, 4999}


def luminance(colour: str) -> float:
    """Of sRGB, WCAG 2.2."""
    parts = np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)])
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


@pytest.mark.parametrize(("colours", "background"), [(LIGHT, "#ffffff"), (DARK, "#16181c")])
def test_every_colour_has_a_contrast_of_three(colours, background, one_trial):
    assert background in report_html(one_trial).replace("--back: #fff;", "--back: #ffffff;")
    for colour in colours:
        bright, dim = sorted((luminance(colour), luminance(background)), reverse=True)
        assert (bright + 0.05) / (dim + 0.05) >= 3.0, colour


def test_the_front_is_what_nobody_beats():
    points = pd.DataFrame(
        {"ms": [1.0, 2.0, 3.0, 4.0], "error_m": [0.5, 0.6, 0.2, 0.2]}, index=["a", "b", "c", "d"]
    )
    assert list(pareto_front(points).index) == ["a", "c"]


def test_data_holds_the_tables_numbers(swept):
    figures = live_figures(swept)
    # There is no stream: no sparsity.
    assert set(figures) == {"map", "errors", "consistency", "budget", "seeds"}
    for which, panel in zip(("online", "final"), figures["budget"]["panels"], strict=True):
        ok = swept.trials[(swept.trials["status"] == "ok") & (swept.trials["label"] == "isam2")]
        (medians,) = [t for t in panel["traces"] if t["name"] == "isam2" and "bars" in t]
        by_point = ok.groupby("source.range_sigma_m")[f"{which}_ate"].median()
        assert medians["y"] == pytest.approx(list(by_point), rel=1e-4)
    assert figures["seeds"]["order"] == ["ekf", "isam2", "batch"]
    assert "Pareto front at range sigma = 1 m nobody" in live_captions(figures, swept)["budget"]
    (online, final) = figures["seeds"]["panels"]
    here = swept.trials[(swept.trials["source.range_sigma_m"] == 1.0) & (swept.trials["status"] == "ok")]
    expected = here.pivot(index="trial", columns="label", values="online_ate")[online["labels"]]
    assert np.array(online["rows"]) == pytest.approx(expected.to_numpy(), rel=1e-4)
    assert final["labels"] == ["isam2", "batch"]


def test_a_clock_that_counts_from_1970_still_ticks(one_trial):
    late = dataclasses.replace(one_trial, frames=one_trial.frames.assign(t=one_trial.frames["t"] + 1.25e9))
    figures = live_figures(late)
    for times in (figures["map"]["runs"][0]["steps"]["t"], figures["errors"]["panels"][0]["traces"][0]["x"]):
        assert np.diff(times).min() > 0


def test_names_cannot_leave_the_script(one_trial):
    hostile = "</script><img src=x>"
    trials, frames = (
        table.replace({"label": {"ekf": hostile}}) for table in (one_trial.trials, one_trial.frames)
    )
    results = type(one_trial)(one_trial.folder, one_trial.manifest, trials, frames, one_trial.landmarks)
    text = live_data(results, {name: live_figures(results)[name] for name in ("map", "errors")})
    assert "<" not in text
    assert hostile in json.loads(text)["labels"]


def test_the_page_carries_plotly_once_and_allows_no_other_script(swept):
    text = report_html(swept)
    assert text.count("data:application/gzip;base64,") == 1
    assert len(text.encode()) < PAGE_LIMIT
    (policy,) = re.findall(r'Content-Security-Policy" content="([^"]+)"', text)
    assert policy.startswith("default-src 'none'")
    assert len(re.findall(r"'sha256-[A-Za-z0-9+/=]{44}'", policy)) == 2
    assert "unsafe" not in policy.split("script-src")[1]


async def browse(page, folder, steps, width, theme="light"):
    """Values of JavaScript expressions on the page, one after the other, and all that the console said.

    The width is that of a device: a browser's window is never as narrow as a phone.
    """
    browser = subprocess.Popen(
        [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-port=0",
         f"--user-data-dir={folder}", "about:blank"],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        port_file, end = folder / "DevToolsActivePort", time.monotonic() + 60
        while not port_file.exists() or not port_file.read_text():
            assert time.monotonic() < end, "the browser did not start"
            await asyncio.sleep(0.1)
        port = port_file.read_text().splitlines()[0]
        listing = await AsyncHTTPClient().fetch(f"http://127.0.0.1:{port}/json/list")
        (target,) = [each for each in json.loads(listing.body) if each["type"] == "page"]
        socket = await websocket_connect(target["webSocketDebuggerUrl"], max_message_size=2**26)
        said, number = [], 0

        async def ask(method, **parameters):
            nonlocal number
            number += 1
            await socket.write_message(json.dumps({"id": number, "method": method, "params": parameters}))
            while True:
                answer = json.loads(await asyncio.wait_for(socket.read_message(), 60))
                if answer.get("method") in (
                    "Runtime.exceptionThrown", "Log.entryAdded", "Runtime.consoleAPICalled",
                ):  # fmt: skip
                    said.append(answer["params"])
                if answer.get("id") == number:
                    return answer["result"]

        async def value(expression):
            found = await ask(
                "Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True
            )
            return found["result"].get("value")

        await ask("Runtime.enable")
        await ask("Log.enable")
        await ask(
            "Emulation.setDeviceMetricsOverride",
            width=width, height=900, deviceScaleFactor=1, mobile=width < 500,
        )  # fmt: skip
        scheme = {"name": "prefers-color-scheme", "value": theme}
        await ask("Emulation.setEmulatedMedia", features=[scheme])
        await ask("Page.navigate", url=page.as_uri())
        while await value("document.documentElement.dataset.live") != "ready":
            assert time.monotonic() < end, f"the figures are not there: {said}"
            await asyncio.sleep(0.1)
        return [await value(step) for step in steps], said
    finally:
        browser.kill()
        browser.wait()


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
def test_in_a_browser_the_slider_moves_and_the_console_is_silent(swept, tmp_path):
    page = write_report(swept, tmp_path / "report.html")
    now = "document.querySelector('[data-figure=map]').data.filter(t => t.name === 'now')[0].x[0]"
    slide = (
        "(async () => {const s = document.querySelector('.player input'); s.value = 10; "
        "s.dispatchEvent(new Event('input')); await new Promise(r => setTimeout(r, 300)); return s.value;})()"
    )
    steps = [
        "document.querySelectorAll('.live .main-svg').length > 5",
        now,
        slide,
        now,
        "document.documentElement.scrollWidth <= innerWidth",
        "getComputedStyle(document.querySelector('.alive .figure-box')).display",
    ]
    (drawn, last, moved, tenth, fits, twin), said = asyncio.run(
        browse(page, tmp_path / "profile", steps, 390)
    )
    assert said == []
    assert drawn
    assert moved == "10"
    frames = swept.frames[(swept.frames["label"] == "ekf")]
    assert tenth != last
    assert np.isclose(frames["online_x"], tenth, rtol=1e-4).any()
    assert fits
    assert twin == "none"


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """A small experiment that ran, with its streams."""
    return slamcmp.run(
        {
            "source": {"name": "circle", "landmarks": 8, "steps": 40},
            "back_ends": ["ekf_slam", "isam2"],
            "seeds": 2,
        },
        folder=tmp_path_factory.mktemp("driven"),
        executor="serial",
        progress=False,
    )


def test_the_map_has_what_was_measured_at_each_moment(driven):
    shown = live_figures(driven)["map"]
    for run in shown["runs"]:
        assert len(run["steps"]["sights"]) == len(run["steps"]["x"]) == 40
    trial = typical_trial(driven)
    stream = slamcmp.make_stream("circle", int(driven.trials["seed"][2 * trial]), landmarks=8, steps=40)
    for frame, (ahead, left) in zip(stream.frames, shown["runs"][0]["steps"]["sights"], strict=True):
        expected = stream.problem.sensor.invert(np.eye(3), frame.z) if len(frame.ids) else np.empty((0, 2))
        assert np.column_stack([ahead, left]).reshape(-1, 2) == pytest.approx(expected, rel=1e-3, abs=1e-3)


def test_without_streams_the_map_is_drawn_all_the_same(driven, tmp_path):
    moved = dataclasses.replace(driven, folder=tmp_path)
    assert "sights" not in live_figures(moved)["map"]["runs"][0]["steps"]


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
@pytest.mark.parametrize(("width", "theme"), [(390, "dark"), (1280, "light")])
def test_in_a_browser_measurements_follow_the_slider_on_phone_and_desktop(driven, tmp_path, width, theme):
    page = write_report(driven, tmp_path / "report.html")
    trace = "document.querySelector('[data-figure=map]').data.find(t => t.name === 'measured now')"
    matrices = "document.querySelector('[data-figure=sparsity]').data.slice(0, 3).map(t => t.z)"
    slide = (
        "(async () => {const s = document.querySelector('.player input'); s.value = 7; "
        "s.dispatchEvent(new Event('input')); await new Promise(r => setTimeout(r, 300));})()"
    )
    steps = [
        "innerWidth",
        slide,
        f"[{trace}.x, {trace}.y]",
        "document.documentElement.scrollWidth <= innerWidth",
        "getComputedStyle(document.body).backgroundColor",
        "[...document.querySelectorAll('.live, .player')]"
        ".every(e => e.getBoundingClientRect().right <= innerWidth)",
        "Math.min(...[...document.querySelectorAll('tbody tr > :first-child')].map(e => e.clientWidth))",
        "[...document.querySelectorAll('.live')].every(box => {const legend = box.querySelector('.legend');"
        " return !legend || [...box.querySelectorAll('[class*=xtitle]')].every(title =>"
        " title.getBoundingClientRect().bottom <= legend.getBoundingClientRect().top + 1);})",
        matrices,
        "(async () => {const s = document.querySelector('p[aria-label=eliminations] input'); s.value = 6; "
        "s.dispatchEvent(new Event('input')); await new Promise(r => setTimeout(r, 300));})()",
        matrices,
    ]
    (inner, _, (xs, ys), fits, back, inside, narrowest, apart, all_done, _, six), said = asyncio.run(
        browse(page, tmp_path / "profile", steps, width, theme)
    )
    assert said == []
    assert inner == width
    assert fits
    assert inside
    # A name is not broken letter by letter, and no legend lies on an axis' title.
    assert narrowest > 60
    assert apart
    assert (back == "rgb(255, 255, 255)") == (theme == "light")
    trial = typical_trial(driven)
    own = driven.frames[(driven.frames["trial"] == trial) & (driven.frames["label"] == "ekf_slam")]
    at = own[own["k"] == 7].iloc[0]
    stream = slamcmp.make_stream("circle", int(at["seed"]), landmarks=8, steps=40)
    pose = se2(at["online_x"], at["online_y"], at["online_heading_rad"])
    expected = stream.problem.sensor.invert(pose, stream.frames[7].z)
    # A ray each: from the robot to the point, and a gap.
    assert np.column_stack([xs[1::3], ys[1::3]]) == pytest.approx(expected, abs=5e-3)
    assert xs[2::3] == [None] * len(expected)
    typical = slamcmp.make_stream("circle", int(own["seed"].iloc[0]), landmarks=8, steps=40)
    count = shown_frames(typical)
    graph = shared_measurements(typical, count)
    order = minimum_degree(graph, last=count - 1)
    kept = [count - 1, *range(count, len(graph))]
    information, factor, left = map(np.array, all_done)
    assert (information == pattern(graph, range(len(graph)))).all()
    assert (factor == np.tril(filled_pattern(graph, order))).all()
    assert (left == marginal_pattern(graph, kept)).all()
    early = [(i, j) for i, j, step in fill_steps(graph, order) if step <= 6]
    assert (np.array(six[1]) == 2).sum() == len(early) < (factor == 2).sum()
