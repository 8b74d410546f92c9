"""The trials table says why a run went wrong."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

from slamcmp.experiment.gathering.own_names import own_names, with_own_names
from slamcmp.experiment.runner import run_experiment
from slamcmp.geometry import se2
from slamcmp.results.store import load_results

FAULTY = """\
from dataclasses import replace

import numpy as np

from slamcmp.frontend.labelled import labelled


def faulty(log, seed, *, frame: int = 100, bearing_off_rad: float = 1.0):
    \"\"\"The labelled front end with the bearing of one observation spoilt.\"\"\"
    stream = labelled(log, seed, gate_probability=None)
    frames = list(stream.frames)
    z = np.array(frames[frame].z)
    z[0, 1] += bearing_off_rad
    frames[frame] = replace(frames[frame], z=z)
    return type(stream)(stream.problem, tuple(frames))
"""


def test_the_fault_is_a_row_of_the_table(tmp_path: Path) -> None:
    (tmp_path / "front.py").write_text(FAULTY)
    (tmp_path / "e.yaml").write_text(
        "source: {name: circle, steps: 130}\nfront_end: {name: 'front.py:faulty'}\n"
        "back_ends: [{name: ekf_slam, label: EKF}, {name: isam2}]\n"
    )
    results = run_experiment(tmp_path / "e.yaml", folder=tmp_path / "r", executor="serial")
    row = results.trials[results.trials["label"] == "EKF"].iloc[0]
    assert (row["departure_test"], row["departure_frame"]) == ("NIS", 100.0)
    assert row["departure_sigmas"] > 20
    assert f"landmark {int(row['departure_landmark'])} in frame 100: its bearing was" in row["diagnosis"]
    assert "The measurement itself was wrong" in row["diagnosis"]
    # Without the stream's file the frame is still known, the landmark is not.
    for file in (tmp_path / "r" / "streams").glob("*.npz"):
        if ".truth" not in file.name:
            file.unlink()
    again = run_experiment(tmp_path / "e.yaml", folder=tmp_path / "r", executor="serial")
    row = again.trials[again.trials["label"] == "EKF"].iloc[0]
    assert (again.manifest["jobs_run"], row["departure_frame"]) == (0, 100.0)
    assert pd.isna(row["departure_landmark"])
    assert row["diagnosis"].startswith("The innovations left their band at frame 100")


def test_healthy_and_lost_runs_have_nothing_to_tell(
    write_experiment: Callable[..., Path], tmp_path: Path
) -> None:
    path = write_experiment(back_ends=["DeadReckoning", "Raises", {"name": "IsKilled", "at": 0}])
    results = run_experiment(path, folder=tmp_path / "r", jobs=1)
    rows = results.trials.set_index("label")
    assert rows.loc["DeadReckoning", "diagnosis"] == ""
    assert rows.loc["IsKilled", "diagnosis"] == ""
    assert rows.loc["Raises", "diagnosis"] == "No test gave a warning in the 20 frames that were finished."


NAMED = """
from slamcmp.errors import DivergedError
from tests.user_plugins import DeadReckoning
class Complains(DeadReckoning):
    def misbehave(self):
        raise DivergedError("landmark 1 is behind landmark 0; landmarks 7 and 12.5 m are none")
"""


def test_landmarks_are_told_by_their_own_names(tmp_path: Path) -> None:
    """Of 64 bits, to the last one: in messages, in the diagnosis, in the column, and in the map."""
    first, second = -5, 7782220156096217089
    lines = ["VERTEX_SE2 0 0 0 0"]
    for k in range(30):
        lines += [f"EDGE_SE2 {k} {k + 1} 0.5 0 0.02 10000 0 0 10000 0 10000"]
        T = np.linalg.matrix_power(se2(0.5, 0.0, 0.02), k + 1)
        for name, place in ((first, (3.0, 3.0)), (second, (6.0, -3.0))):
            x, y = T[:2, :2].T @ (np.array(place) - T[:2, 2])
            # The map's second landmark is seen far from where it is, once.
            x += 2.0 * (name == second and k == 25)
            lines.append(f"EDGE_SE2_XY {k + 1} {name} {x:.9f} {y:.9f} 400 0 400")
    (tmp_path / "own.g2o").write_text("\n".join(lines) + "\n")
    (tmp_path / "complains.py").write_text(NAMED)
    (tmp_path / "e.yaml").write_text(
        "source: {name: graph_file, path: own.g2o}\nfront_end: {name: labelled, gate_probability: null}\n"
        "back_ends: [{name: ekf_slam}, {name: 'complains.py:Complains'}]\n"
    )
    results = run_experiment(tmp_path / "e.yaml", folder=tmp_path / "r", executor="serial")
    stored = load_results(tmp_path / "r").trials.set_index("label")
    assert stored.loc["Complains", "message"] == (
        f"frame 20: landmark {second} is behind landmark {first}; landmarks 7 and 12.5 m are none"
    )
    assert stored.loc["ekf_slam", "departure_landmark"] == second
    assert f"landmark {second} in frame 26" in stored.loc["ekf_slam", "diagnosis"]
    assert sorted(set(results.landmarks["id"])) == [first, second]


def test_numbers_that_no_landmark_has_stay() -> None:
    names = np.array([-5, 2**62 + 1, 9])
    assert own_names(np.array([2, 1, 0, 3, -1]), names).tolist() == [9, 2**62 + 1, -5, 3, -1]
    assert own_names(np.array([2, 1]), None).tolist() == [2, 1]
    assert with_own_names("landmark 1, landmark id 2, landmark 3, frame 1", names) == (
        f"landmark {2**62 + 1}, landmark id 9, landmark 3, frame 1"
    )
    assert with_own_names("landmark 1", None) == "landmark 1"
