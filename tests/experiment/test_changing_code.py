"""A result is named by the code that made it, also when it changes while an experiment runs."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from slamcmp.experiment.runner import run_experiment
from slamcmp.experiment.schedule import Schedule
from slamcmp.results.store import Results
from slamcmp.support.provenance.code_version import PACKAGE
from tests.conftest import PLUGINS

HEADER = "from tests.user_plugins import DeadReckoning\nfrom pathlib import Path\nimport numpy as np\n"
BACK_END = (
    "class Mine(DeadReckoning):\n"
    "    def update(self, frame):\n"
    "        super().update(frame)\n"
    "        self.T = self.T.copy()\n"
    "        self.T[1, 2] = {value}\n"
)
KINDS: dict[str, dict[str, str]] = {
    "the file itself": {"mine.py": HEADER + BACK_END.format(value="1.0"), "edited": "mine.py"},
    "a neighbour": {
        "mine.py": HEADER + "from helper import VALUE\n" + BACK_END.format(value="VALUE"),
        "helper.py": "VALUE = 1.0\n",
        "edited": "helper.py",
    },
    "a neighbour imported inside a function": {
        "mine.py": HEADER
        + BACK_END.format(value="late()")
        + "def late():\n    import helper\n    return helper.VALUE\n",
        "helper.py": "VALUE = 1.0\n",
        "edited": "helper.py",
    },
    "a neighbour's neighbour in a package": {
        "mine.py": HEADER + "from pack import VALUE\n" + BACK_END.format(value="VALUE"),
        "pack/__init__.py": "from .inner import VALUE\n",
        "pack/inner.py": "import importlib\nVALUE = importlib.import_module('deep').VALUE\n",
        "deep.py": "VALUE = 1.0\n",
        "edited": "deep.py",
    },
    "a resource that it reads": {
        "mine.py": HEADER
        + "VALUE = float((Path(__file__).parent / 'value.txt').read_text())\n"
        + BACK_END.format(value="VALUE"),
        "value.txt": "1.0\n",
        "edited": "value.txt",
    },
    "a resource through numpy": {
        "mine.py": HEADER
        + "VALUE = float(np.loadtxt(Path(__file__).parent / 'value.txt'))\n"
        + BACK_END.format(value="VALUE"),
        "value.txt": "1.0\n",
        "edited": "value.txt",
    },
}


@pytest.fixture(params=list(KINDS))
def folder(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, Path]:
    """A folder with an experiment, and the file of it that changes."""
    files = dict(KINDS[request.param])
    edited = files.pop("edited")
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    write(tmp_path, "mine.py:Mine")
    return tmp_path, tmp_path / edited


def write(folder: Path, back_end: str, source: str = f"{PLUGINS}:straight", **fields: object) -> Path:
    path = folder / "e.yaml"
    content = {"source": {"name": source}, "back_ends": [{"name": back_end}], **fields}
    path.write_text(json.dumps(content))
    return path


def values(results: Results) -> dict[int, float]:
    """What the code said, of each seed that has a result."""
    last = results.frames.groupby("seed")["online_y"].last()
    return {int(seed): float(value) for seed, value in last.items()}


def test_what_changed_between_two_runs_is_noticed(folder: tuple[Path, Path]) -> None:
    place, edited = folder
    assert values(run_experiment(place / "e.yaml", folder=place / "r", jobs=1)) == {0: 1.0}
    again = run_experiment(place / "e.yaml", folder=place / "r", jobs=1)
    assert (again.manifest["jobs_run"], values(again)) == (0, {0: 1.0})
    edited.write_text(edited.read_text().replace("1.0", "2.0"))
    assert values(run_experiment(place / "e.yaml", folder=place / "r", jobs=1)) == {0: 2.0}


def test_no_table_holds_two_codes(folder: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """Edited after the first run of three, then the edit is taken back."""
    place, edited = folder
    path = write(place, "mine.py:Mine", seeds=3)
    before, finish = edited.read_text(), Schedule._finish

    def edit(self, ended) -> None:
        finish(self, ended)
        if ended.task.kind == "run":
            edited.write_text(before.replace("1.0", "2.0"))

    with monkeypatch.context() as patched:
        patched.setattr(Schedule, "_finish", edit)
        results = run_experiment(path, folder=place / "r", jobs=1)
    missing = results.trials[results.trials["status"] == "missing"]
    assert set(results.trials["status"]) == {"ok", "missing"}
    assert results.manifest["jobs_missing"] == len(missing)
    assert missing["message"].str.contains(edited.name).all()
    assert len(set(values(results).values())) == 1
    edited.write_text(before)
    again = run_experiment(path, folder=place / "r", jobs=1)
    assert list(again.trials["status"]) == ["ok"] * 3
    assert values(again) == {0: 1.0, 1: 1.0, 2: 1.0}


def test_file_that_is_broken_while_it_is_edited_is_no_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mine = tmp_path / "mine.py"
    mine.write_text(
        HEADER + BACK_END.format(value="late()") + "def late():\n    import helper\n    return 1.0\n"
    )
    (tmp_path / "helper.py").write_text("")
    path = write(tmp_path, "mine.py:Mine", seeds=2)
    finish = Schedule._finish

    def edit(self, ended) -> None:
        finish(self, ended)
        if ended.task.kind == "run":
            (tmp_path / "helper.py").write_text("def half(:\n")

    with monkeypatch.context() as patched:
        patched.setattr(Schedule, "_finish", edit)
        results = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert list(results.trials["status"]) == ["ok", "missing"]
    (tmp_path / "helper.py").write_text("")
    assert set(run_experiment(path, folder=tmp_path / "r", jobs=1).trials["status"]) == {"ok"}


def test_package_that_is_edited_between_two_runs_of_one_process(tmp_path: Path) -> None:
    """As in a notebook: workers run the new text, and what runs in this process says that it is old."""
    copy = tmp_path / "copy"
    shutil.copytree(PACKAGE, copy / "slamcmp", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "e.yaml").write_text(
        "source: {name: circle, steps: 8, landmarks: 3}\nback_ends: [{name: dead_reckoning}]\n"
    )
    script = tmp_path / "notebook.py"
    script.write_text(
        "import json, sys\nfrom pathlib import Path\n"
        "from slamcmp.experiment.runner import run_experiment\n"
        "def run(name, **options):\n"
        "    found = run_experiment('e.yaml', folder=name, jobs=1, **options)\n"
        "    x = float(found.frames['online_x'].iloc[-1]) if len(found.frames) else None\n"
        "    return [found.trials['status'][0], x, found.trials['message'][0]]\n"
        "told = [run('r'), run('serial', executor='serial')]\n"
        "file = Path('copy/slamcmp/backends/dead_reckoning.py')\n"
        "text = file.read_text()\n"
        "new = text.replace('return Estimate(self._T,', 'return Estimate(self._T @ self._T,')\n"
        "assert new != text, text\n"
        "file.write_text(new)\n"
        "told += [run('r'), run('serial', executor='serial')]\n"
        "file.write_text(text)\n"
        "told += [run('r'), run('serial', executor='serial')]\n"
        "print(json.dumps(told))\n"
    )
    ran = subprocess.run(
        [sys.executable, script],
        cwd=tmp_path,
        env={**_environment(), "PYTHONPATH": str(copy)},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert ran.returncode == 0, ran.stderr
    first, serial, edited, serial_edited, back, serial_back = json.loads(ran.stdout)
    assert first == serial == back == serial_back
    assert first[0] == edited[0] == "ok"
    assert abs(edited[1] - first[1]) > 0.1
    assert serial_edited[0] == "missing"
    assert "dead_reckoning.py" in serial_edited[2]
    assert "start Python anew" in serial_edited[2]


def _environment() -> dict[str, str]:
    return {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
