"""The page of an experiment with images shows some of them, and what each stream made of its own."""

from __future__ import annotations

import base64
import io
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from PIL import Image

import slamcmp
from slamcmp.report.figures.frontend import images
from slamcmp.report.html import report_html
from slamcmp.results.store import Results, load_results


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Results:
    """Ten small images of a rendered drive, of which a third of the matches was made wrong."""
    folder = tmp_path_factory.mktemp("drive")
    file = folder / "drive.yaml"
    file.write_text(
        "question: What do the images show?\n"
        "source: {name: rendered, camera: stereo, steps: 10, width_px: 320, height_px: 240}\n"
        "front_end: {name: tracked_features, followed: 60, wrong_match_share: 0.3}\n"
        "back_ends: [{name: dead_reckoning}]\n"
        "seeds: 1\n"
        "figures: [images, time]\n"
    )
    return slamcmp.run(file, folder=folder / "results", jobs=1)


def changed(results: Results, **of_config: object) -> Results:
    manifest = {**results.manifest, "config": {**results.manifest["config"], **of_config}}
    return replace(results, manifest=manifest)


def test_the_page_shows_four_images_with_their_measurements(results: Results) -> None:
    page = report_html(results)
    figure = re.search(r'<figure id="figure-images">.*?</figure>', page, re.DOTALL)
    assert figure is not None
    sources = re.findall(r'src="data:image/jpeg;base64,([^"]+)"', figure[0])
    assert len(sources) == 4
    # Small in all, and wide enough to be read on a telephone.
    assert sum(map(len, sources)) < 600_000
    for source in sources:
        width, height = Image.open(io.BytesIO(base64.b64decode(source))).size
        assert width > 600
        assert height > 400


def test_what_is_drawn_is_what_the_stream_holds(results: Results) -> None:
    shown, _ = images._gathered(results)
    for each in shown:
        assert each.image.shape == (240, 320)
        assert len(each.pixels) == len(each.depth_m) == len(each.before) > 20
        assert np.isfinite(each.depth_m).all()
        assert ((each.depth_m > 0.3) & (each.depth_m < 20.0)).all()
        # A measured point is one of the corners that are drawn.
        distance = np.linalg.norm(each.pixels[:, None] - each.corners[None], axis=-1).min(axis=1)
        assert distance.max() < 1e-9
        moved = np.linalg.norm(each.before - each.pixels, axis=1)
        assert np.nanmedian(moved) < 15.0


def test_the_table_tells_precision_and_recall_of_each_stream(results: Results) -> None:
    table = images.stream_table(results)
    assert list(table["images"]) == [10]
    assert list(table["skipped"]) == ["none"]
    totals = results.manifest["front_end_totals"]
    right, passed = totals["right matches"], totals["matches that passed"]
    assert right <= 0.75 * totals["matches with known truth"]
    both = totals["right matches that passed"]
    assert table["precision [%]"][0] == pytest.approx(100.0 * both / passed)
    assert table["recall [%]"][0] == pytest.approx(100.0 * both / right)
    assert min(table["precision [%]"][0], table["recall [%]"][0]) > 90.0
    assert "precision [%]" in report_html(results)


def test_without_the_images_the_page_is_whole_and_says_so(results: Results) -> None:
    gone = changed(results, source={"name": "kitti_odometry", "folder": "not_there"})
    page = report_html(gone)
    assert 'id="figure-images"' not in page
    assert "Images (the images are not there any more: not_there: there is no such folder" in page
    assert 'id="figure-time"' in page
    # A source that delivers other images than it did is not shown either.
    other = {**results.manifest["config"]["source"], "steps": 12}
    assert "the source delivers other images than it did" in report_html(changed(results, source=other))


def test_an_experiment_without_images_says_why_there_are_none(results: Results) -> None:
    page = report_html(changed(results, front_end={"name": "labelled"}))
    assert "Images (the front end takes no images)" in page


def test_skipped_frames_are_in_the_table(results: Results, monkeypatch: pytest.MonkeyPatch) -> None:
    (digest,) = results.trials["digest"].unique()
    known = images.known_streams(results.folder)[digest]
    totals = {
        "raw": 900,
        "kept": 90,
        "frames: right image: truncated": 1,
        "frames: no epipolar test: plane": 3,
    }
    monkeypatch.setattr(
        images, "known_streams", lambda _: {digest: images.StoredTruth(digest, known.frames, None, totals)}
    )
    table = images.stream_table(results)
    expected = {"trial": 0, "images": 10, "skipped": "1: right image: truncated"}
    assert {name: table[name][0] for name in expected} == expected
    assert table["corners an image"][0] == 100.0
    assert isinstance(table, pd.DataFrame)
    assert "precision [%]" not in table


def test_stored_results_show_the_same(results: Results) -> None:
    assert report_html(load_results(results.folder)).count("data:image/jpeg") == 4
