"""``slamcmp frontend``: its files, its table, and what it says about images that cannot be matched."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from slamcmp.cli import app
from slamcmp.errors import DataError, MissingDataError, UsageError
from slamcmp.frontend.vision.geometry.degeneracy import Geometry
from slamcmp.frontend.vision.image_pair import extract_features, match_features
from slamcmp.frontend.vision.pyramid import extract_pyramid
from slamcmp.report.figures.frontend.front_end import SAYING, draw_front_end, front_end_tables
from tests.frontend.photographs import FOLDER, photograph


def _run(*arguments: object) -> str:
    result = CliRunner().invoke(app, ["frontend", *map(str, arguments)])
    if result.exception is not None:
        raise result.exception
    return result.output


def test_three_figures_and_a_table_of_counts(tmp_path: Path) -> None:
    paths = [FOLDER / f"BalbianelloMedium-{number}.jpg" for number in (1, 2)]
    printed = _run(*paths, "--output", tmp_path / "figures")
    for name in ("harris_corners", "after_suppression", "matches"):
        assert str(tmp_path / "figures" / f"{name}.png") in printed
        picture = cv2.imread(str(tmp_path / "figures" / f"{name}.png"))
        assert picture.shape[0] > 400
        assert picture.shape[1] > 1000
    pair = match_features(extract_pyramid(photograph(1)), extract_pyramid(photograph(2)), seed=0)
    row = next(line for line in printed.splitlines() if "epipolar" in line)
    counts = ("tried", "not_mutual", "ambiguous", "matches", "rejected", "kept")
    assert row.split()[3:9] == [str(pair.counts[name]) for name in counts]


def test_every_corner_is_drawn_and_counted(tmp_path: Path) -> None:
    features = [extract_features(photograph(1))]
    files = draw_front_end(["one"], [photograph(1)], features, [], tmp_path, formats=("svg",))
    # One image has no matches to draw.
    assert [file.name for file in files] == ["harris_corners.svg", "after_suppression.svg"]
    markers = [len(re.findall(r'href="#m[0-9a-f]+"', file.read_text())) for file in files]
    assert markers == [3000, 500]
    per_image, per_pair = front_end_tables(["one"], features, [])
    assert per_image.loc[0, "features"] == 500
    assert per_image.loc[0, "found"] == features[0].corners.found
    assert per_pair.empty


def test_a_black_image_is_named_not_matched(tmp_path: Path) -> None:
    black = tmp_path / "black.png"
    cv2.imwrite(str(black), np.zeros((427, 640), dtype=np.uint8))
    printed = _run(FOLDER / "BalbianelloMedium-1.jpg", black, "--output", tmp_path / "figures")
    assert "too_few" in printed
    assert (tmp_path / "figures" / "matches.png").is_file()


def test_errors_name_the_file_or_the_option(tmp_path: Path) -> None:
    photo = FOLDER / "BalbianelloMedium-1.jpg"
    with pytest.raises(MissingDataError, match=r"absent\.jpg"):
        _run(photo, tmp_path / "absent.jpg")
    text = tmp_path / "text.jpg"
    text.write_text("no picture")
    with pytest.raises(DataError, match=r"text\.jpg"):
        _run(text)
    with pytest.raises(UsageError, match="magsac, ransac or least_squares"):
        _run(photo, FOLDER / "BalbianelloMedium-2.jpg", "--method", "lmeds")
    with pytest.raises(UsageError, match="cells, brown or none"):
        _run(photo, "--suppression", "grid")


def test_every_geometry_of_two_views_is_explained() -> None:
    assert SAYING.keys() == set(Geometry)


def test_an_image_without_room_for_a_corner_is_refused(tmp_path: Path) -> None:
    small = tmp_path / "small.png"
    cv2.imwrite(str(small), photograph(1)[:30, :44])
    with pytest.raises(DataError, match=r"small\.png: 44×30 pixels where at least 47 a side are needed"):
        _run(FOLDER / "BalbianelloMedium-1.jpg", small, "--output", tmp_path / "figures")
