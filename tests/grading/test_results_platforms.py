"""What Gradescope, PrairieLearn and JUnit readers get: right sums, nothing hidden, nothing broken."""

from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import pytest

from slamcmp.grading.results.gradescope import gradescope_results, write_gradescope_results
from slamcmp.grading.results.junit import junit_xml, write_junit_xml
from slamcmp.grading.results.outcome import GradeOutcome, TestOutcome
from slamcmp.grading.results.prairielearn import (
    BYTES_MAX,
    encoded,
    prairielearn_results,
    write_prairielearn_results,
)
from tests.grading.outcomes import SECRETS, STAFF, example, plot


def test_gradescope_total_is_the_sum_of_the_scores_shown() -> None:
    results = gradescope_results(example())
    assert results["score"] == 29.3456
    assert results["score"] == round(math.fsum(test["score"] for test in results["tests"]), 9)
    assert [test["max_score"] for test in results["tests"]] == [10.0, 30.0, 20.0, 15.0, 25.0]


def test_gradescope_keeps_visibilities_and_says_that_other_tests_count() -> None:
    results = gradescope_results(example())
    assert [test["visibility"] for test in results["tests"]] == [
        "visible", "visible", "visible", "after_due_date", "hidden",
    ]  # fmt: skip
    assert [test["status"] for test in results["tests"]] == ["passed"] + ["failed"] * 4
    assert results["stdout_visibility"] == "hidden"
    assert results["output"].splitlines() == [
        "augment() is missing: the reference's took its place.",
        "Tests that you see: 22.35 of 60 points.",
        "One more test, 25 points: not shown.",
        "One more test, 15 points: shown after the due date.",
        "Your mark depends on these too: passing every test that you see is not all of it.",
    ]


def test_gradescope_file_holds_nothing_hidden(tmp_path: Path) -> None:
    write_gradescope_results(example(), tmp_path / "results.json")
    text = (tmp_path / "results.json").read_text()
    assert [secret for secret in SECRETS if secret in text] == []
    assert "NEES 9.3" in text, "text of a test that Gradescope itself reveals after the due date"
    assert json.loads(text)["tests"][4]["name"] == "Hidden test 5"


def test_gradescope_leaderboard_leaves_out_what_is_no_number() -> None:
    assert gradescope_results(example())["leaderboard"] == [
        {"name": "Position error [m]", "value": 0.12, "order": "asc"}
    ]


def test_gradescope_html_is_escaped_and_text_stays_text() -> None:
    results = gradescope_results(
        replace(example(), tests=tuple(replace(test, plots=(plot("<b>"),)) for test in example().tests))
    )
    crash = results["tests"][2]
    assert crash["output_format"] == "html"
    assert "<script>" not in crash["output"]
    assert "<b>" not in crash["output"]
    assert "&lt;script&gt;" in crash["output"]
    assert crash["output"].count("<img") == 1
    plain = gradescope_results(example(), images=False)["tests"]
    assert {test["output_format"] for test in plain} == {"text"}


def test_gradescope_results_of_an_unfinished_grading_say_so() -> None:
    first = example().tests[:1]
    results = gradescope_results(replace(example(complete=False), tests=first, leaderboard=()))
    assert results["score"] == 10.0
    assert "did not come to its end" in results["output"]


def test_scores_that_are_no_numbers_count_nothing(tmp_path: Path) -> None:
    broken = tuple(replace(test, score=math.nan) for test in example().tests[:2]) + example().tests[2:]
    write_gradescope_results(replace(example(), tests=broken, seconds=math.nan), tmp_path / "results.json")
    assert json.loads((tmp_path / "results.json").read_text())["score"] == 7.0


def test_prairielearn_score_is_a_fraction_of_all_tests_and_only_visible_ones_are_listed() -> None:
    results = prairielearn_results(example())
    assert results["score"] == pytest.approx(0.293456, abs=1e-12)
    assert [test["name"] for test in results["tests"]] == ["1 predict", "2 track", "3 crash"]
    assert [test["points"] for test in results["tests"]] == [10.0, 12.3456, 0.0]
    assert results["tests"][1]["images"][0]["label"] == "Position error"
    assert results["tests"][1]["images"][0]["url"].startswith("data:image/png;base64,iVBOR")
    text = encoded(results).decode()
    assert [secret for secret in (*SECRETS, "NEES 9.3") if secret in text] == []


def test_prairielearn_score_stays_between_0_and_1() -> None:
    bonus = replace(example().tests[0], score=12.0)
    assert prairielearn_results(replace(example(), tests=(bonus,)))["score"] == 1.0
    assert prairielearn_results(replace(example(), tests=()))["score"] == 0.0


def _flooded(tests: int, message: str, plots: int) -> GradeOutcome:
    test = example().tests[1]
    flood = tuple(
        replace(test, number=str(number), message=message, plots=(plot(),) * plots) for number in range(tests)
    )
    return replace(example(), tests=flood)


@pytest.mark.parametrize(
    ("tests", "message", "plots"),
    [(60, "short", 1), (300, "x" * 8_000, 0), (30_000, "\u1234" * 50, 0)],
    ids=["plots", "messages", "tests"],
)
def test_prairielearn_file_stays_under_its_limit_and_keeps_the_score(
    tmp_path: Path, tests: int, message: str, plots: int
) -> None:
    write_prairielearn_results(_flooded(tests, message, plots), tmp_path / "results.json")
    content = (tmp_path / "results.json").read_bytes()
    assert 0.2 * BYTES_MAX < len(content) <= BYTES_MAX
    assert json.loads(content)["score"] == pytest.approx(12.3456 / 30)
    if plots:
        with_image = sum("images" in test for test in json.loads(content)["tests"])
        assert 0 < with_image < tests


def test_junit_counts_and_escapes(tmp_path: Path) -> None:
    write_junit_xml(example(), tmp_path / "staff.xml", audience="staff")
    suite = ElementTree.parse(tmp_path / "staff.xml").getroot()[0]
    assert {name: suite.get(name) for name in ("tests", "failures", "errors", "skipped")} == {
        "tests": "5",
        "failures": "2",
        "errors": "2",
        "skipped": "0",
    }
    cases = suite.findall("testcase")
    assert [case[0].tag for case in cases] == ["system-out", "failure", "error", "failure", "error"]
    assert cases[1][0].get("message") == "partly passed: 12.35 of 30 points"
    assert cases[2][0].text is not None
    assert cases[2][0].text.startswith('<script>alert("x")</script> ]]> & \ufffd[2J')
    assert cases[4].findtext("system-err") == f"{STAFF} seed 4711"


def test_junit_for_a_student_holds_nothing_hidden() -> None:
    text = junit_xml(example(), audience="student").decode()
    assert [secret for secret in (*SECRETS, "NEES 9.3") if secret in text] == []
    assert ElementTree.fromstring(text)[0].get("tests") == "3"


def test_junit_of_a_skipped_test_is_skipped() -> None:
    test = TestOutcome("1", "a", "unit", "skipped", 0.0, 1.0, "visible", "needs test 0", "", 0.0)
    suite = ElementTree.fromstring(junit_xml(replace(example(), tests=(test,)), audience="student"))[0]
    assert suite.get("skipped") == "1"
    assert suite.find("testcase/skipped") is not None
