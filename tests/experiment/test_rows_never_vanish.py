"""Whatever happens to files and memory, each run that was come to is a row with its status."""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from slamcmp.experiment import schedule, stop_search
from slamcmp.experiment.gathering import tables
from slamcmp.experiment.planning import plan
from slamcmp.experiment.runner import run_experiment
from slamcmp.experiment.schedule import Schedule
from slamcmp.registry import back_ends
from slamcmp.report import html
from slamcmp.results.runs.run_file import load_run
from slamcmp.results.store import Results, load_results
from slamcmp.support.messages import LIMIT, describe, told

Write = Callable[..., Path]
EDGES = Path(__file__).with_name("edge_plugins.py")


def edge(name: str, label: str | None = None, **parameters: object) -> dict[str, object]:
    """The entry of a back end of ``edge_plugins.py``; ``write_experiment`` puts another path before it."""
    return {"name": f"{EDGES}:{name}", **({"label": label} if label else {}), **parameters}


def write_edges(folder: Path, *back_ends: dict[str, object], **fields: object) -> Path:
    path = folder / "edges.yaml"
    source = {"name": f"{EDGES.parents[1] / 'user_plugins.py'}:straight"}
    path.write_text(json.dumps({"source": source, "back_ends": list(back_ends), **fields}))
    return path


def after_each_run(monkeypatch: pytest.MonkeyPatch, action: Callable[[], object]) -> None:
    finish = Schedule._finish

    def finish_and_act(self, ended) -> None:
        finish(self, ended)
        if ended.task.kind == "run":
            action()

    monkeypatch.setattr(Schedule, "_finish", finish_and_act)


def assert_all_there(results: Results, runs: int, missing: int) -> None:
    assert len(results.trials) == runs
    assert (results.trials["status"] == "missing").sum() == missing
    assert (results.trials["message"][results.trials["status"] == "missing"] != "").all()
    assert results.manifest["jobs_missing"] == missing
    assert list(load_results(results.folder).trials["status"]) == list(results.trials["status"])


@pytest.mark.parametrize(("gone", "missing"), [("runs", 3), ("streams", 3), (".", 3)])
def test_folder_that_is_deleted_under_a_run(
    write_experiment: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, gone: str, missing: int
) -> None:
    """After the second of three runs."""
    path = write_experiment(back_ends=["DeadReckoning"], seeds=3)
    folder = tmp_path / "r"
    done = []

    def delete() -> None:
        done.append(1)
        if len(done) == 2:
            shutil.rmtree(folder / gone)

    with monkeypatch.context() as patched:
        after_each_run(patched, delete)
        results = run_experiment(path, folder=folder, jobs=1)
    # The third run found its stream made before or made anew: what is left of the others is a row.
    found = int((results.trials["status"] == "missing").sum())
    assert 2 <= found <= missing
    assert_all_there(results, 3, found)
    again = run_experiment(path, folder=folder, jobs=1)
    assert_all_there(again, 3, 0)
    fresh = run_experiment(path, folder=tmp_path / "fresh", jobs=1)
    np.testing.assert_array_equal(again.trials["online_ate"], fresh.trials["online_ate"])


def test_stream_that_is_gone_or_damaged_when_a_run_begins(write_experiment: Write, tmp_path: Path) -> None:
    folder = tmp_path / "r"
    run_experiment(write_experiment(back_ends=["DeadReckoning"]), folder=folder, jobs=1)
    (stream,) = [each for each in (folder / "streams").iterdir() if "truth" not in each.name]
    path = write_experiment(back_ends=["DeadReckoning", "Hindsight"])
    for executor, content in (("processes", stream.read_bytes()[:200]), ("serial", b"")):
        stream.write_bytes(content)
        results = run_experiment(path, folder=folder, jobs=1, executor=executor)
        assert list(results.trials["status"]) == ["ok", "missing"], results.trials["message"][1]
        assert results.manifest["jobs_missing"] == 1
    # It is made again by the same command: a damaged one is removed by who meets it.
    assert list(run_experiment(path, folder=folder, jobs=1).trials["status"]) == ["ok", "ok"]


@pytest.mark.parametrize("damage", ["cut", "emptied", "a folder"])
def test_result_that_cannot_be_read_any_more(
    write_experiment: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, damage: str
) -> None:
    path = write_experiment(back_ends=["DeadReckoning", "Hindsight"])
    folder = tmp_path / "r"

    def spoil() -> None:
        for file in (folder / "runs").glob("*.npz"):
            if damage == "a folder" and file.is_file():
                file.unlink()
                file.mkdir()
            elif damage != "a folder":
                file.write_bytes(file.read_bytes()[:500] if damage == "cut" else b"")

    with monkeypatch.context() as patched:
        after_each_run(patched, spoil)
        results = run_experiment(path, folder=folder, jobs=1)
    assert_all_there(results, 2, 2)
    for file in (folder / "runs").glob("*.npz"):
        if file.is_dir():
            file.rmdir()
    assert_all_there(run_experiment(path, folder=folder, jobs=1), 2, 0)


@pytest.mark.parametrize("function", ["load_run", "load_truth", "score", "frame_table", "concat"])
def test_memory_that_ends_while_results_are_gathered(
    write_experiment: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, function: str
) -> None:
    path = write_experiment(back_ends=["DeadReckoning", "Hindsight"])
    whole = run_experiment(path, folder=tmp_path / "r", jobs=1)

    def fail(*_: object, **__: object) -> None:
        raise MemoryError

    with monkeypatch.context() as patched:
        if function == "concat":
            patched.setattr("pandas.concat", fail)
        elif function == "score":
            patched.setattr(tables.Inspector, "findings", fail)
        else:
            patched.setattr(tables, function, fail)
        results = run_experiment(path, folder=tmp_path / "r", jobs=1)
    if function == "concat":
        assert list(results.trials["status"]) == ["ok", "ok"]
        assert any("not enough memory" in text for text in results.manifest["warnings"])
        assert len(results.frames) == 0
    else:
        assert_all_there(results, 2, 2)
        assert results.trials["message"].str.contains("not enough memory").all()
    again = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert again.manifest["jobs_run"] == 0
    assert len(again.frames) == len(whole.frames) == 80


@pytest.mark.parametrize("module", [plan, stop_search], ids=lambda module: module.__name__)
def test_memory_that_ends_before_or_after_results_are_gathered(
    write_experiment: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: ModuleType
) -> None:
    until = {"metric": "online_ate", "half_width": 100.0, "batch": 2, "max_seeds": 2}
    path = write_experiment(back_ends=["DeadReckoning", "Hindsight"], until=until)
    run_experiment(path, folder=tmp_path / "r", jobs=1)

    def fail(*_: object, **__: object) -> None:
        raise MemoryError

    with monkeypatch.context() as patched:
        patched.setattr(module, "load_truth", fail)
        results = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert_all_there(results, 4, 0)
    assert (results.trials["status"] == "ok").all()


def test_texts_that_files_and_tables_find_hard_to_hold(tmp_path: Path) -> None:
    what = ["surrogate", "long", "unprintable", "base"]
    path = write_edges(tmp_path, *(edge("Says", label=each, what=each) for each in what))
    for executor in ("processes", "serial"):
        results = run_experiment(path, folder=tmp_path / executor, jobs=2, executor=executor)
        assert list(results.trials["status"]) == ["crashed"] * 4
        stored = load_results(tmp_path / executor).trials.set_index("label")["message"]
        assert stored["surrogate"].startswith("frame 20: ValueError: a name like \\ud800\\udfff.txt and a ")
        assert stored["long"].startswith("frame 20: ValueError: yyyy")
        assert "RuntimeError" in stored["unprintable"]
        assert stored["base"].startswith("frame 20: BaseException: of no usual kind")
        for message in stored:
            assert len(message.encode()) <= LIMIT


def test_what_one_back_end_does_ends_no_other(tmp_path: Path) -> None:
    """Each of these once ended the whole experiment, without tables, as if the disk were full."""
    names = ["Late", "ClosesFiles", "NamesOddly", "NamesOddlyAndDies"]
    path = write_edges(tmp_path, edge("Late", at=1000), *map(edge, names[1:]))
    results = run_experiment(path, folder=tmp_path / "r", jobs=2)
    rows = load_results(results.folder).trials.set_index("label")
    assert rows["status"].to_dict() == dict(zip(names, ["ok", "crashed", "ok", "crashed"], strict=True))
    assert rows.loc["NamesOddlyAndDies", "completion"] == 0.5
    assert "exit code 3" in rows.loc["NamesOddlyAndDies", "message"]
    frames = results.frames[results.frames["label"] == "NamesOddly"]
    odd = [name for name in frames.columns if name.startswith(("x\\ud800", "yyy", "a/../b", "plain"))]
    assert len(odd) == 4
    for name in (*odd, ""):
        np.testing.assert_array_equal(frames[name], np.arange(1.0, 41.0))
    assert max(map(len, frames.columns)) < 300


def test_remains_that_cannot_be_kept_cost_one_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_arguments: object, **_options: object) -> None:
        raise RuntimeError("nothing of it can be used")

    monkeypatch.setattr(schedule, "recovered", fails)
    path = write_edges(tmp_path, edge("Late", at=1000), edge("NamesOddlyAndDies"))
    results = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert results.trials["status"].tolist() == ["ok", "crashed"]
    assert "what it left cannot be kept: RuntimeError: nothing of it" in results.trials["message"][1]


@pytest.mark.skipif(sys.platform == "darwin", reason="its file systems take valid Unicode only")
def test_files_whose_names_are_no_valid_unicode(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / os.fsdecode(b"f\xff")
    folder.mkdir()
    path = write_edges(folder, edge("Late", at=1000)).rename(folder / os.fsdecode(b"e\xff.yaml"))
    own = folder / os.fsdecode(b"b\xff.py")
    own.write_text("from tests.user_plugins import DeadReckoning\nclass Own(DeadReckoning):\n    pass\n")
    assert back_ends.get(f"{own}:Own").name == "b\\udcff.py:Own"
    results = run_experiment(path, folder=folder / "r", jobs=1)
    assert load_results(results.folder).trials["status"].tolist() == ["ok"]
    # Of the page only the writing: drawing it takes seconds.
    monkeypatch.setattr(html, "report_html", lambda results: f"<p>{results.folder}")
    page = html.write_report(results, folder / "report.html").read_text(encoding="utf-8")
    assert page.endswith("f?/r")


def test_any_text_becomes_one_that_can_be_stored() -> None:
    for text in ("\ud800" * 5, "ä" * 10_000, "\0", "", "😀" * 3000):
        short = told(text)
        assert len(short.encode("utf-8")) <= LIMIT
        assert "\0" not in short
    assert told("x" * LIMIT) == "x" * LIMIT
    assert told("x" * (LIMIT + 1)).endswith(f"({LIMIT + 1} bytes in all)")
    assert len(describe(ValueError("z" * 10**6)).encode()) <= LIMIT


def test_kill_of_a_stream_is_run_again(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(
        "import os, signal\nfrom pathlib import Path\nfrom tests.user_plugins import straight\n"
        "def once(seed=0):\n"
        "    marker = Path(__file__).with_name('marker')\n"
        "    if not marker.exists():\n"
        "        marker.write_text('')\n"
        "        os.kill(os.getpid(), signal.SIGKILL)\n"
        "    return straight(seed)\n"
    )
    path = write_edges(tmp_path, edge("Late", label="x", at=1000))
    path.write_text(json.dumps({**json.loads(path.read_text()), "source": {"name": "own.py:once"}}))
    results = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert list(results.trials["status"]) == ["killed"]
    assert results.trials["message"][0].startswith("no stream: the worker process was killed by SIGKILL")
    assert results.manifest["jobs_missing"] == 1
    assert list(run_experiment(path, folder=tmp_path / "r", jobs=1).trials["status"]) == ["ok"]


def test_kill_from_outside_keeps_its_frames_and_is_run_again(tmp_path: Path) -> None:
    for number in (9, 15):
        marker = tmp_path / f"marker{number}"
        path = write_edges(tmp_path, edge("KilledOnce", marker=str(marker), number=number))
        folder = tmp_path / f"r{number}"
        results = run_experiment(path, folder=folder, jobs=1)
        assert (results.trials["status"][0], results.trials["completion"][0]) == ("killed", 0.5)
        assert len(results.frames) == 20
        (stored,) = (folder / "runs").glob("*.npz")
        assert load_run(stored).run.status == "killed"
        again = run_experiment(path, folder=folder, jobs=1)
        assert list(again.trials["status"]) == ["ok"]
        assert len(again.frames) == 40
