"""The command line of the advice, as a user calls it."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

from slamcmp.cli import app
from slamcmp.errors import MissingDataError, UsageError

RUNNER = CliRunner()


def test_a_recording_of_ones_own_gives_what_one_run_can_say(tmp_path):
    log = tmp_path / "mine"
    log.mkdir()
    rows = [f"{0.1 * k:.1f},1.0,10" for k in range(40)]
    (log / "odometry.csv").write_text("\n".join(["t_s,v_m_s,omega_deg_s", *rows]))
    seen = [f"{0.5 * k:.1f},{i},{3 + i + 0.1 * k:.2f},{20 * i - 8 * k}" for k in range(8) for i in range(3)]
    (log / "detections.csv").write_text("\n".join(["t_s,id,range_m,bearing_deg", *seen]))
    options = ["--set", "source.range_sigma_m=0.5", "--set", "source.bearing_sigma_rad=0.5", "--jobs", "1"]
    page = tmp_path / "a.html"
    found = RUNNER.invoke(
        app, ["advise", str(log), *options, "--results", str(tmp_path / "r"), "--html", str(page), "--json"]
    )
    assert found.exit_code == 0, found.output
    told = json.loads(found.stdout)
    assert (told["verdict"], told["recommended"]) == ("not enough runs to say", None)
    assert (told["runs"], told["reference"], told["what_if"]) == (1, "batch (final)", [])
    said = " ".join(each["text"] for each in told["sentences"])
    assert "1 run that ended well, and an interval needs 5" in said
    assert "distance from the batch solution" in said
    assert "squared innovations" in said
    assert "What would change this cannot be tried" in said
    assert "Not enough runs to say" in page.read_text()


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (["nothing_like_it"], MissingDataError, "there is no experiment file"),
        (["quickstart", "--set", "steps=3"], UsageError, "expected source.PARAMETER=VALUE"),
        (["quickstart", "--budget-ms", "0"], UsageError, "budget_ms is a number above 0"),
    ],
)
def test_what_cannot_be_is_one_line(arguments, error, message):
    found = RUNNER.invoke(app, ["advise", *arguments])
    assert isinstance(found.exception, error)
    assert message in str(found.exception)
    assert "\n" not in str(found.exception)


def test_help_has_examples():
    found = RUNNER.invoke(app, ["advise", "--help"])
    assert found.exit_code == 0
    assert "slamcmp advise quickstart" in found.output
