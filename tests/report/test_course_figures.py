"""The lecture's figures: each shows its stage, and RANSAC's what least squares does to right matches."""

from __future__ import annotations

import numpy as np
import pytest

import slamcmp
from slamcmp.errors import UsageError
from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.experiment.config.shipped import shipped_experiments
from slamcmp.frontend.vision.geometry.fundamental import SAMPLE
from slamcmp.report.figures.draw import each_figure
from slamcmp.report.figures.frontend import course
from slamcmp.report.figures.frontend.course import contaminated, exchanged
from slamcmp.results.store import Results
from slamcmp.types import FloatArray

COURSE = ("harris_corners", "after_suppression", "matches", "ransac")
LECTURE = {name: path for name, path in shipped_experiments().items() if name.startswith("lecture/")}


def two_views(count: int) -> tuple[FloatArray, FloatArray]:
    """Exact pixels (count, 2) of points in space, in two cameras half a metre apart."""
    generator = np.random.default_rng(0)
    points = np.column_stack([generator.uniform(-2, 2, (count, 2)), generator.uniform(3, 8, count)])
    first = 500 * points[:, :2] / points[:, 2:] + [320, 240]
    aside = points - [0.5, 0.1, 0.2]
    return first, 500 * aside[:, :2] / aside[:, 2:] + [320, 240]


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Results:
    """Seven small images of a rendered drive."""
    return slamcmp.run(
        {
            "name": "drive",
            "source": {"name": "rendered", "camera": "mono", "steps": 7, "width_px": 320, "height_px": 240},
            "front_end": {"name": "tracked_features", "followed": 60},
            "back_ends": [{"name": "dead_reckoning"}],
            "figures": list(COURSE),
        },
        folder=tmp_path_factory.mktemp("drive") / "results",
        jobs=1,
    )


@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 1.0])
def test_so_many_matches_are_made_wrong_and_no_more(share: float) -> None:
    partner = exchanged(50, share, np.random.default_rng(1))
    assert sorted(partner) == list(range(50))
    wrong = int((partner != np.arange(50)).sum())
    # One alone has nobody to exchange with.
    assert wrong == (0 if share == 0.02 else round(50 * share))


def test_least_squares_bends_and_ransac_does_not() -> None:
    first, second = two_views(120)
    bent, kept_bent = contaminated(first, second, "least_squares", (0.0, 0.1, 0.3), 3)
    straight, kept_straight = contaminated(first, second, "ransac", (0.0, 0.1, 0.3), 3)
    assert bent.shape == kept_bent.shape == (3, 3)
    # Without a wrong match both fit exact pixels; with some the one is off by pixels, the other by nothing.
    assert max(bent[0].max(), straight[0].max()) < 1e-6
    assert np.median(bent[1:], axis=1).min() > 1.0
    assert np.median(straight[1:], axis=1).max() < 1e-3
    assert (np.median(kept_straight[1:], axis=1) == 1.0).all()
    assert np.median(kept_bent[1:], axis=1).max() < 0.7
    assert SAMPLE == 8  # What the figure's caption says.


def test_each_figure_is_drawn_where_it_is_named_and_nowhere_else(
    results: Results, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(course, "contaminated", lambda *of: contaminated(*of, shares=(0.0, 0.2), draws=1))
    monkeypatch.setattr(course, "WRONG_SHARES", (0.0, 0.2))
    named = {drawn.name: drawn for drawn in each_figure(results, COURSE)}
    assert [drawn.reason for drawn in named.values()] == [""] * 4
    titles = [axes.get_title(loc="left") for axes in named["harris_corners"].figure.axes]  # type: ignore[union-attr]
    fewer = [axes.get_title(loc="left") for axes in named["after_suppression"].figure.axes]  # type: ignore[union-attr]
    assert all("strongest" in title for title in titles)
    assert all("spread" in title for title in fewer)
    assert not {drawn.name for drawn in each_figure(results)} & set(COURSE)


def test_without_images_the_reason_is_told(tmp_path: object) -> None:
    planar = slamcmp.run(
        {"source": {"name": "circle", "steps": 5}, "back_ends": [{"name": "dead_reckoning"}]},
        folder=f"{tmp_path}/results",
        jobs=1,
    )
    assert [drawn.reason for drawn in each_figure(planar, COURSE)] == ["the front end takes no images"] * 4
    with pytest.raises(UsageError, match="takes no images"):
        slamcmp.plot(planar, figure="ransac")


def test_the_lecture_has_a_file_for_each_problem_and_figure() -> None:
    names = sorted(name.removeprefix("lecture/") for name in LECTURE)
    assert [name.rsplit("_")[0] + name.split("_")[1] for name in names] == [
        *(f"figure{number}" for number in "123"),
        *(f"problem{number}" for number in "123456"),
    ]


@pytest.mark.parametrize("name", sorted(LECTURE))
def test_each_of_them_asks_and_says_what_to_look_at(name: str) -> None:
    experiment = load_experiment(LECTURE[name])
    assert experiment.question.endswith("?")
    assert "Ask: " in experiment.description
    assert "What to look at: " in experiment.description
    assert experiment.figures


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(LECTURE))
def test_each_of_them_runs_and_draws_its_figures(name: str, tmp_path: object) -> None:
    results = slamcmp.run(LECTURE[name], folder=f"{tmp_path}/results", jobs=2)
    assert (results.trials["status"] == "ok").all()
    assert [drawn.reason for drawn in each_figure(results, results.manifest["config"]["figures"])] == [
        ""
    ] * len(results.manifest["config"]["figures"])
