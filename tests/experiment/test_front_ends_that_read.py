"""A front end of one's own on a shipped source: what it reads is noticed as a source's files are."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from slamcmp.experiment.runner import run_experiment
from slamcmp.results.store import Results
from tests.conftest import PLUGINS

FRONT_END = """
import dataclasses
from pathlib import Path
import numpy as np
from slamcmp.frontend.labelled import labelled
from slamcmp.registry import front_ends
{extra}
HERE = Path(__file__).parent

{decorator}
def mine(log, seed):
    stream = labelled(log, seed)
    frames = [dataclasses.replace(each, Q=each.Q * {factor}) for each in stream.frames]
    return dataclasses.replace(stream, frames=tuple(frames))
"""
"""It states the odometry's covariance larger by a number that it reads."""


def write(folder: Path, factor: str, extra: str = "", decorator: str = "") -> Path:
    (folder / "own.py").write_text(FRONT_END.format(factor=factor, extra=extra, decorator=decorator))
    fill(folder, 4)
    path = folder / "e.yaml"
    content = {
        "source": {"name": "circle", "steps": 5},
        "front_end": {"name": "own.py:mine"},
        "back_ends": [{"name": f"{PLUGINS}:DeadReckoning"}],
        "seeds": 1,
    }
    path.write_text(json.dumps(content))
    return path


def fill(folder: Path, value: int) -> None:
    """The number in every format."""
    import cv2
    import pandas as pd

    cv2.imwrite(str(folder / "image.png"), np.full((4, 4, 3), value, np.uint8))
    np.array([value], dtype=np.float64).tofile(folder / "raw.bin")
    np.save(folder / "array.npy", np.array([float(value)]))
    (folder / "data.csv").write_text(f"factor\n{value}\n")
    pd.DataFrame({"factor": [float(value)]}).to_parquet(folder / "data.parquet")
    pd.DataFrame({"factor": [float(value)]}).to_feather(folder / "data.feather", compression="uncompressed")
    (folder / "graph.g2o").write_text(f"VERTEX_SE2 0 {value} 0 0\nVERTEX_SE2 1 0 0 0\n")


def digest(results: Results) -> str:
    return str(results.trials["digest"][0])


SEEN = {
    "fromfile": ("", "float(np.fromfile(HERE / 'raw.bin')[0])"),
    "fromfile of an open file": ("", "float(np.fromfile(open(HERE / 'raw.bin', 'rb'))[0])"),
    "numpy, mapped": ("", "float(np.load(HERE / 'array.npy', mmap_mode='r')[0])"),
    "mmap": (
        "import mmap, os",
        "float(np.frombuffer(mmap.mmap(os.open(HERE / 'raw.bin', os.O_RDONLY), 8, access=1))[0])",
    ),
}
UNSEEN = {
    "OpenCV": ("import cv2", "float(cv2.imread(str(HERE / 'image.png'))[0, 0, 0])"),
    "OpenCV by another way": (
        "import importlib\n",
        "float(importlib.import_module('cv2').imread(str(HERE / 'image.png'))[0, 0, 0])",
    ),
    "OpenCV on import": (
        "import cv2\nVALUE = cv2.imread(str(__import__('pathlib').Path(__file__).parent / 'image.png'))",
        "float(VALUE[0, 0, 0])",
    ),
    "GTSAM": (
        "import gtsam",
        "gtsam.readG2o(str(HERE / 'graph.g2o'), False)[1].atPose2(0).x()",
    ),
    "Parquet": ("import pyarrow.parquet as pq", "pq.read_table(HERE / 'data.parquet')[0][0].as_py()"),
    "mapped and let go": (
        "import pyarrow as pa, pyarrow.ipc",
        "float(pa.ipc.open_file(pa.memory_map(str(HERE / 'data.feather'))).read_all()[0][0].as_py())",
    ),
    "another program": (
        "import subprocess",
        "float(subprocess.check_output(['tail', '-n1', str(HERE / 'data.csv')]))",
    ),
}


@pytest.mark.parametrize("reader", list(SEEN))
def test_what_python_tells_of_is_recorded(tmp_path: Path, reader: str) -> None:
    path = write(tmp_path, SEEN[reader][1], SEEN[reader][0])
    first = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert not [text for text in first.manifest["warnings"] if "anew" in text]
    again = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert (again.manifest["jobs_run"], again.manifest["jobs_reused"]) == (0, 1)
    fill(tmp_path, 9)
    changed = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert changed.manifest["jobs_reused"] == 0
    assert digest(changed) != digest(first)


@pytest.mark.parametrize("reader", list(UNSEEN))
def test_what_a_library_reads_is_made_anew(tmp_path: Path, reader: str) -> None:
    path = write(tmp_path, UNSEEN[reader][1], UNSEEN[reader][0])
    first = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert first.trials["status"].tolist() == ["ok"], first.trials["message"].tolist()
    assert [text for text in first.manifest["warnings"] if "@front_ends.register(..., files=" in text]
    fill(tmp_path, 9)
    assert digest(run_experiment(path, folder=tmp_path / "r", jobs=1)) != digest(first)


def test_table_read_by_pandas_is_never_out_of_date(tmp_path: Path) -> None:
    """Recorded; its first use reads more of the system's, and is then made anew as well."""
    path = write(tmp_path, "float(pd.read_csv(HERE / 'data.csv')['factor'][0])", "import pandas as pd")
    first = run_experiment(path, folder=tmp_path / "r", jobs=1)
    fill(tmp_path, 9)
    assert digest(run_experiment(path, folder=tmp_path / "r", jobs=1)) != digest(first)


def test_front_end_that_only_computes_in_c_is_kept(tmp_path: Path) -> None:
    path = write(tmp_path, "float(cv2.norm(np.full(4, 2.0)))", "import cv2")
    first = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert not [text for text in first.manifest["warnings"] if "anew" in text]
    assert run_experiment(path, folder=tmp_path / "r", jobs=1).manifest["jobs_run"] == 0


def test_files_that_a_front_end_declares_are_part_of_its_key(tmp_path: Path) -> None:
    extra, factor = UNSEEN["OpenCV"]
    path = write(tmp_path, factor, extra, '@front_ends.register("mine", files=["image.png"])')
    first = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert not [text for text in first.manifest["warnings"] if "anew" in text]
    assert run_experiment(path, folder=tmp_path / "r", jobs=1).manifest["jobs_run"] == 0
    fill(tmp_path, 9)
    changed = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert changed.manifest["jobs_run"] == 2
    assert digest(changed) != digest(first)
