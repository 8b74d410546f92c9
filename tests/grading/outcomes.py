"""Outcomes made by hand, with everything in them that a results format must not stumble over."""

from __future__ import annotations

import math

from slamcmp.grading.results.outcome import GradeOutcome, Plot, Series, TestOutcome

HOSTILE = "<script>alert(\"x\")</script> ]]> & \x1b[2J \x00 \u202e =cmd|' /C calc'!A0"
STAFF = "STAFF-DETAIL"
SECRETS = ("HIDDEN-MESSAGE", "HIDDEN-NAME", "HIDDEN-PLOT", "STAFF-DETAIL", "seed 4711")


def plot(title: str = "Position error") -> Plot:
    """Sixty points of an error that leaves its band at 40 s."""
    x = tuple(float(i) for i in range(60))
    yours = tuple(0.05 * math.sin(0.4 * t) + (0.02 * (t - 30) if t > 30 else 0.0) for t in x)
    band = tuple(0.15 + 0.001 * t for t in x)
    return Plot(
        title=title,
        x_label="t [s]",
        y_label="error in x [m]",
        x=x,
        series=(
            Series("3 σ of the reference", tuple(-b for b in band), "band"),
            Series("3 σ of the reference", band, "band"),
            Series("reference", tuple(0.04 * math.sin(0.4 * t) for t in x), "reference"),
            Series("yours $x^2", yours, "yours"),
        ),
        caption="The error of your filter beside the reference's.",
    )


def path_plot() -> Plot:
    """Curves with abscissae of their own."""
    series = (
        Series("truth", (0.0, 1.0), "truth", x=(0.0, 2.0)),
        Series("yours", (0.0, 1.2, 1.3), "yours", x=(0.0, 1.9, 2.4)),
    )
    return Plot("Path", "x [m]", "y [m]", (), series, "Where it went.", equal_scales=True)


def example(*, complete: bool = True, student: str = "ada") -> GradeOutcome:
    """Five tests of 100 points: 10 + 12.3456 + 0 visible, 7 after the due date, 0 hidden."""
    tests = (
        TestOutcome("1", "predict", "unit", "passed", 10.0, 10.0, "visible", "", f"{STAFF} seed 4711", 0.2),
        TestOutcome(
            "2", "track", "accuracy", "partial", 12.345649, 30.0, "visible",
            "Your innovation is not wrapped: bearing residual 6.1 rad at step 12", STAFF, 1.5, (plot(),),
        ),
        TestOutcome("3", "crash", "unit", "error", 0.0, 20.0, "visible", HOSTILE, STAFF, 0.1),
        TestOutcome(
            "4", "consistency", "consistency", "failed", 7.0, 15.0, "after_due_date", "NEES 9.3", STAFF, 2.0
        ),
        TestOutcome(
            "5", "HIDDEN-NAME", "required_failure", "timed_out", 0.0, 25.0, "hidden", "HIDDEN-MESSAGE",
            f"{STAFF} seed 4711", 3.0, (plot("HIDDEN-PLOT"),),
        ),
    )  # fmt: skip
    return GradeOutcome(
        assignment="ekf_slam",
        assignment_digest="a" * 64,
        student=student,
        submission_digest="b" * 64,
        complete=complete,
        tests=tests,
        sandbox_level="strong",
        proofs={"open_socket": "proved", "fork": "proved"},
        seconds=6.8,
        versions={"slamcmp": "0.1.0", "numpy": "2.4.6"},
        leaderboard=(("Position error [m]", 0.12, "asc"), ("broken", math.nan, "asc")),
        notes=("augment() is missing: the reference's took its place.",),
    )
