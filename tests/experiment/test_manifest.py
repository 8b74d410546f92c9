"""Where results come from: a manifest that does not claim too much, a folder that keeps one experiment."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from slamcmp.errors import UsageError
from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.experiment.gathering import manifest
from slamcmp.experiment.runner import run_experiment
from slamcmp.results.store import load_results

Write = Callable[..., Path]


def test_untracked_code_makes_the_checkout_dirty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "slamcmp"
    package.mkdir()
    (package / "types.py").write_text("")
    (tmp_path / ".gitignore").write_text("*.pyc\n")

    def git(*arguments: str) -> None:
        identity = ["-c", "user.name=a", "-c", "user.email=a@b"]
        subprocess.run(["git", "-C", str(tmp_path), *identity, *arguments], check=True, capture_output=True)

    git("init")
    git("add", ".")
    git("commit", "-m", "first")
    monkeypatch.setattr(manifest, "PACKAGE", package)
    (tmp_path / "notes.txt").write_text("not code")
    (package / "types.pyc").write_text("ignored")
    assert manifest.commit()["dirty"] is False
    (package / "backends").mkdir()
    (package / "backends" / "mine.py").write_text("")
    assert manifest.commit()["dirty"] is True


def test_two_experiments_of_one_name_do_not_share_a_folder(write_experiment: Write, tmp_path: Path) -> None:
    folder = tmp_path / "r"
    first = write_experiment(back_ends=["DeadReckoning"])
    run_experiment(first, folder=folder, executor="serial")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    # A copy asks the same: its results are the same.
    copied = elsewhere / first.name
    copied.write_text(first.read_text())
    assert run_experiment(copied, folder=folder, executor="serial").manifest["jobs_run"] == 0
    # Of one seed too, and by a slamcmp that did not know all of today's settings.
    run_experiment(copied, folder=folder, executor="serial", seeds=[0])
    known = json.loads((folder / "manifest.json").read_text())
    del known["config"]["memory_limit_mb"], known["config"]["source"]["truth"]
    (folder / "manifest.json").write_text(json.dumps(known))
    assert run_experiment(first, folder=folder, executor="serial").manifest["jobs_run"] == 0
    for other in ({"sweep": {"source.steps": [4, 5]}}, {"question": "Another?"}, {"time_limit_s": 1.0}):
        copied.write_text(json.dumps({**json.loads(first.read_text()), **other}))
        with pytest.raises(UsageError, match="a different experiment of the same name"):
            manifest.require_same_experiment(load_experiment(copied), folder)
    # A file may change at its place.
    copied.write_text(first.read_text())
    run_experiment(copied, folder=folder, executor="serial")
    copied.write_text(first.read_text().replace("DeadReckoning", "Hindsight"))
    run_experiment(copied, folder=folder, executor="serial")
    message = rf"r holds the results of {copied}, a different experiment of the same name; .* --results"
    with pytest.raises(UsageError, match=message):
        run_experiment(first, folder=folder, executor="serial")
    assert list(load_results(folder).trials["label"]) == ["Hindsight"]
    run_experiment(first, folder=tmp_path / "other", executor="serial")
    # Nobody else is left to be confused with.
    copied.unlink()
    run_experiment(first, folder=folder, executor="serial")
    assert list(load_results(folder).trials["label"]) == ["DeadReckoning"]
