"""What a user names is an experiment or a recording, and one clear line where it is neither."""

from __future__ import annotations

import re

import pytest

from slamcmp.advice.ladder import BATCH, INCREMENTAL, ladder, rungs, window
from slamcmp.advice.problem import load_problem
from slamcmp.advice.variations import variations
from slamcmp.errors import MissingDataError, UsageError
from slamcmp.experiment.config.experiment import parse_experiment
from slamcmp.support.configuration.code_source import CodeSource

WORLD = {"name": "circle", "steps": 20, "landmarks": 10}


def problem(source=WORLD, back_ends=({"name": "ekf_slam"},), **more):
    return parse_experiment(
        CodeSource("p", {"source": dict(source), "back_ends": list(back_ends), **more}), None
    )


def recording(folder, *, parts=("odometry", "detections")):
    folder.mkdir(parents=True)
    for part in parts:
        (folder / f"{part}.csv").write_text("t_s\n0\n")
    return folder


def test_a_folder_with_odometry_is_a_recording_and_so_is_its_odometry_file(tmp_path):
    folder = recording(tmp_path / "a log", parts=("odometry", "detections", "truth"))
    (folder / "landmarks.parquet").write_text("")
    for named in (folder, folder / "odometry.csv"):
        found = load_problem(str(named), ["source.range_sigma_m=0.2"])
        assert (found.source.name, found.name) == ("recording", "a-log")
        given = found.source.parameters
        assert {part: given[part] for part in ("odometry", "detections", "truth", "landmarks")} == {
            "odometry": str(folder / "odometry.csv"),
            "detections": str(folder / "detections.csv"),
            "truth": str(folder / "truth.csv"),
            "landmarks": str(folder / "landmarks.parquet"),
        }
        assert given["range_sigma_m"] == 0.2
        assert not variations(found)


def test_a_folder_of_recordings_is_as_many_samples(tmp_path):
    for name in ("b", "a"):
        recording(tmp_path / name)
    found = load_problem(str(tmp_path))
    assert [each["odometry"] for each in found.recordings] == [
        str(tmp_path / name / "odometry.csv") for name in ("a", "b")
    ]
    (tmp_path / "b" / "truth.csv").write_text("t_s\n0\n")
    with pytest.raises(MissingDataError, match=re.escape(f"{tmp_path / 'a'}: has no truth file")):
        load_problem(str(tmp_path))


def test_what_is_neither_is_said_in_one_line(tmp_path):
    with pytest.raises(MissingDataError, match=r"no recording here: odometry\.csv"):
        load_problem(str(tmp_path))
    with pytest.raises(MissingDataError, match="there is no file"):
        load_problem(str(tmp_path / "odometry.csv"))
    with pytest.raises(MissingDataError, match="did you mean 'quickstart'"):
        load_problem("quickstar")


@pytest.mark.parametrize("text", ["range_sigma_m=1", "source.x", "back_ends.a=1", "source.=1", "=1", ""])
def test_a_setting_that_is_none_is_refused(text):
    with pytest.raises(UsageError, match=r"expected source\.PARAMETER=VALUE"):
        load_problem("quickstart", [text])


def test_settings_are_checked_like_the_files_own():
    found = load_problem("quickstart", ["source.steps=50", "front_end.gate_probability=null"])
    assert (found.source.parameters["steps"], found.source.parameters["landmarks"]) == (50, 40)
    assert found.front_end.parameters["gate_probability"] is None
    with pytest.raises(UsageError, match=r"experiment\['source'\]\['stepps'\].*did you mean 'steps'"):
        load_problem("quickstart", ["source.stepps=50"])


def test_the_ladder_keeps_what_the_user_has_set_for_his_back_ends():
    own = problem(
        back_ends=[
            {"name": "ekf_slam", "label": "mine", "forget_after": 3, "own_gate": 0.99},
            {"name": "batch", "robust": "huber", "own_gate": 0.99},
            {"name": "ekf_right_invariant", "smooth": True, "own_gate": 0.99},
        ],
        sweep={"source.steps": [10, 20]},
        time_limit_s=5,
    )
    found = ladder(own, rungs(windows=(5, 10)), time_limit_s=60.0)
    by_label = {each.label: each for each in found.back_ends}
    assert by_label["EKF"].parameters["forget_after"] == 3
    assert {each.own_gate for each in found.back_ends} == {0.99}
    # A kernel is the problem's: whoever knows it gets it.
    for each in found.back_ends:
        assert each.parameters.get("robust", "huber") == "huber"
    assert by_label[INCREMENTAL].parameters["robust"] == "huber"
    # But a rung is what its label says.
    assert by_label["right-invariant EKF"].parameters["smooth"] is False
    assert by_label["right-invariant EKF + RTS"].parameters["smooth"] is True
    assert [by_label[window(w)].parameters["window"] for w in (5, 10)] == [5, 10]
    assert (found.reference, found.time_limit_s, found.sweep) == (BATCH, 5.0, {})


def test_variations_are_of_parameters_that_the_source_has():
    by_name = {each.name: each.parameters for each in variations(problem())}
    assert by_name == {
        "twice the odometry noise": {"odometry_scale": 2.0},
        "half the loop closures": {"turn_deg_s": 3.0, "landmarks": 20},
        "half the landmarks": {"landmarks": 5},
        "twice the sensor noise": {"range_sigma_m": 0.2, "bearing_sigma_deg": 2.0, "position_sigma_m": 0.2},
    }
    dense = variations(problem({**WORLD, "in_view": 4.0}))
    assert {each.name: each.parameters for each in dense}["half the loop closures"] == {"turn_deg_s": 3.0}
    streets = {each.name: each.parameters for each in variations(problem({"name": "streets"}))}
    assert streets["twice the odometry noise"] == {"translation_sigma_m": 0.04, "heading_sigma_rad": 0.02}
    assert "half the loop closures" not in streets
    changed = variations(problem())[0].of(problem())
    assert changed.source.parameters["odometry_scale"] == 2.0
    assert changed.source.parameters["steps"] == 20


def test_a_file_over_another_is_a_problem_as_any(tmp_path):
    (tmp_path / "base.yaml").write_text(
        "source: {name: circle, landmarks: 7, steps: 20}\nback_ends: [{name: ekf_slam}]\n"
        "sweep: {source.steps: [5]}\n"
    )
    (tmp_path / "own.yaml").write_text("extends: base.yaml\nsource: {landmarks: 9}\nsweep: null\n")
    for settings, steps in (([], 20), (["source.steps=6"], 6)):
        found = load_problem(str(tmp_path / "own.yaml"), settings)
        assert (found.name, found.source.parameters["landmarks"]) == ("own", 9)
        assert (found.source.parameters["steps"], dict(found.sweep)) == (steps, {})
