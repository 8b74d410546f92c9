"""Configurations: every mistake at its place, and what the good ones mean."""

from __future__ import annotations

import textwrap
from pathlib import Path

import pytest

from slamcmp.errors import MissingDataError, UsageError
from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.experiment.config.schema import experiment_schema
from slamcmp.experiment.planning.trials import make_trials
from slamcmp.support.configuration.config_errors import ConfigError

GOOD = """\
question: does it work?
source: {name: circle, steps: 20}
back_ends:
  - {name: ekf_slam, label: EKF}
"""


def load(tmp_path: Path, text: str):
    path = tmp_path / "mine.yaml"
    path.write_text(textwrap.dedent(text))
    return load_experiment(path)


def mistakes(tmp_path: Path, text: str) -> list[tuple[str, str]]:
    """(line:column, message) of every mistake."""
    with pytest.raises(UsageError) as caught:
        load(tmp_path, text)
    prefix = f"{tmp_path / 'mine.yaml'}:"
    lines = str(caught.value).splitlines()
    assert all(line.startswith(prefix) for line in lines)
    return [tuple(line.removeprefix(prefix).split(": ", 1)) for line in lines]


def test_defaults_and_normalised_parameters(tmp_path: Path) -> None:
    experiment = load(tmp_path, GOOD)
    assert experiment.name == "mine"
    assert experiment.seeds == (0,)
    assert experiment.front_end.name == "labelled"
    assert experiment.source.parameters["steps"] == 20
    assert experiment.source.parameters["sensor"] == "range_bearing"
    assert [(each.name, each.label) for each in experiment.back_ends] == [("ekf_slam", "EKF")]


def test_every_mistake_at_once_with_its_place(tmp_path: Path) -> None:
    found = mistakes(
        tmp_path,
        """\
        sorce: {name: circle}
        source:
          name: circle
          rnge_max_m: 3
          range_max_m: far
          sensor: range_bering
        back_ends:
          - {name: ekf_slm}
          - {name: ekf_slam, label: a}
          - {name: ekf_slam, label: a}
          - {label: nameless}
        seeds: [1, -2]
        time_limit_s: "10"
        """,
    )
    places = [place for place, _ in found]
    assert places == ["1:1", "4:3", "5:16", "6:11", "8:12", "10:5", "11:5", "12:12", "13:15"]
    messages = dict(found)
    assert messages["1:1"].startswith("unknown key 'sorce'; did you mean 'source'? Known: back_ends,")
    assert messages["4:3"].startswith("unknown key 'rnge_max_m'; did you mean 'range_max_m'?")
    assert messages["5:16"] == "range_max_m: input should be a valid number, not 'far'"
    assert messages["6:11"].startswith("sensor: 'range_bering' is not allowed; did you mean 'range_bearing'?")
    assert messages["8:12"].startswith("unknown back end 'ekf_slm'; did you mean 'ekf_slam'?")
    assert messages["10:5"].startswith("label 'a' is taken by back end 2")
    assert messages["11:5"] == "key 'name' is missing"
    assert messages["12:12"] == "seeds: input should be greater than or equal to 0, not -2"
    assert messages["13:15"] == "time_limit_s: input should be a valid number, not '10'"


def test_mistakes_in_a_sweep_are_found_at_path_or_value(tmp_path: Path) -> None:
    found = mistakes(
        tmp_path,
        GOOD
        + """\
sweep:
  source.range_max_m: [3, -1]
  source.rnge: [1]
  back_ends.EFK.gate: [1]
  odometry: [2]
  front_end.min_sightings: [1, 1]
reference: batch
""",
    )
    assert [place for place, _ in found] == ["6:27", "7:3", "8:3", "9:3", "10:32", "11:12"]
    messages = dict(found)
    assert messages["6:27"] == "source.range_max_m: input should be greater than 0, not -1"
    assert "has no parameter 'rnge'; did you mean 'range" in messages["7:3"]
    assert messages["8:3"] == "sweep: no back end has the label 'EFK'; did you mean 'EKF'? Known: EKF"
    assert messages["9:3"].startswith("sweep: 'odometry' is not a path: source.PARAMETER")
    assert messages["10:32"] == "sweep: 1 stands twice"
    assert messages["11:12"] == "no back end has the label 'batch'; known: EKF"


@pytest.mark.parametrize(
    ("text", "place", "part"),
    [
        ("source: {name: circle\nback_ends: []\n", "2:10", "not valid YAML"),
        ("source: a\nsource: b\n", "2:1", "not valid YAML: found duplicate key"),
        ("a:\n\t- b\n", "2:1", "not valid YAML: found character '\\t'"),
        ("- 1\n", "1:1", "an experiment is a mapping"),
        ("", "1:1", "not empty"),
    ],
)
def test_text_that_is_no_mapping(tmp_path: Path, text: str, place: str, part: str) -> None:
    (found,) = mistakes(tmp_path, text)
    assert found[0] == place
    assert part in found[1]


def test_missing_sections_are_named(tmp_path: Path) -> None:
    assert mistakes(tmp_path, "question: why?\n") == [
        ("1:1", "key 'source' is missing or: key 'back_ends' is missing")
    ]


def test_recorded_data_takes_no_seeds(tmp_path: Path) -> None:
    text = "source: {name: victoria_park}\nback_ends: [{name: ekf_slam}]\n"
    assert load(tmp_path, text).seeds == (None,)
    ((place, message),) = mistakes(tmp_path, text + "seeds: 3\n")
    assert place == "3:8"
    assert "takes no seed" in message
    with pytest.raises(UsageError, match="takes no seed"):
        load(tmp_path, text).with_seeds([1])


def test_no_such_file(tmp_path: Path) -> None:
    with pytest.raises(MissingDataError, match=r"nothing\.yaml: No such file"):
        load_experiment(tmp_path / "nothing.yaml")


def test_user_file_is_found_beside_the_experiment(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "class MyEkf:\n    def __init__(self, problem, *, gate: float = 9.0): ...\n"
    )
    text = "source: {name: circle}\nback_ends:\n  - {name: mine.py:MyEkf, gate: 4}\n"
    (back_end,) = load(tmp_path, text).back_ends
    assert (back_end.name, back_end.label) == ("mine.py:MyEkf", "MyEkf")
    assert back_end.parameters == {"gate": 4.0}
    ((place, message),) = mistakes(tmp_path, text.replace("MyEkf,", "MyEfk,"))
    assert place == "3:12"
    assert "did you mean 'MyEkf'?" in message


def test_grid_times_seeds_in_order(tmp_path: Path) -> None:
    experiment = load(
        tmp_path,
        GOOD + "seeds: [7, 3]\nsweep: {source.steps: [20, 30], source.landmarks: [5, 6]}\n",
    )
    trials = make_trials(experiment)
    assert [trial.number for trial in trials] == list(range(8))
    assert [(*trial.swept.values(), trial.seed) for trial in trials] == [
        (20, 5, 7), (20, 5, 3), (20, 6, 7), (20, 6, 3), (30, 5, 7), (30, 5, 3), (30, 6, 7), (30, 6, 3),
    ]  # fmt: skip
    assert trials[4].stream.source.parameters["steps"] == 30
    assert len({trial.stream.key for trial in trials}) == 8
    assert len({job.key for trial in trials for job in trial.runs}) == 8


def test_sweeping_one_back_end_shares_streams_and_other_runs(tmp_path: Path) -> None:
    (tmp_path / "two.py").write_text(
        "class A:\n    def __init__(self, problem, *, g: int = 1): ...\nclass B(A): ...\n"
    )
    text = (
        "source: {name: circle}\nback_ends: [{name: two.py:A}, {name: two.py:B}]\n"
        "sweep: {back_ends.A.g: [1, 2, 3]}\n"
    )
    trials = make_trials(load(tmp_path, text))
    assert len({trial.stream.key for trial in trials}) == 1
    assert len({trial.runs[0].key for trial in trials}) == 3
    assert len({trial.runs[1].key for trial in trials}) == 1


OWN_GATES = """\
source: {name: circle}
back_ends:
  - {name: ekf_slam}
  - {name: ekf_slam, own_gate: 0.99}
  - {name: isam2, label: tree, own_gate: 0.9}
"""


def test_a_gate_of_its_own_is_part_of_the_run_but_not_of_the_stream(tmp_path: Path) -> None:
    experiment = load(tmp_path, OWN_GATES)
    assert [(each.label, each.own_gate) for each in experiment.back_ends] == [
        ("ekf_slam", None),
        ("ekf_slam, own gate", 0.99),
        ("tree", 0.9),
    ]
    assert "own_gate" not in experiment.back_ends[1].parameters
    written = experiment.as_dict()["back_ends"]
    assert [each.get("own_gate") for each in written] == [None, 0.99, 0.9]
    (trial,) = make_trials(experiment)
    assert len({job.key for job in trial.runs}) == 3
    assert len({job.stream_key for job in trial.runs}) == 1


def test_a_gate_of_its_own_can_be_swept(tmp_path: Path) -> None:
    text = OWN_GATES + "sweep: {back_ends.tree.own_gate: [null, 0.9, 0.99]}\n"
    trials = make_trials(load(tmp_path, text))
    assert [trial.runs[2].back_end.own_gate for trial in trials] == [None, 0.9, 0.99]
    assert len({trial.runs[2].key for trial in trials}) == 3
    assert len({trial.runs[1].key for trial in trials}) == 1


def test_mistakes_about_a_gate_of_its_own(tmp_path: Path) -> None:
    found = mistakes(
        tmp_path,
        """\
        source: {name: circle}
        back_ends:
          - {name: ekf_slam, own_gate: 1.5}
          - {name: isam2, own_gate: yes please}
          - {name: fixed_lag, own_gate: 0.99}
          - {name: ekf_fej}
        sweep:
          back_ends.ekf_fej.own_gate: [0.9, 0, 0.9]
        """,
    )
    assert [place for place, _ in found] == ["3:32", "4:29", "5:33", "8:37", "8:40"]
    texts = [text for _, text in found]
    assert texts[0] == "own_gate: input should be less than 1, not 1.5"
    assert texts[1] == "own_gate: input should be a valid number, not 'yes please'"
    assert texts[2].startswith("own_gate: back end 'fixed_lag' has no joint_covariance(), which its own gate")
    able = texts[2].rpartition("take one of: ")[2].split(", ")
    assert {"ekf_slam", "ekf_right_invariant", "isam2", "sliding_window", "batch"} <= set(able)
    assert not {"fixed_lag", "msckf"} & set(able)
    assert texts[3] == "back_ends.ekf_fej.own_gate: input should be greater than 0, not 0"
    assert texts[4] == "sweep: 0.9 stands twice"


def test_schema_knows_plugins_and_their_bounds() -> None:
    schema = experiment_schema()
    circle = next(each for each in schema["properties"]["source"]["anyOf"] if each.get("title") == "circle")
    assert circle["properties"]["name"] == {"const": "circle"}
    assert circle["properties"]["range_max_m"]["exclusiveMinimum"] == 0
    assert circle["additionalProperties"] is False
    labels = [
        each["properties"].get("label") for each in schema["properties"]["back_ends"]["items"]["anyOf"][:-1]
    ]
    assert all(label == {"type": "string", "minLength": 1} for label in labels)
    gates = [
        each["properties"]["own_gate"] for each in schema["properties"]["back_ends"]["items"]["anyOf"][:-1]
    ]
    assert all((gate["exclusiveMinimum"], gate["exclusiveMaximum"]) == (0, 1) for gate in gates)


def test_shipped_experiments_are_valid() -> None:
    folder = Path(__file__).parents[2] / "experiments"
    names = [load_experiment(path).name for path in sorted(folder.glob("*.yaml"))]
    assert {"filter_vs_smoother", "map_size", "quickstart", "victoria_park"} <= set(names)


def test_config_error_lists_its_lines(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        load(tmp_path, "source: 3\nback_ends: 4\n")
    assert len(caught.value.lines) == 2
    assert caught.value.exit_code == 2
