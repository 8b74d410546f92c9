"""From graph files to logs, and from logs to g2o and back."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slamcmp import geometry as g
from slamcmp.datasets.graphs.g2o_writer import write_g2o
from slamcmp.datasets.graphs.graph import graph_log
from slamcmp.datasets.graphs.graph_file import graph_file
from slamcmp.datasets.graphs.graph_reader import read_graph
from slamcmp.datasets.victoria_park import victoria_park
from slamcmp.datasets.wheel import wheel_file
from slamcmp.errors import DataError, MissingDataError
from slamcmp.models.sensors import make_sensor
from slamcmp.registry import sources
from slamcmp.types import Detections, Frame, Landmarks, Log, MeasurementStream, Problem


def write(tmp_path, *lines):
    path = tmp_path / "some.graph"
    path.write_text("\n".join(lines) + "\n")
    return path


def as_stream(log: Log) -> MeasurementStream:
    return MeasurementStream(
        log.problem,
        tuple(
            Frame(k, float(log.t[k]), log.T_prev_body[k], log.Q[k], seen.ids, seen.z, seen.R)
            for k, seen in enumerate(log.detections)
        ),
    )


def assert_same(ours: MeasurementStream, theirs: MeasurementStream, rtol: float = 1e-12) -> None:
    assert ours.problem.sensor.name == theirs.problem.sensor.name
    np.testing.assert_allclose(theirs.problem.T_world_body, ours.problem.T_world_body, rtol=0, atol=1e-12)
    np.testing.assert_allclose(theirs.problem.P, ours.problem.P, rtol=rtol, atol=rtol * ours.problem.P.max())
    assert len(ours.frames) == len(theirs.frames)
    for a, b in zip(ours.frames, theirs.frames, strict=True):
        assert (a.k, a.t) == (b.k, b.t)
        order = np.argsort(a.ids)
        np.testing.assert_array_equal(b.ids, a.ids[order])
        np.testing.assert_allclose(b.T_prev_body, a.T_prev_body, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(b.z, a.z[order], rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(b.Q, a.Q, rtol=rtol, atol=rtol * np.abs(a.Q).max())
        np.testing.assert_allclose(b.R, a.R[order], rtol=rtol, atol=rtol * np.abs(a.R).max(initial=0))


def read_back(path) -> MeasurementStream:
    return as_stream(graph_log(read_graph(path), name="back"))


# ---- files of the wheel ----


@pytest.mark.parametrize(
    ("name", "frames", "landmarks", "observations", "sensor"),
    [
        ("example.graph", 95, 24, 422, "range_bearing"),
        ("victoriaPark_reduced_1k.g2o", 1000, 48, 606, "relative_position"),
        ("cityTrees_reduced_1k.g2o", 1000, 66, 406, "relative_position"),
        ("known_landmark_localization_20.g2o", 20, 4, 80, "relative_position"),
    ],
)
def test_sizes_of_landmark_files(name, frames, landmarks, observations, sensor):
    log = graph_file(path=name)
    ids = np.concatenate([seen.ids for seen in log.detections])
    assert (len(log.t), len(np.unique(ids)), len(ids)) == (frames, landmarks, observations)
    assert log.problem.sensor.name == sensor
    as_stream(log)


def test_reduced_victoria_park_is_the_start_of_the_whole():
    """Two files of different formats and noise conventions hold the same first thousand poses."""
    reduced = graph_file(path="victoriaPark_reduced_1k.g2o")
    whole = victoria_park(sensor="relative_position", steps=1000)
    np.testing.assert_allclose(reduced.T_prev_body, whole.T_prev_body, rtol=0, atol=1e-14)
    np.testing.assert_allclose(reduced.Q, whole.Q, rtol=1e-9, atol=1e-14)
    compared = 0
    for a, b in zip(reduced.detections, whole.detections, strict=True):
        # The reduced file leaves out landmarks that its thousand poses see only once.
        rows = np.flatnonzero(np.isin(b.ids, a.ids))
        np.testing.assert_array_equal(a.ids, b.ids[rows])
        np.testing.assert_array_equal(a.z, b.z[rows])
        np.testing.assert_allclose(a.R, b.R[rows], rtol=1e-6)
        compared += len(rows)
    assert compared == 606


def test_city_trees_has_the_published_noise():
    log = graph_file(path="cityTrees_reduced_1k.g2o")
    np.testing.assert_allclose(np.sqrt(np.diag(log.Q[1])), [0.02, 0.02, 0.01])
    seen = next(seen for seen in log.detections if seen.ids.size)
    np.testing.assert_allclose(np.sqrt(np.diag(seen.R[0])), [0.1, 0.1])


def optimum_of_w100() -> tuple[gtsam.Values, list[tuple[int, int]]]:
    graph, values, pairs = gtsam.NonlinearFactorGraph(), gtsam.Values(), []
    noise = gtsam.noiseModel.Unit.Create(3)
    for line in wheel_file("w100.graph").read_text().splitlines():
        kind, *fields = line.split()
        if kind == "VERTEX2":
            values.insert(int(fields[0]), gtsam.Pose2(*map(float, fields[1:4])))
        elif kind == "EDGE2":
            step = gtsam.Pose2(*map(float, fields[2:5]))
            graph.add(gtsam.BetweenFactorPose2(int(fields[0]), int(fields[1]), step, noise))
        else:
            pairs.append((int(fields[0]), int(fields[1])))
    graph.add(gtsam.PriorFactorPose2(0, values.atPose2(0), gtsam.noiseModel.Isotropic.Sigma(3, 1e-6)))
    return gtsam.LevenbergMarquardtOptimizer(graph, values).optimize(), pairs


def test_places_of_w100_agree_with_the_optimum_of_the_whole_pose_graph():
    best, pairs = optimum_of_w100()
    position = {i: best.atPose2(i).translation() for i in range(100)}
    # The file's EQUIV pairs are one place up to noise (0.04 m a component), so merging them is fair.
    apart = [np.linalg.norm(position[a] - position[b]) for a, b in pairs]
    assert len(pairs) == 40
    assert max(apart) < 0.07

    log = graph_file(path="w100.graph", closures="places")
    ids = np.concatenate([seen.ids for seen in log.detections])
    assert (len(log.t), len(np.unique(ids)), len(ids)) == (100, 24, 161)
    sensor = log.problem.sensor
    for k, seen in enumerate(log.detections):
        T = best.atPose2(k).matrix()
        for place, z in zip(seen.ids.tolist(), seen.z, strict=True):
            # A place bears the id of the first pose there; nobody sees it before that pose.
            assert place <= k
            np.testing.assert_allclose(sensor.invert(T, z), position[place], rtol=0, atol=0.35)
    errors = np.concatenate(
        [
            sensor.invert(best.atPose2(k).matrix(), seen.z) - [position[i] for i in seen.ids.tolist()]
            for k, seen in enumerate(log.detections)
            if seen.ids.size
        ]
    )
    assert np.sqrt(np.mean(errors**2)) < 0.06


def test_place_landmarks_by_hand(tmp_path):
    path = write(
        tmp_path,
        "EDGE_SE2 0 1 1 0 0 4 0 0 4 0 4",
        "EDGE_SE2 1 2 1 0 0 4 0 0 4 0 4",
        "EDGE_SE2 2 3 0 0 3.141592653589793 4 0 0 4 0 4",
        # From pose 3 (turned round, at x = 2) pose 0 lies 2 m ahead; its noise is 1/2 along pose 0's x.
        "EDGE_SE2 3 0 2 0.1 3.141592653589793 4 0 0 16 0 4",
        # Stored the other way round: pose 1 sees pose 3; at pose 3 this is a sight of pose 1.
        "EDGE_SE2 1 3 1 0 3.141592653589793 4 0 0 16 0 4",
    )
    log = graph_log(read_graph(path), name="hand", closures="places", place_sigma_m=0.02)
    assert [seen.ids.tolist() for seen in log.detections] == [[0], [1], [], [0, 1]]
    for k in (0, 1):
        np.testing.assert_array_equal(log.detections[k].z, [[0, 0]])
        np.testing.assert_allclose(log.detections[k].R, 0.02**2 * np.eye(2)[None])
    np.testing.assert_allclose(log.detections[3].z, [[2, 0.1], [1, 0]], rtol=0, atol=1e-14)
    np.testing.assert_allclose(log.detections[3].R[0], np.diag([1 / 4, 1 / 16]), rtol=0, atol=1e-14)
    # Turned round, heading noise moves the sight of pose 1 sideways: 1/16 + 1/4 * 1 m².
    np.testing.assert_allclose(log.detections[3].R[1], np.diag([1 / 4, 1 / 16 + 1 / 4]), rtol=0, atol=1e-14)


@pytest.mark.parametrize("angle", [0.5, -2.0])
def test_a_places_noise_is_turned_into_the_observers_axes(tmp_path, angle):
    path = write(
        tmp_path,
        "EDGE_SE2 0 1 1 0 0 4 0 0 4 0 4",
        "EDGE_SE2 1 2 1 0 0 4 0 0 4 0 4",
        f"EDGE_SE2 2 0 -2 0.1 {angle} 4 0 0 16 0 4",
    )
    log = graph_log(read_graph(path), name="hand", closures="places")
    # Pose 0's x axis, with sigma 1/2, points along (cos, sin) as seen from pose 2.
    along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    expected = np.outer(along, along) / 4 + np.outer(across, across) / 16
    np.testing.assert_allclose(log.detections[2].R[0], expected, rtol=0, atol=1e-14)
    # In space: a turn about z leaves z's share alone.
    numbers = ["0"] * 21
    for place, value in zip((0, 6, 11, 15, 18, 20), (4, 16, 25, 1, 1, 1), strict=True):
        numbers[place] = str(value)
    spatial = write(
        tmp_path,
        *(f"EDGE_SE3:QUAT {k} {k + 1} 1 0 0 0 0 0 1 " + " ".join(numbers) for k in range(2)),
        f"EDGE_SE3:QUAT 2 0 -2 0.1 0.3 0 0 {np.sin(angle / 2)} {np.cos(angle / 2)} " + " ".join(numbers),
    )
    seen = graph_log(read_graph(spatial), name="hand", closures="places").detections[2]
    np.testing.assert_allclose(seen.z, [[-2, 0.1, 0.3]], rtol=0, atol=1e-14)
    np.testing.assert_allclose(seen.R[0, :2, :2], expected, rtol=0, atol=1e-14)
    np.testing.assert_allclose(seen.R[0, 2], [0, 0, 1 / 25], rtol=0, atol=1e-14)


def test_equivalent_poses_share_a_landmark_and_repeated_sights_are_fused(tmp_path):
    chain = [f"EDGE_SE2 {k} {k + 1} 1 0 0 4 0 0 4 0 4" for k in range(4)]
    path = write(
        tmp_path,
        *chain,
        "EDGE_SE2 4 0 -4 0 0 1 0 0 1 0 1",
        "EDGE_SE2 4 2 -2 0.3 0 3 0 0 3 0 1",
        "EQUIV 2 0",
    )
    log = graph_log(read_graph(path), name="hand", closures="places")
    assert [seen.ids.tolist() for seen in log.detections] == [[0], [], [], [], [0]]
    # Weights 1 and 3.
    np.testing.assert_allclose(log.detections[4].z, [[-2.5, 0.225]], rtol=0, atol=1e-14)
    np.testing.assert_allclose(log.detections[4].R[0], np.eye(2) / 4, rtol=0, atol=1e-14)


def test_bearings_beside_half_a_turn_fuse_there(tmp_path):
    path = write(
        tmp_path, "EDGE_SE2 0 1 1 0 0 4 0 0 4 0 4", "BR 1 5 3.1 2 0.1 0.1", "BR 1 5 -3.1 2.2 0.1 0.1"
    )
    z = graph_log(read_graph(path), name="hand").detections[1].z[0]
    assert z[0] == pytest.approx(2.1)
    assert abs(z[1]) == pytest.approx(np.pi)


def test_places_beside_landmarks_get_ids_of_their_own(tmp_path):
    path = write(
        tmp_path,
        *(f"EDGE_SE2 {k} {k + 1} 1 0 0 4 0 0 4 0 4" for k in range(2)),
        "EDGE_SE2 2 0 -2 0 0 4 0 0 4 0 4",
        "EDGE_SE2_XY 1 7 1 1 4 0 4",
    )
    log = graph_log(read_graph(path), name="hand", closures="places")
    assert [seen.ids.tolist() for seen in log.detections] == [[8], [7], [8]]


def test_steps_never_look_into_the_future():
    whole, short = (graph_file(path="w100.graph", closures="places", steps=steps) for steps in (None, 45))
    assert len(short.t) == 45
    np.testing.assert_array_equal(short.T_prev_body, whole.T_prev_body[:45])
    for a, b in zip(short.detections, whole.detections, strict=False):
        # The whole log has more places: those that only later poses see again.
        assert set(a.ids) <= set(b.ids)


def test_priors_times_and_vertices(tmp_path):
    bare = write(tmp_path, "EDGE_SE2 3 4 1 0 0 4 0 0 4 0 4", "VERTEX_SE2 3 5 6 0.7")
    log = graph_log(read_graph(bare), name="x", time_step_s=0.5, prior_heading_sigma_rad=0.2)
    np.testing.assert_allclose(g.se2_coordinates(log.problem.T_world_body), [5, 6, 0.7])
    np.testing.assert_allclose(log.problem.P, np.diag([1e-12, 1e-12, 0.04]))
    np.testing.assert_array_equal(log.t, [0.0, 0.5])


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["EDGE_SE2 0 1 1 0 0 4 0 0 4 0 4", "VERTEX_SE2 5 0 0 0"], "no edge joins pose 1 and pose 5"),
        (["EDGE_SE2 2 2 1 0 0 4 0 0 4 0 4"], "an edge from pose 2 to itself"),
        (["VERTEX_XY 1 0 0"], "has no poses"),
        (["#slamcmp-sensor range_bearing", "EDGE_SE2_XY 0 1 1 1 4 0 4"], ":2: a relative_position edge"),
        (["BR 0 1 0.1 1 0.1 0.1", "EDGE_SE2_XY 0 1 1 1 4 0 4"], "mixes landmark edges of two kinds"),
        (
            [f"EDGE_SE2 {i} {j} 1 0 0 4 0 0 4 0 4" for i, j in ((0, 1), (1, 2), (2, 0))]
            + ["BR 0 9 0.1 1 0.1 0.1"],
            ":3: a loop closure between poses beside bearing-range edges",
        ),
        (
            ["EDGE_SE2 0 1 1 0 0 4 0 0 4 0 4", "EDGE_PRIOR_SE2 1 0 0 0 4 0 0 4 0 4"],
            r":2: a prior on pose 1; only the first pose \(0\)",
        ),
    ],
)
def test_graphs_that_are_no_logs(tmp_path, lines, message):
    with pytest.raises(DataError, match=message):
        graph_log(read_graph(write(tmp_path, *lines)), name="x", closures="places")


def test_registered_with_its_file(tmp_path):
    plugin = sources.get("graph_file")
    assert plugin.traits["files"](path="w100.graph", steps=3) == [wheel_file("w100.graph")]
    with pytest.raises(MissingDataError, match=r"w100\.grph"):
        graph_file(path="w100.grph")


# ---- writing and reading back ----


@pytest.mark.parametrize("sensor", ["range_bearing", "relative_position"])
def test_victoria_park_round_trip(tmp_path, sensor):
    log = victoria_park(sensor=sensor, steps=800)
    path = tmp_path / "park.g2o"
    write_g2o(path, log)
    assert_same(as_stream(log), read_back(path))
    write_g2o(path, as_stream(log))
    assert_same(as_stream(log), read_back(path))


def test_spatial_round_trip(tmp_path):
    log = graph_file(path="known_landmark_localization_20.g2o", prior_heading_sigma_rad=0.01)
    path = tmp_path / "space.g2o"
    write_g2o(path, log)
    assert_same(as_stream(log), read_back(path))


def covariances(dim: int, draw: st.DrawFn) -> np.ndarray:
    """Full covariances with condition numbers up to about 1e3."""
    A = np.array(draw(st.lists(st.floats(-1, 1), min_size=dim * dim, max_size=dim * dim))).reshape(dim, dim)
    scale = draw(st.sampled_from([1e-4, 1e-2, 1.0]))
    return scale * (A @ A.T + 0.05 * np.eye(dim))


@st.composite
def streams(draw: st.DrawFn) -> MeasurementStream:
    n = draw(st.sampled_from([2, 3]))
    p = 3 if n == 2 else 6
    name = draw(st.sampled_from(["range_bearing", "relative_position"])) if n == 2 else "relative_position"
    sensor = make_sensor(name, {"space_dim": n} if name == "relative_position" else {})

    def pose() -> np.ndarray:
        return g.exp(np.array(draw(st.lists(st.floats(-3, 3), min_size=p, max_size=p))))

    frames = []
    t = draw(st.floats(-10, 10))
    for k in range(draw(st.integers(1, 4))):
        ids = draw(st.lists(st.integers(0, 40), max_size=3, unique=True))
        if name == "range_bearing":
            z = [[draw(st.floats(0.1, 50)), draw(st.floats(-3.14, 3.14))] for _ in ids]
        else:
            z = [[draw(st.floats(-50, 50)) for _ in range(n)] for _ in ids]
        R = [covariances(n, draw) for _ in ids]
        frames.append(
            Frame(
                k,
                t,
                pose() if k else np.eye(n + 1),
                covariances(p, draw) if k else np.zeros((p, p)),
                ids,
                np.reshape(z, (len(ids), n)),
                np.reshape(R, (len(ids), n, n)),
            )
        )
        t += draw(st.floats(0.01, 5))
    return MeasurementStream(Problem(pose(), covariances(p, draw), sensor), tuple(frames))


@given(stream=streams())
@settings(max_examples=80, deadline=None, derandomize=True)
def test_any_stream_round_trips(tmp_path_factory, stream):
    path = tmp_path_factory.mktemp("g2o") / "any.g2o"
    write_g2o(path, stream)
    # Inverting twice costs the condition number, up to 1e3, times the rounding error.
    assert_same(stream, read_back(path), rtol=1e-11)


def test_estimates_become_vertices_and_ids_never_clash(tmp_path):
    log = victoria_park(steps=60)
    generator = np.random.default_rng(2)
    poses = g.se2(*generator.uniform(-3, 3, (3, 60)))
    landmarks = Landmarks([5, 900], [[1.0, 2.0], [3.0, 4.0]], np.zeros((2, 2, 2)))
    path = tmp_path / "vertices.g2o"
    write_g2o(path, log, poses=poses, landmarks=landmarks)
    graph = read_graph(path)
    assert sorted(graph.poses) == list(range(901, 961))
    assert not graph.poses.keys() & graph.landmarks.keys()
    for k in range(60):
        np.testing.assert_allclose(graph.poses[901 + k], poses[k], rtol=0, atol=1e-14)
    np.testing.assert_array_equal(graph.landmarks[5], [1, 2])
    np.testing.assert_array_equal(graph.landmarks[900], [3, 4])
    # Without an estimate a landmark stands where it was first seen.
    first = next((k, seen) for k, seen in enumerate(log.detections) if 9 in seen.ids)
    z = first[1].z[first[1].ids.tolist().index(9)]
    np.testing.assert_allclose(graph.landmarks[9], log.problem.sensor.invert(poses[first[0]], z))
    # gtsam reads the poses and the odometry of the same file.
    with_gtsam, initial = gtsam.readG2o(str(path), False)
    between = [
        with_gtsam.at(i)
        for i in range(with_gtsam.size())
        if isinstance(with_gtsam.at(i), gtsam.BetweenFactorPose2)
    ]
    assert len(between) == 59
    np.testing.assert_allclose(initial.atPose2(930).matrix(), poses[29], rtol=0, atol=1e-12)


def test_what_information_cannot_hold_is_refused(tmp_path):
    def log(Q, R, ids, P=None):
        none = Detections(np.empty((0, 2)), np.empty((0, 2, 2)), [])
        seen = Detections(np.ones((1, 2)), R[None], ids)
        problem = Problem(np.eye(3), np.eye(3) if P is None else P, make_sensor("range_bearing", {}))
        return Log("x", problem, [0, 1], np.tile(np.eye(3), (2, 1, 1)), [0 * Q, Q], (none, seen))

    path = tmp_path / "no.g2o"
    with pytest.raises(DataError, match="Q of frame 1 is singular"):
        write_g2o(path, log(np.diag([1.0, 0.0, 1.0]), np.eye(2), [1]))
    with pytest.raises(DataError, match="the prior's P is singular"):
        write_g2o(path, log(np.eye(3), np.eye(2), [1], P=np.zeros((3, 3))))
    with pytest.raises(DataError, match="R of landmark 1 in frame 1 is singular"):
        write_g2o(path, log(np.eye(3), np.zeros((2, 2)), [1]))
    with pytest.raises(DataError, match="ids from 0 on"):
        write_g2o(path, log(np.eye(3), np.eye(2), [-1]))
    with pytest.raises(DataError, match="3 poses for 2 frames"):
        write_g2o(path, log(np.eye(3), np.eye(2), [1]), poses=np.tile(np.eye(3), (3, 1, 1)))
    assert not path.exists()
