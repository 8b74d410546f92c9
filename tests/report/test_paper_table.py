"""Tables for papers: numbers, marks of the best, and text that LaTeX, Markdown and pandas read."""

from __future__ import annotations

import io
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from slamcmp.errors import UsageError
from slamcmp.report.paper_table import latex_escaped, paper_table
from slamcmp.results.store import Results
from tests.results.hand_made import results_of, runs

ERRORS = np.array([1.0, 2.0, 4.0, 8.0, 16.0, 32.0])
WOBBLE = np.array([1.1, 0.9, 1.05, 0.95, 1.02, 0.99])
NASTY = r"50 % \ {a_b} & $x^2$ #1 ~ <χ²|σ>"


@pytest.fixture
def results() -> Results:
    """``best`` and ``tie`` are not told apart; ``NASTY`` is half as good, and has a target near 3."""
    rows = runs("tie", (ERRORS * WOBBLE).tolist(), online_pose_nees=2.0)
    rows += runs("best", ERRORS.tolist(), online_pose_nees=3.0)
    rows += runs(NASTY, (2 * ERRORS).tolist(), failed=(5,), online_pose_nees=9.0)
    manifest = {"command": "slamcmp run e.yaml\n\\input{x}", "versions": {"slamcmp": "0.1"}, "created": "now"}
    return replace(results_of(rows), manifest=manifest)


def test_the_best_is_marked_with_what_is_not_told_apart(results: Results) -> None:
    table = paper_table(results, ["online_ate", "online_pose_nees", "failed"], best=True)
    assert [[cell.best for cell in cells] for _, cells in table.rows] == [
        [True, False, False],
        [True, False, False],
        [False, False, False],
    ]
    text = table.markdown()
    rows = [line.split("|") for line in text.splitlines() if line.startswith("| ")]
    assert rows[3][2].strip() == "**6.00** [1.00, 32.0]"
    # Five runs: too few for an interval of their median, 8.
    assert rows[4][-3].strip() == "9.00"
    assert [row[-2].strip() for row in rows[2:]] == ["0", "0", "1"]
    assert not any(cell.best for _, cells in paper_table(results, ["online_ate"]).rows for cell in cells)


def test_with_too_few_pairs_the_best_stands_alone() -> None:
    results = results_of(runs("a", [1.0, 2.0]) + runs("b", [1.01, 2.02]) + runs("same", [1.0, 2.0]))
    table = paper_table(results, ["online_ate"], best=True)
    assert {keys[0]: cells[0].best for keys, cells in table.rows} == {"a": True, "b": False, "same": True}


def test_more_is_better_where_the_metric_says_so() -> None:
    rows = [row | {"gate_recall": 0.9} for row in runs("a", [1.0])]
    rows += [row | {"gate_recall": 0.5} for row in runs("b", [1.0])]
    table = paper_table(results_of(rows), ["gate_recall"], best=True)
    assert [cells[0].best for _, cells in table.rows] == [True, False]


def test_csv_has_full_precision_and_comments(results: Results) -> None:
    text = paper_table(results, ["online_ate"], best=True, command="slamcmp table e").csv()
    assert text.startswith("# slamcmp table e\n# results: slamcmp run e.yaml \\input{x} (slamcmp 0.1, now)\n")
    table = pd.read_csv(io.StringIO(text), comment="#", header=0)
    # The comment sign of pandas cuts the label that holds one.
    assert table.columns.tolist() == [
        "back_end",
        "online_ate",
        "online_ate_low",
        "online_ate_high",
        "online_ate_best",
    ]
    plain = pd.read_csv(io.StringIO("".join(line for line in text.splitlines(True) if line[:2] != "# ")))
    assert plain["back_end"].tolist() == ["tie", "best", NASTY]
    assert plain["online_ate"][1] == np.median(ERRORS)
    assert plain["online_ate_high"].isna().tolist() == [False, False, True]


def test_swept_values_name_rows() -> None:
    path = "source.range_sigma_m"
    rows = [{**row, "trial": i} for n in (0.1, 0.3) for i, row in enumerate(runs("a", [n] * 2, **{path: n}))]
    table = paper_table(results_of(rows), ["online_ate", "runs"])
    assert table.keys == ("back end", path)
    assert [keys for keys, _ in table.rows] == [("a", "0.1"), ("a", "0.3")]
    # Programs read CSV, readers the others.
    assert "back_end,source.range_sigma_m,online_ate" in table.csv()
    for text in (table.latex(), table.markdown()):
        assert "range sigma" in text
        assert "source" not in text
    # A unit that means something to LaTeX, and two parameters of one name.
    swept = {"source.turn_sigma_deg_s": 2.0, "source.start": 1.0, "front_end.start": 0.0}
    both = paper_table(results_of(runs("a", [1.0], **swept)), ["online_ate"])
    assert r"{turn sigma [\textdegree{}/s]} & {start (source)} & {start (front end)}" in both.latex()
    assert r"| back end | turn sigma \[°/s\] | start (source) | start (front end) |" in both.markdown()


def test_columns_that_are_not_there_are_named(results: Results) -> None:
    with pytest.raises(UsageError, match="'onlin_ate' is no column; did you mean 'online_ate'"):
        paper_table(results, ["onlin_ate"])
    with pytest.raises(UsageError, match="'landmark_rmse' has no value in these results"):
        paper_table(results, ["landmark_rmse"])
    with pytest.raises(UsageError, match="no column is named"):
        paper_table(results, [])


@pytest.mark.parametrize("intervals", [True, False])
def test_every_row_of_the_latex_has_the_columns_of_its_layout(results: Results, intervals: bool) -> None:
    text = paper_table(results, best=True, intervals=intervals).latex()
    layout = re.search(r"\\begin\{tabular\}\{(.*)\}", text)
    assert layout is not None
    columns = len(re.findall(r"S\[|(?<![a-z])l", layout[1]))
    for line in text.splitlines():
        if not line.endswith(r"\\"):
            assert line.startswith(("%", "\\"))
            continue
        cells = re.split(r"(?<!\\)&", line)
        wide = sum(int(n) - 1 for n in re.findall(r"\\multicolumn\{(\d+)\}", line))
        assert len(cells) + wide == columns
        # Braces are balanced, so no label ends a cell.
        bare = re.sub(r"\\[{}]", "", line)
        assert bare.count("{") == bare.count("}")
    assert r"\bfseries 6.00" in text
    assert "\n\\input" not in text


def test_letters_that_mean_something_are_escaped() -> None:
    assert latex_escaped("a_b & 50 %") == r"a\_b \& 50 \%"
    assert latex_escaped("\\x{}^~") == r"\textbackslash{}x\{\}\textasciicircum{}\textasciitilde{}"
    assert latex_escaped("χ²/dof [1/m²]\n∞") == r"$\chi^2$/dof [1/m\textsuperscript{2}] $\infty$"


def test_the_latex_compiles(results: Results, tmp_path: Path) -> None:
    """With whatever TeX this machine has."""
    program = next((each for each in ("tectonic", "pdflatex", "lualatex") if shutil.which(each)), None)
    if program is None:
        pytest.skip("neither tectonic nor TeX Live is installed")
    table = paper_table(results, best=True).latex()
    head = r"\documentclass{article}\usepackage{booktabs,siunitx,textcomp}\usepackage[T1]{fontenc}"
    head += r"\sisetup{detect-weight=true,mode=text}\begin{document}"
    (tmp_path / "t.tex").write_text(f"{head}\n{table}\\end{{document}}\n")
    options = [] if program == "tectonic" else ["-interaction=nonstopmode", "-halt-on-error"]
    done = subprocess.run([program, *options, "t.tex"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-2000:]
    assert (tmp_path / "t.pdf").is_file()
