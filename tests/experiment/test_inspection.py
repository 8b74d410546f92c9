"""The trials table says why a run went wrong."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

from slamcmp.experiment.runner import run_experiment

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
    assert math.isnan(row["departure_landmark"])
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
