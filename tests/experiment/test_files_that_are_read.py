"""A result is named by the files that its source and its back end read, declared or not."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from slamcmp.experiment.runner import run_experiment
from slamcmp.results.store import Results
from tests.conftest import PLUGINS
from tests.experiment.test_changing_code import BACK_END, HEADER, write

SOURCE = """
from pathlib import Path
import numpy as np
from slamcmp.geometry import se2
from slamcmp.models.sensors import make_sensor
from slamcmp.registry import sources
from slamcmp.types import Detections, GroundTruth, Log, Problem
{extra}

def robot(bias):
    steps = 10
    t = np.arange(steps) * 1.0
    increments = np.tile(np.eye(3), (steps, 1, 1))
    increments[1:] = se2(1.0, 0.0, 0.0)
    truth = np.array([se2((1.0 + bias) * k, 0.0, 0.0) for k in range(steps)])
    Q = np.tile(np.diag([0.05, 0.05, 0.02]) ** 2, (steps, 1, 1))
    Q[0] = 0.0
    nothing = Detections(np.empty((0, 2)), np.empty((0, 2, 2)), np.empty(0, int))
    problem = Problem(np.eye(3), np.eye(3) * 1e-12, make_sensor("range_bearing", {{}}))
    return Log("own", problem, t, increments, Q, (nothing,) * steps,
               GroundTruth(t, truth, np.empty(0, int), np.empty((0, 2))))

HERE = Path(__file__).parent

{decorator}
def recorded(seed=0, *, path: str = "data.csv"):
    return robot({bias})
"""
"""Odometry too short by a number that is read; the stream does not hold it, only the truth does."""
READERS = {
    "pathlib": "float((HERE / path).read_text())",
    "open": "float(open(HERE / path).read())",
    "numpy": "float(np.loadtxt(HERE / path))",
    "memory map": "float(bytes(np.memmap(HERE / path, dtype='u1', mode='r')).decode())",
    "a relative path": "float(open(__import__('os').path.relpath(HERE / path)).read())",
    "whatever lies in the folder": "sum(float(f.read_text()) for f in HERE.glob('*.csv'))",
}


def write_source(folder: Path, bias: str, extra: str = "", decorator: str = "") -> Path:
    (folder / "own.py").write_text(SOURCE.format(bias=bias, extra=extra, decorator=decorator))
    (folder / "data.csv").write_text("0.05\n")
    return write(folder, f"{PLUGINS}:DeadReckoning", "own.py:recorded")


def ate(results: Results) -> float:
    return float(results.trials["online_ate"][0])


EXPECTED = float(np.sqrt(np.mean((0.05 * np.arange(10)) ** 2)))


@pytest.mark.parametrize("reader", list(READERS))
def test_data_that_nobody_declared_is_noticed_when_it_changes(tmp_path: Path, reader: str) -> None:
    path = write_source(tmp_path, READERS[reader])
    first = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert ate(first) == pytest.approx(EXPECTED)
    again = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert (again.manifest["jobs_run"], again.manifest["jobs_reused"]) == (0, 1)
    (tmp_path / "data.csv").write_text("0.5\n")
    changed = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert ate(changed) == pytest.approx(10 * EXPECTED)
    assert changed.manifest["jobs_reused"] == 0
    (tmp_path / "data.csv").write_text("0.05\n")
    assert ate(run_experiment(path, folder=tmp_path / "r", jobs=1)) == pytest.approx(EXPECTED)


def test_file_that_comes_later_is_noticed(tmp_path: Path) -> None:
    extra = "def value(path):\n    try:\n        return float(open(path).read())\n"
    extra += "    except OSError:\n        return 0.05\n"
    path = write_source(tmp_path, "value(HERE / 'later.csv')", extra)
    assert ate(run_experiment(path, folder=tmp_path / "r", jobs=1)) == pytest.approx(EXPECTED)
    (tmp_path / "later.csv").write_text("0.5\n")
    assert ate(run_experiment(path, folder=tmp_path / "r", jobs=1)) == pytest.approx(10 * EXPECTED)


def test_new_file_in_a_folder_is_noticed(tmp_path: Path) -> None:
    path = write_source(tmp_path, READERS["whatever lies in the folder"])
    run_experiment(path, folder=tmp_path / "r", jobs=1)
    (tmp_path / "more.csv").write_text("0.45\n")
    assert ate(run_experiment(path, folder=tmp_path / "r", jobs=1)) == pytest.approx(10 * EXPECTED)


@pytest.mark.parametrize(
    "decorator",
    [
        '@sources.register("own", files=lambda path: [HERE / path])',
        '@sources.register("own", files=["data.csv"])',
        '@sources.register("own", files="data.csv")',
    ],
)
def test_declared_files_are_part_of_the_key(tmp_path: Path, decorator: str) -> None:
    """Through a library that nobody sees reading: what the author declares counts."""
    path = write_source(tmp_path, READERS["open"], "import cv2\n", decorator)
    first = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert not [text for text in first.manifest["warnings"] if "anew" in text]
    assert run_experiment(path, folder=tmp_path / "r", jobs=1).manifest["jobs_run"] == 0
    (tmp_path / "data.csv").write_text("0.5\n")
    again = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert again.manifest["jobs_run"] == 2
    assert ate(again) == pytest.approx(10 * EXPECTED)


UNSEEN = {
    "a library in C": ("import cv2", "float(cv2.imread(str(HERE / 'image.png'))[0, 0, 0]) / 100"),
    "another program": (
        "import subprocess",
        "float(subprocess.check_output(['cat', str(HERE / path)]))",
    ),
}


@pytest.mark.parametrize("kind", list(UNSEEN))
def test_source_that_may_read_unseen_is_made_anew_each_time(tmp_path: Path, kind: str) -> None:
    import cv2

    extra, bias = UNSEEN[kind]
    path = write_source(tmp_path, bias, extra)
    cv2.imwrite(str(tmp_path / "image.png"), np.full((4, 4, 3), 5, np.uint8))
    first = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert ate(first) == pytest.approx(EXPECTED)
    assert any("files=" in text for text in first.manifest["warnings"])
    again = run_experiment(path, folder=tmp_path / "r", jobs=1)
    # The stream is made again; as it is the same, its run stands.
    assert (again.manifest["jobs_run"], again.manifest["jobs_reused"]) == (1, 1)
    cv2.imwrite(str(tmp_path / "image.png"), np.full((4, 4, 3), 50, np.uint8))
    (tmp_path / "data.csv").write_text("0.5\n")
    assert ate(run_experiment(path, folder=tmp_path / "r", jobs=1)) == pytest.approx(10 * EXPECTED)


def test_files_that_cannot_be_listed_are_one_clear_line(tmp_path: Path) -> None:
    from slamcmp.errors import MissingDataError, UsageError

    path = write_source(tmp_path, "0.05", decorator='@sources.register("own", files=lambda wrong: [])')
    with pytest.raises(UsageError, match="its 'files' cannot be listed: TypeError"):
        run_experiment(path, folder=tmp_path / "r", jobs=1)
    path = write_source(tmp_path, "0.05", decorator='@sources.register("own", files=["gone.csv"])')
    with pytest.raises(MissingDataError, match=r"there is no data file .*gone\.csv"):
        run_experiment(path, folder=tmp_path / "r", jobs=1)


def test_source_that_takes_no_seed_says_so(tmp_path: Path) -> None:
    from slamcmp.errors import UsageError

    path = write_source(tmp_path, "0.05", decorator='@sources.register("own", seeded=False)')
    assert run_experiment(path, folder=tmp_path / "r", jobs=1).trials["seed"].isna().all()
    content = json.loads(path.read_text())
    path.write_text(json.dumps({**content, "seeds": 12}))
    with pytest.raises(UsageError, match="takes no seed"):
        run_experiment(path, folder=tmp_path / "r", jobs=1)


def test_two_users_files_with_neighbours_of_one_name(tmp_path: Path) -> None:
    """A source and two back ends, each with a helper.py of its own, in one process and in several."""
    for name, value in (("a", "1.0"), ("b", "2.0")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "helper.py").write_text(f"VALUE = {value}\n")
        (tmp_path / name / "mine.py").write_text(
            HEADER
            + "import helper\n"
            + BACK_END.format(value="helper.VALUE + late()")
            + "def late():\n    import helper\n    return helper.VALUE\n"
        )
    path = tmp_path / "e.yaml"
    back_ends = [{"name": f"{name}/mine.py:Mine", "label": name} for name in "ab"]
    path.write_text(json.dumps({"source": {"name": f"{PLUGINS}:straight"}, "back_ends": back_ends}))
    for executor in ("serial", "processes"):
        results = run_experiment(path, folder=tmp_path / executor, jobs=1, executor=executor)
        assert set(results.trials["status"]) == {"ok"}, list(results.trials["message"])
        last = results.frames.groupby("label")["online_y"].last()
        assert dict(last) == {"a": 2.0, "b": 4.0}


def test_shipped_sources_read_only_what_they_declare(tmp_path: Path) -> None:
    """What a shipped source opens is in its key: nobody watches it when it runs."""
    from slamcmp.experiment.config.component import Component
    from slamcmp.experiment.content_key import data_files
    from slamcmp.experiment.job.make_stream import make_stream
    from slamcmp.support.provenance.opened_files import OpenedFiles, watched

    for name, parameters in (
        ("circle", {"steps": 5}),
        ("victoria_park", {}),
        ("graph_file", {"path": "w100.graph"}),
        ("kitti00_stereo", {"truth_optional": True}),
    ):
        source = Component("source", name, name, parameters)
        # numpy, scipy and gtsam are loaded before; what is opened from then on is data.
        make_stream(("circle", {"steps": 5}), ("labelled", {}), 0)
        with watched(OpenedFiles()) as opened:
            source.plugin().target(0, **parameters)
        assert set(opened.inputs({})) <= {str(Path(path)) for path in data_files(source).stamps}


UNSEEN_BACK_END = (
    "import cv2\n" + HEADER + "class Mine(DeadReckoning):\n"
    "    def __init__(self, problem):\n"
    "        super().__init__(problem)\n"
    "        self.value = {first}\n"
    "    def update(self, frame):\n"
    "        super().update(frame)\n"
    "        self.T = self.T.copy()\n"
    "        self.T[1, 2] = {later}\n"
    "HERE = Path(__file__).parent\n"
    "{extra}\n"
)
"""Does its arithmetic with a library in C; reads, if at all, in the constructor, in a frame, or on import."""
READ = "float(cv2.imread(str(HERE / 'image.png'))[0, 0, 0])"
BACK_ENDS_THAT_READ = {
    "in its constructor": {"first": READ, "later": "self.value"},
    "in a frame": {"first": "0", "later": f"({READ} if frame.k == 5 else 0)"},
    "on import": {"first": "AT_IMPORT", "later": "self.value", "extra": f"AT_IMPORT = {READ}"},
    "through a call of its own into C": {
        "first": "libc().fopen(str(HERE / 'image.png').encode(), b'r') and 5.0",
        "later": "self.value",
        "extra": "import ctypes\ndef libc():\n    c = ctypes.CDLL(None)\n"
        "    def fopen(path, mode):\n        c.fopen.restype = ctypes.c_void_p\n"
        "        f = ctypes.c_void_p(c.fopen(path, mode))\n        return c.fgetc(f)\n"
        "    return type('C', (), {'fopen': staticmethod(fopen)})\n",
    },
    "through another program": {
        "first": "len(subprocess.check_output(['cat', str(HERE / 'image.png')]))",
        "later": "self.value",
        "extra": "import subprocess",
    },
}


def write_reader(folder: Path, decorator: str = "", **parts: str) -> Path:
    import cv2

    text = UNSEEN_BACK_END.format(**{"extra": "", **parts})
    text = text.replace("class Mine", f"{decorator}class Mine") if decorator else text
    (folder / "mine.py").write_text(text)
    cv2.imwrite(str(folder / "image.png"), np.full((4, 4, 3), 5, np.uint8))
    return write(folder, "mine.py:Mine")


@pytest.mark.parametrize("where", list(BACK_ENDS_THAT_READ))
def test_back_end_that_reads_through_c_is_run_anew_each_time(tmp_path: Path, where: str) -> None:
    path = write_reader(tmp_path, **BACK_ENDS_THAT_READ[where])
    first = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert first.trials["status"].tolist() == ["ok"], first.trials["message"].tolist()
    assert [text for text in first.manifest["warnings"] if text.startswith("Mine is run anew")]
    again = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert (again.manifest["jobs_run"], again.manifest["jobs_reused"]) == (1, 0)


def test_library_in_c_that_reads_nothing_costs_no_result(tmp_path: Path) -> None:
    """It is imported, computes, and even reads a file that Python tells of."""
    arithmetic = "float(cv2.norm(np.full(4, json.load(open(HERE / 'one.json')))))"
    path = write_reader(tmp_path, first=arithmetic, later="self.value", extra="import json")
    (tmp_path / "one.json").write_text("1.5\n")
    first = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert first.frames["online_y"].iloc[-1] == pytest.approx(3.0)
    assert not [text for text in first.manifest["warnings"] if "anew" in text]
    again = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert (again.manifest["jobs_run"], again.manifest["jobs_reused"]) == (0, 1)
    (tmp_path / "one.json").write_text("2.5\n")
    changed = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert changed.frames["online_y"].iloc[-1] == pytest.approx(5.0)


def test_files_that_a_back_end_declares_are_part_of_its_key(tmp_path: Path) -> None:
    import cv2

    decorator = "from slamcmp.registry import back_ends\n@back_ends.register('mine', files=['image.png'])\n"
    path = write_reader(tmp_path, decorator, **BACK_ENDS_THAT_READ["in its constructor"])
    first = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert first.frames["online_y"].iloc[-1] == 5.0
    assert not [text for text in first.manifest["warnings"] if "anew" in text]
    assert run_experiment(path, folder=tmp_path / "r", jobs=1).manifest["jobs_run"] == 0
    cv2.imwrite(str(tmp_path / "image.png"), np.full((4, 4, 3), 50, np.uint8))
    again = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert again.frames["online_y"].iloc[-1] == 50.0
