"""Pose graphs: loop closures are the between factors that gtsam's own reader makes of the file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gtsam
import numpy as np
import pytest

from slamcmp import geometry as g
from slamcmp.backends.gtsam_smoothers.batch import Batch
from slamcmp.backends.gtsam_smoothers.fixed_lag import FixedLag
from slamcmp.backends.gtsam_smoothers.isam2 import Isam2
from slamcmp.datasets.graphs.g2o_writer import write_g2o
from slamcmp.datasets.graphs.graph_file import graph_file
from slamcmp.datasets.wheel import wheel_file
from slamcmp.errors import DataError, UsageError
from slamcmp.experiment.runner import run_experiment
from slamcmp.frontend.labelled import labelled
from slamcmp.frontend.stream_file import load_stream, save_stream
from slamcmp.models.sensors import RelativePosition
from slamcmp.types import Frame, MeasurementStream, Problem, RelativePoses
from tests.backends.graph_streams import run


def optimum_by_gtsam(name: str) -> tuple[float, gtsam.Values]:
    """Chi-squared and solution of gtsam's own graph with the first pose held."""
    graph, values = gtsam.load2D(str(wheel_file(name)))
    held = gtsam.noiseModel.Isotropic.Sigma(3, 1e-6)
    graph.add(gtsam.PriorFactorPose2(0, values.atPose2(0), held))
    settings = gtsam.LevenbergMarquardtParams()
    settings.setRelativeErrorTol(1e-12)
    settings.setAbsoluteErrorTol(0.0)
    settings.setMaxIterations(1000)
    best = gtsam.LevenbergMarquardtOptimizer(graph, values, settings).optimize()
    return 2.0 * graph.error(best), best


def pose_graph(name: str, steps: int | None = None) -> MeasurementStream:
    return labelled(graph_file(path=name, steps=steps), 0)


@pytest.mark.parametrize(
    ("name", "warm_start"),
    [
        ("w100.graph", "isam2"),
        ("w100.graph", "linear"),
        pytest.param("w10000.graph", "linear", marks=pytest.mark.slow),
    ],
)
def test_batch_finds_gtsams_optimum(name: str, warm_start: Any) -> None:
    chi2, best = optimum_by_gtsam(name)
    stream = pose_graph(name)
    batch = run(Batch(stream.problem, warm_start=warm_start), stream)
    found = batch.trajectory()
    assert batch.diagnostics()["chi2"] == pytest.approx(chi2, abs=1e-6)
    last = len(stream.frames) - 1
    # The file states sigmas of 1 m and 1 rad: 2 mm after 10 000 poses change χ² by 3e-8.
    atol = 1e-3 if name == "w100.graph" else 1e-2
    np.testing.assert_allclose(found.T_world_body[last], best.atPose2(last).matrix(), rtol=0, atol=atol)
    if name == "w100.graph":
        # 300 edges and the prior, 100 poses.
        assert batch.diagnostics()["dof"] == 3 * 301 - 3 * 100
        assert batch.landmarks().ids.size == 0


def test_isam2_comes_to_the_same() -> None:
    chi2, best = optimum_by_gtsam("w100.graph")
    stream = pose_graph("w100.graph")
    isam2 = run(Isam2(stream.problem, relinearize_threshold=0.0, relinearize_skip=1, extra_updates=4), stream)
    poses = isam2.trajectory().T_world_body
    assert isam2.diagnostics()["chi2"] == pytest.approx(chi2, abs=1e-6)
    expected = np.stack([best.atPose2(k).matrix() for k in range(100)])
    np.testing.assert_allclose(poses, expected, rtol=0, atol=1e-6)


def test_a_closure_in_space_by_the_information_filter() -> None:
    """One closure of identity to the prior's own pose: the posterior of the last pose in closed form."""
    P, Q, C = 1e-2 * np.eye(6), 1e-4 * np.eye(6), 4e-4 * np.eye(6)
    nothing = ([], np.empty((0, 3)), np.empty((0, 3, 3)))
    still = np.eye(4)
    frames = [Frame(0, 0.0, still, np.zeros((6, 6)), *nothing), Frame(1, 1.0, still, Q, *nothing)]
    related = RelativePoses([0], still[None], C[None])
    frames.append(Frame(2, 2.0, still, Q, *nothing, relative_poses=related))
    stream = MeasurementStream(Problem(still, P, RelativePosition(space_dim=3)), tuple(frames))
    for back_end in (Batch(stream.problem), Isam2(stream.problem), FixedLag(stream.problem)):
        estimate = run(back_end, stream).estimate()
        # Two odometry steps and the closure in parallel, behind the prior.
        expected = P + np.linalg.inv(np.linalg.inv(2 * Q) + np.linalg.inv(C))
        if isinstance(back_end, Batch):
            back_end.trajectory()
            np.testing.assert_allclose(back_end.trajectory().P[-1], expected, rtol=1e-6)
        else:
            np.testing.assert_allclose(estimate.P, expected, rtol=1e-6)


def test_fixed_lag_uses_what_its_window_holds_and_refuses_the_rest() -> None:
    stream = pose_graph("w100.graph", steps=60)
    whole = run(Isam2(stream.problem, relinearize_threshold=0.0, relinearize_skip=1, extra_updates=4), stream)
    wide = run(FixedLag(stream.problem, lag_frames=60, relinearize_threshold=0.0, extra_updates=4), stream)
    np.testing.assert_allclose(wide.estimate().T_world_body, whole.estimate().T_world_body, rtol=0, atol=1e-6)
    with pytest.raises(
        UsageError, match=r"fixed_lag: frame \d+ is related to frame \d+, which left the window"
    ):
        run(FixedLag(stream.problem, lag_frames=5), stream)


def test_filters_refuse_and_places_serve_them(tmp_path: Path) -> None:
    (tmp_path / "pose_graph.yaml").write_text(
        "source: {name: graph_file, path: w100.graph, steps: 40}\n"
        "reference: batch\n"
        "back_ends: [{name: batch}, {name: ekf_slam}, {name: sliding_window}, {name: dead_reckoning}]\n"
    )
    trials = run_experiment(tmp_path / "pose_graph.yaml", folder=tmp_path / "r", jobs=1).trials
    status = dict(zip(trials["label"], trials["status"], strict=True))
    assert status == {
        "batch": "ok",
        "ekf_slam": "crashed",
        "sliding_window": "crashed",
        "dead_reckoning": "ok",
    }
    for label in ("ekf_slam", "sliding_window"):
        told = trials.set_index("label")["message"][label]
        assert f"{label} takes no loop closures between poses (frame " in told
        assert "set the source's closures to 'places'" in told
    (tmp_path / "places.yaml").write_text(
        "source: {name: graph_file, path: w100.graph, steps: 40, closures: places}\n"
        "back_ends: [{name: ekf_slam}]\n"
    )
    results = run_experiment(tmp_path / "places.yaml", folder=tmp_path / "p", jobs=1)
    assert list(results.trials["status"]) == ["ok"]
    assert "were turned into sights of places" in results.manifest["warnings"][0]


def test_streams_with_closures_are_stored_named_and_written(tmp_path: Path) -> None:
    stream = pose_graph("w100.graph", steps=50)
    save_stream(stream, tmp_path / "s.npz")
    assert load_stream(tmp_path / "s.npz").digest == stream.digest
    without = MeasurementStream(
        stream.problem,
        tuple(Frame(f.k, f.t, f.T_prev_body, f.Q, f.ids, f.z, f.R) for f in stream.frames),
    )
    assert without.digest != stream.digest
    write_g2o(tmp_path / "back.g2o", stream)
    back = pose_graph(str(tmp_path / "back.g2o"))
    closed = 0
    for ours, theirs in zip(stream.frames, back.frames, strict=True):
        if ours.relative_poses is None:
            assert theirs.relative_poses is None
            continue
        closed += ours.relative_poses.frames.size
        for name in ("frames", "T_earlier_body", "P"):
            np.testing.assert_allclose(
                getattr(theirs.relative_poses, name), getattr(ours.relative_poses, name), rtol=0, atol=1e-12
            )
    assert closed > 10


def test_a_landmarks_own_name_is_written(tmp_path: Path) -> None:
    path = tmp_path / "named.g2o"
    trees = [gtsam.symbol("l", 1), -5]
    path.write_text(
        "EDGE_SE2 0 1 1 0 0 4 0 0 4 0 4\n" + "".join(f"EDGE_SE2_XY 1 {tree} 1 2 4 0 4\n" for tree in trees)
    )
    log = graph_file(path=str(path))
    write_g2o(tmp_path / "again.g2o", log)
    again = graph_file(path=str(tmp_path / "again.g2o"))
    assert again.own_ids.tolist() == log.own_ids.tolist() == sorted(trees)


@pytest.mark.parametrize(
    ("related", "message"),
    [
        (RelativePoses([1], g.se2(1, 0, 0)[None], np.eye(3)[None]), "one of an earlier frame is needed"),
        (RelativePoses([-1], g.se2(1, 0, 0)[None], np.eye(3)[None]), "one of an earlier frame is needed"),
        (RelativePoses([0], np.eye(4)[None], np.eye(6)[None]), r"relative poses \(4, 4\) where \(3, 3\)"),
        (RelativePoses([], np.empty((0, 3, 3)), np.empty((0, 3, 3))), "without an entry"),
    ],
)
def test_what_a_stream_cannot_hold(related: RelativePoses, message: str) -> None:
    stream = pose_graph("w100.graph", steps=2)
    second = stream.frames[1]
    frame = Frame(
        1, second.t, second.T_prev_body, second.Q, second.ids, second.z, second.R, relative_poses=related
    )
    with pytest.raises(DataError, match=message):
        MeasurementStream(stream.problem, (stream.frames[0], frame))
    with pytest.raises(DataError, match="not positive definite"):
        RelativePoses([0], np.eye(3)[None], np.zeros((1, 3, 3)))
