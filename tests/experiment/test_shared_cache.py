"""The cache that all experiments share: what it gives, what it must not give, and that it harms nothing."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from slamcmp.experiment import shared_cache
from slamcmp.experiment.runner import run_experiment
from slamcmp.experiment.shared_cache import SharedCache, cache_folder
from slamcmp.results.store import Results
from tests.command import Command

Write = Callable[..., Path]


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SharedCache:
    """An empty one, in use."""
    monkeypatch.setenv("SLAMCMP_CACHE", str(tmp_path / "cache"))
    return SharedCache(tmp_path / "cache")


def ran(experiment: Path, folder: Path, **options: Any) -> Results:
    return run_experiment(experiment, folder=folder, executor="serial", **options)


def counts(results: Results) -> tuple[int, int]:
    return results.manifest["jobs_run"], results.manifest["jobs_from_cache"]


def test_another_folder_computes_nothing_anew(
    cache: SharedCache, write_experiment: Write, tmp_path: Path
) -> None:
    experiment = write_experiment(back_ends=["DeadReckoning", "Hindsight"], seeds=2)
    first = ran(experiment, tmp_path / "one")
    again = ran(experiment, tmp_path / "two")
    assert counts(first) == (6, 0)
    assert counts(again) == (0, 4)
    assert again.manifest["jobs_reused"] == 4
    # Times too: they are those of then.
    assert again.trials.equals(first.trials)
    assert again.frames.equals(first.frames)
    assert cache.content().runs == 4
    assert cache.content().streams == 2


def test_another_experiment_takes_what_is_the_same_and_computes_the_rest(
    cache: SharedCache, write_experiment: Write, tmp_path: Path
) -> None:
    ran(write_experiment("first", back_ends=["DeadReckoning"], seeds=2), tmp_path / "first")
    other = write_experiment(
        "second", back_ends=[{"name": "DeadReckoning", "label": "dr"}, "Hindsight"], seeds=3
    )
    found = ran(other, tmp_path / "second")
    # Two streams and two runs are known: one stream and four runs are left.
    assert counts(found) == (5, 2)
    assert found.trials["status"].eq("ok").all()
    assert set(found.trials["label"]) == {"dr", "Hindsight"}


def test_without_the_cache_nothing_is_taken_or_kept(
    cache: SharedCache, write_experiment: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment = write_experiment(back_ends=["DeadReckoning"])
    ran(experiment, tmp_path / "one", cache=False)
    assert not cache.folder.exists()
    ran(experiment, tmp_path / "two")
    assert counts(ran(experiment, tmp_path / "three", cache=False)) == (2, 0)
    monkeypatch.setenv("SLAMCMP_CACHE", "off")
    assert counts(ran(experiment, tmp_path / "four")) == (2, 0)


def test_a_changed_back_end_or_parameter_is_another_result(
    cache: SharedCache, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = tmp_path / "own.py"
    text = (
        "from tests.user_plugins import DeadReckoning\n"
        "class Own(DeadReckoning):\n"
        "    def __init__(self, problem, *, gain: float = 1.0):\n"
        "        super().__init__(problem)\n"
    )
    own.write_text(text)

    def run(folder: str, **parameters: float) -> tuple[int, int]:
        path = tmp_path / "own.yaml"
        source = {"name": f"{Path(__file__).parents[1] / 'user_plugins.py'}:straight"}
        path.write_text(json.dumps({"source": source, "back_ends": [{"name": f"{own}:Own", **parameters}]}))
        return counts(run_experiment(path, folder=tmp_path / folder, jobs=1))

    assert run("a") == (2, 0)
    assert run("b") == (0, 1)
    assert run("c", gain=2.0) == (1, 0)
    own.write_text(text + "        self.more = 1\n")
    assert run("d") == (1, 0)


def test_a_run_that_read_a_file_is_taken_only_while_the_file_is_the_same(
    cache: SharedCache, tmp_path: Path
) -> None:
    (tmp_path / "gains.txt").write_text("1.0")
    (tmp_path / "own.py").write_text(
        "from pathlib import Path\n"
        "from tests.user_plugins import DeadReckoning\n"
        "class Own(DeadReckoning):\n"
        "    def __init__(self, problem):\n"
        "        super().__init__(problem)\n"
        f"        self.gain = float(open({str(tmp_path / 'gains.txt')!r}).read())\n"
    )
    path = tmp_path / "own.yaml"
    source = {"name": f"{Path(__file__).parents[1] / 'user_plugins.py'}:straight"}
    path.write_text(json.dumps({"source": source, "back_ends": [{"name": f"{tmp_path / 'own.py'}:Own"}]}))
    run_experiment(path, folder=tmp_path / "a", jobs=1)
    assert counts(run_experiment(path, folder=tmp_path / "b", jobs=1)) == (0, 1)
    (tmp_path / "gains.txt").write_text("2.0")
    assert counts(run_experiment(path, folder=tmp_path / "c", jobs=1)) == (1, 0)


@pytest.mark.parametrize(("back_end", "shared"), [("DivergesAtThree", True), ("RaisesAtThree", False)])
def test_only_what_the_key_decides_is_shared(
    back_end: str, shared: bool, cache: SharedCache, tmp_path: Path
) -> None:
    """A crash may be the machine's doing: another folder tries again."""
    (tmp_path / "own.py").write_text(
        "from slamcmp.errors import DivergedError\n"
        "from tests.user_plugins import DeadReckoning\n"
        "class DivergesAtThree(DeadReckoning):\n"
        "    def update(self, frame):\n"
        "        super().update(frame)\n"
        "        if frame.k == 3:\n"
        "            print('at three')\n"
        "            raise DivergedError('far away')\n"
        "class RaisesAtThree(DeadReckoning):\n"
        "    def update(self, frame):\n"
        "        super().update(frame)\n"
        "        if frame.k == 3:\n"
        "            raise ValueError('no')\n"
    )
    path = tmp_path / "own.yaml"
    source = {"name": f"{Path(__file__).parents[1] / 'user_plugins.py'}:straight"}
    path.write_text(
        json.dumps({"source": source, "back_ends": [{"name": f"{tmp_path / 'own.py'}:{back_end}"}]})
    )
    first = run_experiment(path, folder=tmp_path / "a")
    again = run_experiment(path, folder=tmp_path / "b")
    assert again.manifest["jobs_from_cache"] == shared
    assert again.manifest["jobs_run"] == (not shared)
    assert again.trials[["status", "message"]].equals(first.trials[["status", "message"]])
    if shared:
        # What it printed is where a reader looks for it.
        logs = [{log.name: log.read_text() for log in (tmp_path / each / "logs").iterdir()} for each in "ab"]
        assert "at three" in "".join(logs[0].values())
        assert {name: text for name, text in logs[0].items() if "at three" in text}.items() <= logs[1].items()
        tried = run_experiment(path, folder=tmp_path / "b", rerun_failed=True)
        assert tried.manifest["jobs_run"] == 1


@pytest.mark.parametrize("spoil", ["empty", "cut", "other"])
def test_a_damaged_file_is_as_if_it_were_not_there(
    spoil: str, cache: SharedCache, write_experiment: Write, tmp_path: Path
) -> None:
    experiment = write_experiment(back_ends=["DeadReckoning", "Hindsight"])
    first = ran(experiment, tmp_path / "one")
    for path in sorted((cache.folder / "runs").glob("*.npz"))[:1]:
        content = path.read_bytes()
        # Not in place: the results folder has the same file.
        path.unlink()
        path.write_bytes({"empty": b"", "cut": content[: len(content) // 2], "other": b"no archive"}[spoil])
    again = ran(experiment, tmp_path / "two")
    assert counts(again) == (1, 1)
    columns = ["label", "status", "online_ate"]
    assert again.trials[columns].equals(first.trials[columns])
    # And it is mended.
    assert counts(ran(experiment, tmp_path / "three")) == (0, 2)


def test_clearing_or_deleting_leaves_results_folders_whole(
    cache: SharedCache, write_experiment: Write, tmp_path: Path
) -> None:
    experiment = write_experiment(back_ends=["DeadReckoning"])
    ran(experiment, tmp_path / "one")
    (cache.folder / "mine.txt").write_text("not the cache's")
    held = cache.clear()
    assert (held.runs, held.streams) == (1, 1)
    assert [path.name for path in cache.folder.iterdir()] == ["mine.txt"]
    assert ran(experiment, tmp_path / "one").manifest["jobs_run"] == 0
    # What the folder keeps is not put back: nothing was computed.
    assert cache.content().runs == 0


def test_a_cache_that_cannot_be_written_costs_nothing(
    write_experiment: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("SLAMCMP_CACHE", str(tmp_path / "file" / "cache"))
    found = ran(write_experiment(back_ends=["DeadReckoning"]), tmp_path / "one")
    assert found.trials["status"].tolist() == ["ok"]
    assert counts(found) == (2, 0)


def test_the_oldest_go_where_there_is_no_room(
    cache: SharedCache, write_experiment: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment = write_experiment(back_ends=["DeadReckoning"], seeds=4)
    ran(experiment, tmp_path / "one")
    old = sorted((cache.folder / "runs").iterdir())[0]
    for path in cache.folder.glob("*/*"):
        os.utime(path, (2e9, 2e9))
    os.utime(old, (1e9, 1e9))
    monkeypatch.setattr(shared_cache, "LIMIT_BYTES", cache.content().size_bytes)
    ran(write_experiment(back_ends=["Hindsight"], seeds=1), tmp_path / "two")
    assert not old.exists()
    assert cache.content().size_bytes <= shared_cache.LIMIT_BYTES


def test_where_it_is(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("SLAMCMP_CACHE")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_folder() == tmp_path / ".cache" / "slamcmp"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert cache_folder() == tmp_path / "xdg" / "slamcmp"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    assert cache_folder() == tmp_path / ".cache" / "slamcmp"
    monkeypatch.setenv("SLAMCMP_CACHE", "~/mine")
    assert cache_folder() == tmp_path / "mine"
    for off in ("off", "OFF", ""):
        monkeypatch.setenv("SLAMCMP_CACHE", off)
        assert cache_folder() is None


class TestTheCommand:
    """``slamcmp cache`` and what ``slamcmp run`` says of it."""

    @pytest.fixture
    def slamcmp(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> Command:
        return Command(tmp_path, monkeypatch, capsys)

    def test_path_info_and_clear(
        self, slamcmp: Command, cache: SharedCache, write_experiment: Write, tmp_path: Path
    ) -> None:
        assert slamcmp("cache", "path") == (0, f"{cache.folder}\n", "")
        assert json.loads(slamcmp("cache", "info", "--json")[1])["runs"] == 0
        experiment = str(write_experiment(back_ends=["DeadReckoning"]))
        run = ("run", experiment, "--no-report", "--executor", "serial")
        assert slamcmp(*run, "--results", "a")[0] == 0
        planned = json.loads(slamcmp(*run, "--results", "b", "--dry-run", "--json")[1])
        assert (len(planned["runs_to_do"]), planned["runs_in_cache"]) == (1, 1)
        assert "(1 of them are in the shared cache)" in slamcmp(*run, "--results", "b", "--dry-run")[1]
        assert not (tmp_path / "b").exists()
        code, _, said = slamcmp(*run, "--results", "b")
        assert code == 0
        assert "1 runs are from the shared cache" in said
        assert "shared cache" not in slamcmp(*run, "--results", "c", "--no-cache")[2]
        told = json.loads(slamcmp("cache", "info", "--json")[1])
        assert {"folder", "runs", "streams", "size_bytes", "limit_bytes"} <= told.keys()
        assert told["size_bytes"] > 1000
        assert slamcmp("cache", "clear")[1].startswith("removed: 1 runs, 1 streams, ")
        assert slamcmp("cache", "clear")[1].startswith("removed: 0 runs")

    def test_where_it_is_off_the_command_says_so(
        self, slamcmp: Command, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setenv("SLAMCMP_CACHE", "off")
        code, _, said = slamcmp("cache", "info")
        assert code == 2
        assert said.startswith("slamcmp: the shared cache is off")

    def test_a_class_of_a_program_is_never_kept(self, cache: SharedCache, tmp_path: Path) -> None:
        import slamcmp
        from tests.user_plugins import DeadReckoning

        class Mine(DeadReckoning):
            pass

        given = {"source": {"name": "circle", "landmarks": 5, "steps": 5}, "back_ends": [Mine]}
        slamcmp.run(given, folder=tmp_path / "a", progress=False)
        assert cache.content().runs == 0
        assert cache.content().streams == 1
