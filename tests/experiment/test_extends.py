"""One file over another: what is taken over, where relative paths start, where mistakes are said to be."""

from __future__ import annotations

from pathlib import Path

import pytest

from slamcmp.errors import UsageError
from slamcmp.experiment.config.experiment import load_experiment

BASE = """
name: base
question: What?
source: {name: circle, landmarks: 7, steps: 20}
front_end: {name: labelled, range_max_m: 5.0}
back_ends:
  - {name: ekf_slam, label: EKF}
seeds: 5
sweep: {source.range_sigma_m: [0.1, 0.2]}
"""


def write(folder: Path, **texts: str) -> Path:
    for name, text in texts.items():
        path = folder / f"{name.replace('__', '/')}.yaml"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return folder / "own.yaml"


def test_own_values_stand_over_those_below(tmp_path: Path) -> None:
    own = "extends: base.yaml\nsource: {landmarks: 9}\nseeds: [3]\nsweep: {source.steps: [5]}\n"
    found = load_experiment(write(tmp_path, base=BASE, own=own))
    assert found.name == "own"
    assert found.question == "What?"
    assert (found.source.parameters["landmarks"], found.source.parameters["steps"]) == (9, 20)
    assert found.front_end.parameters["range_max_m"] == 5.0
    assert [each.label for each in found.back_ends] == ["EKF"]
    assert found.seeds == (3,)
    assert dict(found.sweep) == {"source.range_sigma_m": (0.1, 0.2), "source.steps": (5,)}


def test_lists_are_replaced_and_another_plugin_starts_anew(tmp_path: Path) -> None:
    own = "extends: base.yaml\nsource: {name: corridor, steps: 15}\nback_ends: [{name: isam2}]\nsweep: {}\n"
    found = load_experiment(write(tmp_path, base=BASE, own=own))
    assert found.source.name == "corridor"
    assert [each.name for each in found.back_ends] == ["isam2"]


def test_three_layers_and_folders(tmp_path: Path) -> None:
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "mine.py").write_text(
        "from slamcmp.backends.dead_reckoning import DeadReckoning as Mine\n"
    )
    middle = "extends: ../base.yaml\nback_ends: [{name: 'mine.py:Mine', label: m}]\n"
    own = "extends: deep/middle.yaml\nseeds: 2\n"
    found = load_experiment(write(tmp_path, base=BASE, deep__middle=middle, own=own))
    (back_end,) = found.back_ends
    assert back_end.plugin().target.__name__ == "DeadReckoning"
    assert found.seeds == (0, 1)


def test_anchors_and_merge_keys(tmp_path: Path) -> None:
    own = "x-common: &window {name: sliding_window, linearisation: fej}\n"
    own += "source: {name: circle}\nback_ends:\n"
    own += "".join(f"  - {{<<: *window, label: w{n}, window: {n}}}\n" for n in (2, 5))
    found = load_experiment(write(tmp_path, own=own))
    assert [(each.label, each.parameters["window"]) for each in found.back_ends] == [("w2", 2), ("w5", 5)]
    assert {each.parameters["linearisation"] for each in found.back_ends} == {"fej"}


@pytest.mark.parametrize(
    ("texts", "said"),
    [
        (
            {"own": "extends: own.yaml\n"},
            r"own.yaml:1:10: extends: goes round in a circle: own.yaml → own.yaml$",
        ),
        (
            {"own": "seeds: 1\nextends: a.yaml\n", "a": "extends: b.yaml\n", "b": "extends: a.yaml\n"},
            r"b.yaml:1:10: extends: goes round in a circle: a.yaml → b.yaml → a.yaml$",
        ),
        ({"own": "seeds: 1\nextends: none.yaml\n"}, r"own.yaml:2:10: extends: there is no file .*none.yaml$"),
        (
            {"own": "extends: [a.yaml]\n"},
            r"own.yaml:1:10: extends: the path of another file is needed, not \[",
        ),
        ({"own": "extends: a.yaml\n", "a": "source: {\n"}, r"a.yaml:\d+:\d+: not valid YAML"),
        (
            {"own": "extends: base.yaml\nsource: {landmark: 9}\n", "base": BASE},
            r"own.yaml:2:10: unknown key 'landmark'; did you mean 'landmarks'",
        ),
        (
            {"own": "extends: base.yaml\nseeds: 2\n", "base": BASE.replace("steps: 20", "steps: many")},
            r"base.yaml:4:45: steps: input should be a valid integer, not 'many'$",
        ),
        ({"own": "extends: a.yaml\n", "a": "seeds: 2\n"}, "key 'source' is missing"),
        ({"own": "y-mine: 1\nsource: {name: circle}\nback_ends: [{name: isam2}]\n"}, "unknown key 'y-mine'"),
    ],
)
def test_mistakes_are_told_with_the_file_and_line_they_stand_in(
    tmp_path: Path, texts: dict[str, str], said: str
) -> None:
    with pytest.raises(UsageError, match=f"(?m){said}"):
        load_experiment(write(tmp_path, **texts))


def test_null_takes_an_inherited_key_away(tmp_path: Path) -> None:
    own = "extends: base.yaml\nsweep: null\nquestion: null\nfront_end: {gate_probability: null}\n"
    found = load_experiment(write(tmp_path, base=BASE, own=own))
    assert not found.sweep
    assert found.question == ""
    # Below the top null is a value, that of "no gate" here.
    assert found.front_end.parameters["gate_probability"] is None
    # Nothing to take away: the mistake is told as in any file.
    with pytest.raises(UsageError, match="sweep"):
        load_experiment(
            write(tmp_path, own="source: {name: circle}\nback_ends: [{name: ekf_slam}]\nsweep: null\n")
        )
