"""A log in plain files: against the drive it is of, through the back ends, and every kind of what is "
"wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from slamcmp import geometry as g
from slamcmp.cli import app
from slamcmp.datasets.plain.column_files import read_table
from slamcmp.datasets.plain.log_checks import check_files
from slamcmp.datasets.plain.plain_motion import Motion, read_motion
from slamcmp.datasets.plain.plain_recording import recording
from slamcmp.datasets.plain.recording_writer import write_recording
from slamcmp.errors import DataError, MissingDataError, UsageError
from slamcmp.experiment.runner import run_experiment
from slamcmp.registry import sources
from tests.datasets.plain_drive import Drive

SIGMAS = {"range_sigma_m": 0.05, "bearing_sigma_rad": 0.01}


def logged(files: dict[str, Path], **settings):
    return recording(**{name: str(path) for name, path in files.items()}, **{**SIGMAS, **settings})


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> dict[str, Path]:
    return Drive().write(tmp_path_factory.mktemp("drive"))


def test_frames_are_the_instants_of_detection(files):
    drive = Drive()
    log = logged(files)
    np.testing.assert_allclose(log.t, np.arange(0.42, 60, 0.4), atol=1e-9)
    np.testing.assert_allclose(log.truth.T_world_body, drive.at(log.t), atol=2e-4)
    assert [seen.ids.tolist() for seen in log.detections] == [sorted(drive.landmarks)] * log.t.size
    np.testing.assert_allclose(log.truth.positions, list(drive.landmarks.values()), atol=1e-8)
    # The drive is known in steps of 0.01 s, its velocities as means over 0.1 s.
    true = g.inverse(log.truth.T_world_body[:-1]) @ log.truth.T_world_body[1:]
    np.testing.assert_allclose(log.T_prev_body[1:], true, atol=1e-3)
    for k, seen in enumerate(log.detections):
        expected = log.problem.sensor.predict(log.truth.T_world_body[k], log.truth.positions)
        assert np.abs(seen.z - expected)[:, 0].max() < 0.25
        np.testing.assert_allclose(seen.R, np.tile(np.diag([0.05**2, 0.01**2]), (8, 1, 1)))


def test_ten_lines_of_yaml(tmp_path):
    Drive().write(tmp_path)
    (tmp_path / "mine.yaml").write_text(
        "source:\n"
        "  name: recording\n"
        "  odometry: odometry.csv\n"
        "  detections: detections.csv\n"
        "  truth: truth.csv\n"
        "  landmarks: landmarks.csv\n"
        "  range_sigma_m: 0.05\n"
        "  bearing_sigma_rad: 0.01\n"
        "back_ends: [{name: ekf_slam}, {name: batch}, {name: dead_reckoning}]\n"
    )
    rows = run_experiment(tmp_path / "mine.yaml", folder=tmp_path / "r", jobs=1).trials.set_index("label")
    assert (rows["status"] == "ok").all()
    # Eight landmarks at 5 cm a sight, a start known to 1 mrad; the odometry is better than it says.
    assert rows["final_ate"]["batch"] < 0.1
    assert rows["landmark_rmse"]["batch"] < 0.1
    assert 0.8 < rows["chi2_per_dof"]["batch"] < 1.1
    assert rows["truth_share"]["ekf_slam"] == 1.0


def test_every_kind_of_odometry_is_the_same_motion(tmp_path):
    rng = np.random.default_rng(1)
    t = np.cumsum(rng.uniform(0.05, 0.2, 50))
    twists = np.stack([rng.uniform(0, 1, 49), np.zeros(49), rng.uniform(-1, 1, 49)], axis=1)
    dt = np.diff(t)[:, None]
    steps = g.exp(twists * dt)
    poses = g.dead_reckoning(g.se2(3, 4, 2.0), np.concatenate([np.eye(3)[None], steps]))
    wheels = (
        np.stack([twists[:, 0] - 0.2 * twists[:, 2], twists[:, 0] + 0.2 * twists[:, 2]], axis=1) * dt / 1e-3
    )
    counts = np.concatenate([np.zeros((1, 2)), np.cumsum(wheels, axis=0)])
    tables = {
        "t_s,v_m_s,omega_rad_s": np.column_stack([t, np.vstack([twists, twists[-1:]])[:, [0, 2]]]),
        "t_ms,dx_mm,dy_cm,dtheta_deg": np.column_stack(
            [1e3 * t, np.vstack([[0, 0, 0], g.se2_coordinates(steps)]) * [1e3, 1e2, 180 / np.pi]]
        ),
        "t_us,x_m,y_m,theta_rad": np.column_stack([1e6 * t, g.se2_coordinates(poses)]),
        "t_ns,left_ticks,right_ticks": np.column_stack([1e9 * t, counts]),
    }
    start, end, densities = t[7] + 0.01, t[31] + 0.02, np.array([0.1, 0.02, 0.05])
    found = []
    for header, rows in tables.items():
        path = tmp_path / f"{len(found)}.csv"
        path.write_text(header + "\n" + "\n".join(",".join(f"{x:.12f}" for x in row) for row in rows) + "\n")
        motion = read_motion(read_table(path), metres_per_tick=1e-3, track_m=0.4)
        found.append(motion.between(start, end, densities))
    for T, Q in found[1:]:
        np.testing.assert_allclose(T, found[0][0], atol=1e-8)
        np.testing.assert_allclose(Q, found[0][1], atol=1e-8)
    # From the pose at one instant to that at the other.
    first = poses[7] @ g.exp(twists[7] * 0.01)
    last = poses[31] @ g.exp(twists[31] * 0.02)
    np.testing.assert_allclose(found[0][0], g.inverse(first) @ last, atol=1e-8)


def test_noise_of_the_motion_by_sampling():
    """White noise on the velocities of a turn, drawn in small steps."""
    rng = np.random.default_rng(0)
    motion = Motion(np.array([0.0, 1.0, 2.5]), np.array([[1.0, 0, 0.5], [0.5, 0, -0.8]]))
    densities = np.array([0.02, 0.01, 0.015])
    T, _ = motion.between(0.0, 2.5, densities)
    np.testing.assert_allclose(T, g.exp([1.0, 0, 0.5]) @ g.exp([0.75, 0, -1.2]), atol=1e-12)
    drawn = np.tile(np.eye(3), (3000, 1, 1))
    for dt, twist in [(0.05, motion.twists[0])] * 20 + [(0.05, motion.twists[1])] * 30:
        noise = rng.standard_normal((3000, 3)) * densities * np.sqrt(dt)
        drawn = drawn @ g.exp(twist * dt + noise)
    sampled = np.cov(g.local(T, drawn).T)
    # Noise enters within a row, here at its end: equal to a few per cent for rows so long.
    scale = np.sqrt(np.outer(np.diag(sampled), np.diag(sampled)))
    fine = Motion(np.linspace(0, 2.5, 51), np.repeat(motion.twists, [20, 30], axis=0)).between(
        0, 2.5, densities
    )[1]
    assert np.abs((fine - sampled) / scale).max() < 0.08


def test_parquet_offsets_and_sigmas_of_rows(tmp_path, files):
    frame = pd.read_csv(files["detections"])
    frame["sigma_range_cm"] = 7.0
    frame["t_ms"] += 1500
    frame["id"] = frame["id"].astype(float)
    frame.loc[3, "id"] = np.nan
    frame.to_parquet(tmp_path / "seen.parquet")
    plain = logged(files)
    log = logged({**files, "detections": tmp_path / "seen.parquet"}, detection_offset_s=-1.5)
    np.testing.assert_allclose(log.t, plain.t, atol=1e-9)
    assert log.detections[0].ids.tolist()[3] == -1
    np.testing.assert_allclose(log.detections[5].R, np.tile(np.diag([0.07**2, 0.01**2]), (8, 1, 1)))


def test_truth_with_gaps_and_sigmas(tmp_path, files):
    rows = files["truth"].read_text().splitlines()
    told = [
        rows[0] + ",sigma_x_m,sigma_y_m,sigma_theta_rad",
        *(row + ",0.01,0.03,0.002" for row in rows[1:200] + rows[300:]),
    ]
    (tmp_path / "truth.csv").write_text("\n".join(told) + "\n")
    log = logged({**files, "truth": tmp_path / "truth.csv"})
    known = log.truth.known()
    np.testing.assert_array_equal(~known, (log.t > 9.9) & (log.t < 14.95))
    R = log.truth.T_world_body[3][:2, :2]
    np.testing.assert_allclose(log.truth.P[3][:2, :2], R.T @ np.diag([1e-4, 9e-4]) @ R, rtol=1e-9)


def test_names_that_no_back_end_takes(tmp_path, files):
    for name in ("detections", "landmarks"):
        text = files[name].read_text().replace(",21,", ",-21,").replace("\n21,", "\n-21,")
        (tmp_path / f"{name}.csv").write_text(text)
    log = logged(
        {**files, "detections": tmp_path / "detections.csv", "landmarks": tmp_path / "landmarks.csv"}
    )
    assert log.own_ids.tolist() == [-21, 0, 3, 6, 9, 12, 15, 18]
    assert log.detections[0].ids.tolist() == [1, 2, 3, 4, 5, 6, 7, 0]
    assert sorted(log.truth.ids) == list(range(8))


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("odometry", "v_m_s", "v", r"column 'v' has no unit; one of v_m_s, v_mm_s, v_km_h"),
        ("odometry", "v_m_s", "speed", r"odometry is one of .* found none"),
        ("odometry", "\n0.300,", "\n0.150,", r"odometry\.csv:5: time 0\.15 s does not come after 0\.2 s"),
        ("odometry", "\n0.300,", "\n0.3_0,", r"odometry\.csv:5: '0\.3_0' is not a finite number"),
        ("odometry", "\n0.300,", "\n0.300,7,", r"odometry\.csv:5: 4 fields where the header has 3"),
        ("detections", "bearing_rad", "angle_rad", r"range alone does not place a landmark"),
        ("detections", "t_ms", "t_s", r"none of its times.* set detection_offset_s"),
        ("detections", "420.0,3,", "420.0,3.5,", r"detections\.csv:3: '3\.5' is not an id"),
        ("truth", "theta_rad", "heading_rad", r"truth has t, x, y, theta with units"),
        ("landmarks", "\n3,", "\n,", r"landmarks\.csv:3: a landmark without id"),
        ("odometry", "omega_deg_s", "v_km_h", r"two columns of v, the second is v_km_h"),
    ],
)
def test_what_is_wrong_with_a_file_and_where(tmp_path, files, name, old, new, message):
    text = files[name].read_text()
    assert old in text
    (tmp_path / f"{name}.csv").write_text(text.replace(old, new, 1))
    with pytest.raises(DataError, match=message):
        logged({**files, name: tmp_path / f"{name}.csv"})


def test_missing_files_and_sigmas(files):
    with pytest.raises(MissingDataError, match=r"none\.csv"):
        logged({**files, "truth": Path("none.csv")})
    with pytest.raises(DataError, match="has no column sigma_range; set range_sigma_m"):
        logged(files, range_sigma_m=None)


@pytest.mark.parametrize(
    ("sensor", "column", "other"), [("range_only", 0, "bearing"), ("bearing_only", 1, "range")]
)
def test_a_range_or_a_bearing_alone_where_it_is_said_to_be_all(tmp_path, files, sensor, column, other):
    whole = logged(files)
    titles, *rows = files["detections"].read_text().splitlines()
    kept = [k for k, title in enumerate(titles.split(",")) if not title.startswith(other)]
    lines = [",".join(row.split(",")[k] for k in kept) for row in (titles, *rows)]
    (tmp_path / "part.csv").write_text("\n".join(lines) + "\n")
    part = logged({**files, "detections": tmp_path / "part.csv"}, sensor=sensor)
    assert part.problem.sensor.name == sensor
    for ours, both in zip(part.detections, whole.detections, strict=True):
        np.testing.assert_array_equal(ours.z, both.z[:, [column]])
        np.testing.assert_array_equal(ours.R[:, 0, 0], both.R[:, column, column])
    with pytest.raises(DataError, match=rf"say sensor: {sensor} if it is all"):
        logged({**files, "detections": tmp_path / "part.csv"})
    wrong = "bearing_only" if sensor == "range_only" else "range_only"
    with pytest.raises(DataError, match=rf"detections of sensor {wrong} have t, id and"):
        logged({**files, "detections": tmp_path / "part.csv"}, sensor=wrong)


# ---- data check ----


def findings(drive: Drive, folder: Path, **replaced: tuple[str, str]) -> list[str]:
    files = drive.write(folder)
    for name, (old, new) in replaced.items():
        text = files[name].read_text()
        assert old in text
        files[name].write_text(text.replace(old, new, 1))
    return check_files(list(files.values())).findings


def test_nothing_is_wrong_with_a_good_log(tmp_path):
    files = Drive().write(tmp_path)
    report = check_files(list(files.values()))
    assert report.findings == []
    text = "\n".join(report.facts)
    for part in (
        "odometry.csv: 601 rows over 60 s, usually 0.1 s apart",
        "detections.csv: 8 landmarks, seen 149 to 149 times",
        "clock offset",
        "range: error",
        "bearing: error",
    ):
        assert part in text


@pytest.mark.parametrize("late", [0.2, -0.15])
def test_a_clock_offset_is_estimated(tmp_path, late):
    found = findings(Drive(odometry_late_s=late), tmp_path)
    told = [each for each in found if "set odometry_offset_s to" in each]
    assert len(told) == 1
    assert float(told[0].rsplit(" ", 1)[1]) == pytest.approx(-late, abs=0.011)
    assert ("lags" if late > 0 else "leads") in told[0]


@pytest.mark.parametrize("name", ["circle", "random", "lawnmower", "corridor", "figure_eight"])
@pytest.mark.parametrize("seed", range(3))
def test_clocks_of_a_log_that_is_stamped_exactly_are_not_blamed(tmp_path, name, seed):
    """Round and round at one speed nothing tells an offset; of steps of a second no hundredth is resolved."""
    log = sources.get(name).target(seed, steps=150, landmarks=5)
    write_recording(log, tmp_path)
    report = check_files(sorted(tmp_path.glob("*.csv")))
    assert [each for each in report.findings if "odometry_offset_s" in each] == []
    assert sum("clock offset" in each for each in report.facts) == 1
    if name == "circle":
        assert any("clock offset not known" in each for each in report.facts)


def test_scales_are_estimated(tmp_path):
    found = findings(Drive(distance_scale=0.92, turn_scale=1.05), tmp_path)
    values = {
        part: next(each for each in found if f"true {part} are" in each) for part in ("distances", "turns")
    }
    assert float(values["distances"].split(" are ")[1].split()[0]) == pytest.approx(0.92, abs=0.005)
    assert float(values["turns"].split(" are ")[1].split()[0]) == pytest.approx(1.05, abs=0.01)


@pytest.mark.parametrize(
    ("replaced", "message"),
    [
        (
            {"odometry": ("\n0.300,", "\n0.150,")},
            "odometry.csv:5: time goes back by 0.05 s, the first of 1 such",
        ),
        (
            {"odometry": ("\n0.300,", "\n0.200,")},
            "odometry.csv:5: a time stamp for the second time, the first of 1",
        ),
        ({"truth": ("\n5.000,", "\n# 5.000,")}, ""),
        ({"detections": ("\n420.0,3,", "\n420.0,,")}, "detections.csv: 1 of 1192 detections have no id"),
        ({"detections": ("\n420.0,3,", "\n420.0,77,")}, "1 landmarks are seen only once, the first is 77"),
        (
            {"detections": ("\n420.0,3,", "\n420.0,6,")},
            "detections.csv:3: landmark 6 stands more than once at one",
        ),
        ({"landmarks": ("\n3,", "\n4,")}, "landmarks.csv: has no landmark 3, nor 0 others"),
        (
            {"detections": ("\n420.0,0,", "\n99420.0,0,")},
            "1 of 1192 rows are outside the odometry's time, 0 to 60 s",
        ),
        ({"odometry": ("v_m_s", "v_m_s ")}, ""),
        ({"odometry": ("t_s,v_m_s,omega_deg_s", "t [s],v [m/s],omega[°/s]")}, ""),
        ({"detections": ("t_ms,id,range_m,bearing_rad", "t (ms);id;range (m);bearing (rad)")}, ""),
        ({"odometry": ("t_s,", "t [µs],")}, "rows are outside the odometry's time"),
        ({"odometry": ("v_m_s", "v []")}, "column 'v' has no unit; one of v_m_s"),
        ({"odometry": ("v_m_s", "v [kn]")}, "column 'v [kn]' is not used; did you mean"),
        ({"odometry": ("\n0.300,", "\n0.3oo,")}, "odometry.csv:5: '0.3oo' is not a finite number"),
        ({"odometry": ("omega_deg_s", "wheel_deg_s")}, "column 'wheel_deg_s' is not used"),
    ],
)
def test_each_kind_of_bad_row(tmp_path, replaced, message):
    found = findings(Drive(), tmp_path, **replaced)
    if message:
        assert any(message in each for each in found), found
    else:
        assert found == []


def test_gaps(tmp_path):
    files = Drive().write(tmp_path)
    rows = files["truth"].read_text().splitlines()
    files["truth"].write_text("\n".join(rows[:400] + rows[430:800] + rows[804:]) + "\n")
    found = check_files(list(files.values())).findings
    assert found == [
        f"{files['truth']}:401: a gap of 1.55 s before this row, the longest of 2 above 2.5 times the "
        "usual 0.05 s"
    ]


def test_what_is_interpolated_over_a_gap_is_compared_with_nothing(tmp_path):
    files = Drive().write(tmp_path)
    rows = files["truth"].read_text().splitlines()
    files["truth"].write_text("\n".join(rows[:400] + rows[480:]) + "\n")
    against = check_files(list(files.values())).against_truth
    for own, theirs in (against.speeds, against.turns):
        np.testing.assert_allclose(own, theirs, atol=0.02)


def test_the_check_is_drawn(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    from slamcmp.report.figures.log_check import log_check_figure

    drive = Drive(odometry_late_s=0.2, distance_scale=0.9, outliers=40)
    files = [str(path) for path in drive.write(tmp_path).values()]
    figure = log_check_figure(check_files([Path(name) for name in files]))
    axes = {each.get_title(loc="left") or each.get_title(): each for each in figure.axes}
    offset = axes["Clock offset -0.20 s"]
    assert offset.lines[0].get_xdata()[np.argmin(offset.lines[0].get_ydata())] == pytest.approx(-0.2)
    assert "Speeds: truth 0.900 × odometry" in axes
    assert [bar.get_height() for bar in axes["Detections of each of 8 landmarks"].patches] == [149] * 8
    errors = next(each for title, each in axes.items() if title.startswith("range: "))
    assert [text.get_text() for text in errors.get_legend().get_texts()][1] == "beyond: 40"
    assert "Time between rows, × the usual" in axes
    # Without truth there is less to see, and it says so.
    bare = log_check_figure(check_files([Path(name) for name in files[:2]]))
    assert any("truth" in text.get_text() for each in bare.axes for text in each.texts)
    with pytest.raises(SystemExit) as ended:
        app(["data", "check", *files, "--plot", str(tmp_path / "log.png")])
    assert ended.value.code == 1
    assert f"drawn: {tmp_path / 'log.png'}\n" in capsys.readouterr().out
    assert (tmp_path / "log.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(
        UsageError, match=r"--plot log\.jpg: a file's name ends in one of \.png, \.svg, \.pdf"
    ):
        app(["data", "check", *files, "--plot", "log.jpg"], standalone_mode=False)


def test_biased_and_wrong_detections(tmp_path):
    assert any("bearing: measured -0.015" in each for each in findings(Drive(bearing_bias=-0.015), tmp_path))
    found = findings(Drive(outliers=40), tmp_path)
    assert any("range is the farthest of 40 outliers (3.4 %) beyond 5 sigma" in each for each in found), found


def test_without_places_of_landmarks_their_own_sightings_place_them(tmp_path):
    """Medians: the outliers are the same forty, and their share of the sightings is no bias."""
    files = Drive(outliers=40).write(tmp_path)
    report = check_files([path for name, path in files.items() if name != "landmarks"])
    assert any(
        "range is the farthest of 40 outliers (3.4 %) beyond 5 sigma" in each for each in report.findings
    )
    assert not any("off in the median" in each for each in report.findings)
    told = [fact for fact in report.facts if "landmarks placed by their own sightings" in fact]
    with_places = check_files(list(files.values())).errors
    assert len(told) == 2
    for name, own in report.errors.items():
        assert own.sigma == pytest.approx(with_places[name].sigma, rel=0.1)


def test_the_command_says_what_is_wrong(tmp_path, capsys):
    files = [str(path) for path in Drive(distance_scale=0.9).write(tmp_path).values()]
    with pytest.raises(SystemExit) as ended:
        app(["data", "check", *files])
    assert ended.value.code == 1
    told = capsys.readouterr().out
    assert (
        "wrong: odometry: true distances are 0.900 times the measured ones, where 1 is expected\n1 findings"
        in told
    )
    Drive().write(tmp_path)
    with pytest.raises(SystemExit) as ended:
        app(["data", "check", *files])
    assert ended.value.code == 0
    assert capsys.readouterr().out.endswith("nothing wrong found\n")
    with pytest.raises(MissingDataError, match=r"none\.csv: there is no such file"):
        app(["data", "check", "none.csv"], standalone_mode=False)
