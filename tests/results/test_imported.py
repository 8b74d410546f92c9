"""Other programs' trajectories as runs: scored at their own instants, marked, and paired like any other."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slamcmp.datasets.trajectory_files import write_trajectory
from slamcmp.errors import DataError, UsageError
from slamcmp.geometry import exp, local, se2
from slamcmp.report.figures.sweeps.dial import arrangement
from slamcmp.results.compare.comparison import compare_results
from slamcmp.results.judgements.summary import paired_table, summary_table
from slamcmp.results.runs.imported import Import, import_runs
from slamcmp.results.runs.stored_runs import stored_run
from slamcmp.results.store import Results, load_results
from slamcmp.types import Trajectory
from tests.recorded_data import recorded

RNG = np.random.default_rng(0)
T_TRUE = np.arange(0.0, 10.01, 0.1)


def along(t: np.ndarray) -> np.ndarray:
    """Poses on a circle at constant speed, whose interpolation has an error of 1e-3 of its step."""
    return se2(5 * np.cos(0.2 * t), 5 * np.sin(0.2 * t), 0.2 * t + np.pi / 2)


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """The truth every 0.1 s; estimates between its stamps, 0.3 m aside, and one with covariances."""
    write_trajectory(tmp_path / "truth.csv", Trajectory(T_TRUE, along(T_TRUE)), "csv")
    t = np.arange(0.05, 9.9, 0.2)
    for name, shift in (("near", 0.1), ("far", 0.3)):
        poses = along(t).copy()
        poses[:, 0, 2] += shift * np.where(np.arange(t.size) % 2, 1.0, -1.0)
        write_trajectory(tmp_path / f"{name}.csv", Trajectory(t, poses), "csv")
    P = np.broadcast_to(np.diag([0.04, 0.01, 0.001]), (t.size, 3, 3))
    sure = along(t) @ exp(-RNG.multivariate_normal(np.zeros(3), P[0], t.size))
    write_trajectory(tmp_path / "sure.csv", Trajectory(t, sure, P), "csv")
    return tmp_path


def take(files: Path, name: str, which: Any = "online", **more: Any) -> Import:
    return Import(files / f"{name}.csv", files / "truth.csv", more.pop("label", name), which, **more)


def test_every_pose_meets_the_truth_at_its_own_instant(files: Path) -> None:
    results = import_runs(files / "out", [take(files, "near"), take(files, "far")])
    near, far = results.trials.to_dict("records")
    # Between stamps 0.1 s apart the chord is 5 (0.02)²/8 = 0.25 mm inside the circle.
    assert near["online_ate"] == pytest.approx(0.1, abs=3e-4)
    assert far["online_ate"] == pytest.approx(0.3, abs=3e-4)
    assert near["back_end"] == far["back_end"] == "imported"
    assert near["digest"] == far["digest"]
    assert np.isnan(
        [near[name] for name in ("update_s", "peak_memory_mb", "online_pose_nees", "final_ate")]
    ).all()
    summary = summary_table(load_results(files / "out"))
    assert list(summary["origin"]) == ["imported", "imported"]
    assert "online pose NEES" not in summary
    paired = paired_table(results)
    assert paired["ATE ratio"][0] == pytest.approx(3.0, rel=0.01)
    assert results.manifest["warnings"][0].endswith(
        "near, online: 50 of 50 poses have a truth, interpolated (linear and SLERP) at its stamps, over gaps "
        "up to 0.2 s; no covariance, so no NEES"
    )


def test_a_covariance_brings_its_nees(files: Path) -> None:
    results = import_runs(files / "out", [take(files, "sure")])
    run = stored_run(results)
    errors = local(run.online.T_world_body, along(run.online.t))
    expected = np.mean(np.einsum("ki,kij,kj->k", errors, np.linalg.inv(run.online.P), errors))
    assert results.trials["online_pose_nees"][0] == pytest.approx(expected, rel=0.02)
    assert 2.0 < expected < 4.0


def test_final_is_final_and_completes_an_online_run(files: Path) -> None:
    results = import_runs(files / "out", [take(files, "near", "final", label="S")])
    assert results.trials["online_ate"].isna().all()
    assert results.trials["final_ate"][0] == pytest.approx(0.1, abs=3e-4)
    results = import_runs(files / "out", [take(files, "far", "online", label="S")])
    (row,) = results.trials.to_dict("records")
    assert (row["online_ate"], row["final_ate"]) == pytest.approx((0.3, 0.1), abs=3e-4)
    assert len(results.manifest["imports"]) == 2
    assert stored_run(results).final is not None
    with pytest.raises(UsageError, match=r"has the final trajectory of 'S' \(run 0\) already; --replace"):
        import_runs(files / "out", [take(files, "far", "final", label="S")])
    replaced = import_runs(files / "out", [take(files, "far", "final", label="S")], replaced=True)
    assert replaced.trials["final_ate"][0] == pytest.approx(0.3, abs=3e-4)


def test_repetitions_are_samples_and_folders_compare(files: Path) -> None:
    def folder(name: str, scale: float) -> Results:
        imports = []
        for k in range(6):
            t = np.arange(0.05, 9.9, 0.2)
            poses = along(t) @ exp(np.outer(np.ones(t.size), [0.0, scale * (1 + 0.1 * k), 0.0]))
            path = files / f"{name}{k}.csv"
            write_trajectory(path, Trajectory(t, poses), "csv")
            imports.append(Import(path, files / "truth.csv", "system", "online", k))
        return import_runs(files / name, imports)

    before, after = folder("before", 0.1), folder("after", 0.2)
    assert before.trials["seed"].tolist() == before.trials["trial"].tolist() == list(range(6))
    row = next(row for row in compare_results(before, after).rows if row.metric == "online_ate")
    assert (row.pairs, row.verdict) == (6, "worse")
    assert row.ratio.estimate == pytest.approx(2.0, rel=0.01)


def test_what_does_not_fit_is_said(files: Path) -> None:
    out = files / "out"
    with pytest.raises(DataError, match=r"no stamp, 1000\.05 to .* has a truth; .* another clock"):
        import_runs(out, [take(files, "near", time_offset_s=1000.0)])
    with pytest.raises(DataError, match=r"interpolated over gaps up to 0\.01 s"):
        import_runs(out, [take(files, "near", max_gap_s=0.01)])
    write_trajectory(files / "space.txt", Trajectory(T_TRUE, along(T_TRUE)), "tum")
    with pytest.raises(DataError, match=r"poses in 3 dimensions, and .* has 2"):
        import_runs(out, [Import(files / "space.txt", files / "truth.csv", "a", "online")])
    write_trajectory(files / "kitti.txt", Trajectory(T_TRUE, along(T_TRUE)), "kitti")
    with pytest.raises(DataError, match="has no time stamps, and the other has; --times"):
        import_runs(out, [Import(files / "kitti.txt", files / "space.txt", "a", "online")])
    short = Trajectory(T_TRUE[:9], along(T_TRUE[:9]))
    write_trajectory(files / "short.txt", short, "kitti")
    with pytest.raises(DataError, match="9 poses without stamps, and 101 of the truth"):
        import_runs(out, [Import(files / "short.txt", files / "kitti.txt", "a", "online")])
    assert not (out / "manifest.json").exists()


def test_kitti_without_stamps_is_pose_by_pose(files: Path) -> None:
    write_trajectory(files / "kitti.txt", Trajectory(T_TRUE, along(T_TRUE)), "kitti")
    moved = along(T_TRUE) @ exp(np.outer(np.ones(T_TRUE.size), [0.0, 0.2, 0.0]))
    write_trajectory(files / "moved.txt", Trajectory(T_TRUE, moved), "kitti")
    results = import_runs(files / "out", [Import(files / "moved.txt", files / "kitti.txt", "a", "final")])
    assert results.trials["final_ate"][0] == pytest.approx(0.2)
    assert "pose by pose" in results.manifest["warnings"][0]


def test_an_experiments_folder_is_not_written_to(files: Path) -> None:
    results = import_runs(files / "out", [take(files, "near")])
    del results.manifest["imports"]
    from slamcmp.results.store import save_results

    save_results(results)
    with pytest.raises(UsageError, match="holds the results of an experiment"):
        import_runs(files / "out", [take(files, "far")])


def test_the_published_windows_of_euroc_are_a_dial(tmp_path: Path) -> None:
    """SE(3)-aligned ATE of EuRoC V2_01 by windows of 1, 10, 50 poses and an MSCKF of 10, as published."""
    data = recorded("euroc_v201_windows")
    published = {"window_1": 0.538, "window_10": 0.258, "window_50": 0.201, "msckf_10": 0.179}
    imports = []
    for name in published:
        family, _, window = name.partition("_")
        parameters = {"window": int(window)} | ({"family": "MSCKF"} if family == "msckf" else {})
        imports.append(
            Import(data / f"{name}.csv", data / "truth_tum.txt", name, "online", parameters=parameters)
        )
    results = import_runs(tmp_path / "out", imports)
    found = results.trials.set_index("label")["online_ate_aligned"]
    for name, value in published.items():
        assert found[name] == pytest.approx(value, abs=0.002), name
    assert {each["poses_with_truth"] for each in results.manifest["imports"]} == {2240}
    curves, _, _ = arrangement(results.manifest)
    assert [(curve.policy, curve.windows) for curve in curves] == [
        ("imported", (1, 10, 50)),
        ("MSCKF", (10,)),
    ]
    from slamcmp.report import draw_figures

    drawn = draw_figures(results, ["dial"], tmp_path, ("png",))
    assert [path.name for path in drawn] == ["dial.png"], drawn.skipped
