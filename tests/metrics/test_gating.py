"""Precision and recall of a gate, counted by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slamcmp.metrics import frame_table, score_run
from slamcmp.types import GroundTruth, Run, Trajectory

POSES = np.broadcast_to(np.eye(3), (3, 3, 3))
TRUTH = GroundTruth(
    np.arange(3.0),
    POSES,
    np.empty(0, dtype=int),
    np.empty((0, 2)),
    outliers=(np.array([False, False, True, False]), np.array([], dtype=bool), np.array([True, True, False])),
)
# Frame 0: one of three correct ones rejected; frame 2: one of two outliers missed.
KEPT = (np.array([True, False, False, True]), np.array([], dtype=bool), np.array([False, True, True]))
RUN = Run(
    "a", {}, "d", 0, 3, "ok", "",
    online=Trajectory(np.arange(3.0), POSES, POSES),
    update_s=np.zeros(3), estimate_s=np.zeros(3), kept_observations=KEPT,
)  # fmt: skip


def test_counted_by_hand() -> None:
    scores = score_run(RUN, TRUTH)
    assert scores["gate_recall"] == pytest.approx(3 / 4)
    assert scores["gate_precision"] == pytest.approx(3 / 4)
    frames = frame_table(RUN, TRUTH)
    assert frames["gate_correct"].tolist() == [3, 0, 1]
    assert frames["gate_false_rejections"].tolist() == [1, 0, 0]
    assert frames["gate_missed"].tolist() == [0, 0, 1]


def test_a_run_that_ended_early_is_judged_by_its_finished_frames() -> None:
    online = Trajectory(np.arange(1.0), POSES[:1], POSES[:1])
    early = replace(
        RUN, online=online, kept_observations=KEPT[:1], update_s=np.zeros(1), estimate_s=np.zeros(1)
    )
    assert score_run(early, TRUTH)["gate_recall"] == pytest.approx(2 / 3)
    assert frame_table(early, TRUTH)["gate_correct"].tolist() == [3]


def test_nothing_is_said_without_masks_or_marked_outliers() -> None:
    for run, truth in (
        (replace(RUN, kept_observations=None), TRUTH),
        (RUN, replace(TRUTH, outliers=None)),
        (RUN, None),
    ):
        scores = score_run(run, truth)
        assert np.isnan(scores["gate_recall"])
        assert np.isnan(scores["gate_precision"])
    assert "gate_correct" not in frame_table(replace(RUN, kept_observations=None), TRUTH)
    assert np.isnan(frame_table(RUN, replace(TRUTH, outliers=None))["gate_correct"]).all()
