"""Shipped experiments are found, checked, and named when somebody mistypes one."""

from __future__ import annotations

from pathlib import Path

import pytest

from slamcmp.errors import MissingDataError
from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.experiment.config.shipped import find_experiment, shipped_experiments

FOLDER = Path(__file__).parents[2] / "experiments"


def test_all_of_the_folder_is_shipped_but_assignments() -> None:
    expected = {
        path.relative_to(FOLDER).with_suffix("").as_posix(): path
        for path in FOLDER.rglob("*.yaml")
        if "assignments" not in path.parts
    }
    assert shipped_experiments() == expected
    assert {"quickstart", "victoria_park", "filter_vs_smoother", "map_size"} <= expected.keys()


@pytest.mark.parametrize("name", sorted(shipped_experiments()))
def test_each_is_a_valid_experiment_with_a_question(name: str) -> None:
    assert load_experiment(shipped_experiments()[name]).question.endswith("?")


def test_a_file_comes_before_a_shipped_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert find_experiment("quickstart") == FOLDER / "quickstart.yaml"
    assert find_experiment("experiments/quickstart.yaml") == FOLDER / "quickstart.yaml"
    (tmp_path / "quickstart").write_text("")
    assert find_experiment("quickstart") == Path("quickstart")


def test_a_mistyped_name_is_corrected() -> None:
    with pytest.raises(MissingDataError, match="did you mean 'quickstart'"):
        find_experiment("quikstart")
