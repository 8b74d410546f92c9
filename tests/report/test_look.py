"""Figures for papers and slides: the width asked for, text as text, nothing clipped, one panel or all."""

from __future__ import annotations

import re
from pathlib import Path

import matplotlib
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from slamcmp.errors import UsageError
from slamcmp.report.figures import style
from slamcmp.report.figures.draw import draw_figures, each_figure
from slamcmp.report.figures.look import Look, check_font, parse_width
from slamcmp.results.store import Results

PAPER = Look("paper", 88 / 25.4, "serif")


def clipped(figure: Figure) -> list[str]:
    """Titles, labels and legends that leave the figure."""
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.draw_without_rendering()
    width, height = figure.bbox.width, figure.bbox.height
    texts = [figure._suptitle] if figure._suptitle is not None else []
    for axes in figure.axes:
        texts += [axes.title, axes._left_title, axes._right_title, axes.xaxis.label, axes.yaxis.label]
    texts += [text for legend in figure.legends for text in legend.get_texts()]
    found = []
    for text in texts:
        box = text.get_window_extent(renderer)
        inside = box.x0 >= -2 and box.y0 >= -2 and box.x1 <= width + 2 and box.y1 <= height + 2
        if text.get_text() and not inside:
            found.append(text.get_text())
    return found


@pytest.mark.parametrize(
    ("look", "names"),
    [(PAPER, ["map", "consistency", "sweep"]), (Look("paper", 2.5), ["budget"]), (Look("slide"), ["errors"])],
    ids=["88mm", "narrow", "slide"],
)
def test_figures_fit_and_nothing_is_clipped(swept: Results, look: Look, names: list[str]) -> None:
    drawn = list(each_figure(swept, names, look))
    for each in drawn:
        assert each.figure is not None, each.reason
        assert each.figure.get_figwidth() == pytest.approx(look.width_inch or 13.333)
        with matplotlib.rc_context({**style.RC, **look.rc}):
            assert clipped(each.figure) == [], each.name


def test_every_figure_says_which_trials_it_shows(swept: Results) -> None:
    for each in each_figure(swept, ["map", "consistency", "sweep", "budget"]):
        if each.figure is not None:
            title = each.figure.get_suptitle()
            assert re.search(r"trial \d+ \(seed \d|over \d+ trials \(seeds 0 to 5\)", title), (
                each.name,
                title,
            )


def test_panels_of_a_row_go_below_one_another(swept: Results) -> None:
    (wide,) = each_figure(swept, ["sweep"], Look("paper", 14.0))
    (narrow,) = each_figure(swept, ["sweep"], PAPER)
    assert wide.figure is not None
    assert narrow.figure is not None
    for drawn, columns in ((wide, 4), (narrow, 1)):
        spec = drawn.figure.axes[0].get_subplotspec()  # type: ignore[union-attr]
        assert spec is not None
        assert spec.get_gridspec().ncols == columns
    assert narrow.figure.get_figheight() > 2 * narrow.figure.get_figwidth()


def test_text_stays_text(one_trial: Results, tmp_path: Path) -> None:
    draw_figures(one_trial, ["time"], tmp_path, ("svg", "pdf"), PAPER)
    svg = (tmp_path / "time.svg").read_text()
    assert "What a frame costs" in svg
    assert svg.count("<text") > 10
    pdf = (tmp_path / "time.pdf").read_bytes()
    assert b"/FontType 3" not in pdf
    assert b"/Type3" not in pdf
    assert b"/CIDFontType2" in pdf


def test_one_panel(swept: Results, tmp_path: Path) -> None:
    drawn = draw_figures(swept, ["sweep"], tmp_path, ("png",), Look("paper", 88 / 25.4, panel=2))
    assert [path.name for path in drawn] == ["sweep_panel2.png"]
    (one,) = each_figure(swept, ["sweep"], Look(panel=2))
    assert one.figure is not None
    assert [axes.get_title(loc="left") for axes in one.figure.axes] == ["heading RMSE [deg]"]
    (none,) = each_figure(swept, ["sweep"], Look(panel=9))
    assert none.figure is None
    assert none.reason == "--panel 9: this figure has panels 1 to 4"


def test_the_page_is_as_it_was(swept: Results) -> None:
    (page,) = each_figure(swept, ["sweep"])
    assert page.figure is not None
    assert tuple(page.figure.get_size_inches()) == pytest.approx((2.9 * 4 + 0.6, 4.0))


@pytest.mark.parametrize(
    ("text", "inches"), [("88mm", 88 / 25.4), (" 8.8 cm", 88 / 25.4), ("3.5in", 3.5), ("252pt", 252 / 72.27)]
)
def test_widths_have_units(text: str, inches: float) -> None:
    assert parse_width(text) == pytest.approx(inches)


@pytest.mark.parametrize("text", ["88", "88 px", "-3in", "0mm", "9000mm", "mm", "nan mm"])
def test_widths_that_are_none_are_refused(text: str) -> None:
    with pytest.raises(UsageError, match="--width"):
        parse_width(text)


def test_a_font_that_is_not_there_is_named() -> None:
    assert check_font("DejaVu Sans") == "DejaVu Sans"
    with pytest.raises(UsageError, match=r"no such font; did you mean 'DejaVu Sans'"):
        check_font("DejaVue Sans")
