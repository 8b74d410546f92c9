"""The graph reader: each kind's convention, by hand and against gtsam's own reader, and every complaint."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from slamcmp import geometry as g
from slamcmp.datasets.graphs.graph import graph_log
from slamcmp.datasets.graphs.graph_reader import read_graph
from slamcmp.datasets.graphs.odometry_chain import turned
from slamcmp.datasets.wheel import wheel_file
from slamcmp.errors import DataError, MissingDataError


def write(tmp_path, *lines, name="some.g2o"):
    path = tmp_path / name
    path.write_text("\n".join(lines) + "\n")
    return path


def test_toro_order_by_hand(tmp_path):
    # I11 I12 I22 I33 I13 I23
    path = write(tmp_path, "EDGE2 0 1 1 2 0.5 10 1 20 30 2 3")
    edge = read_graph(path).pose_edges[0]
    information = np.array([[10, 1, 2], [1, 20, 3], [2, 3, 30]])
    np.testing.assert_allclose(edge.covariance, np.linalg.inv(information), rtol=1e-12)
    np.testing.assert_allclose(g.se2_coordinates(edge.T), [1, 2, 0.5])
    assert (edge.first, edge.second) == (0, 1)


def test_rows_by_hand(tmp_path):
    path = write(tmp_path, "EDGE_SE2 0 1 1 2 0.5 10 1 2 20 3 30", "EDGE_SE2_XY 0 7 1 2 10 1 20")
    graph = read_graph(path)
    information = np.array([[10, 1, 2], [1, 20, 3], [2, 3, 30]])
    np.testing.assert_allclose(graph.pose_edges[0].covariance, np.linalg.inv(information), rtol=1e-12)
    seen = graph.landmark_edges[0]
    assert (seen.pose, seen.landmark, seen.sensor) == (0, 7, "relative_position")
    np.testing.assert_allclose(seen.covariance, np.linalg.inv([[10, 1], [1, 20]]), rtol=1e-12)


def test_edge2_row_by_row_where_toros_order_cannot_be(tmp_path):
    edge = read_graph(write(tmp_path, "EDGE2 0 1 1 2 0.5 4 0 0 5 0 8")).pose_edges[0]
    np.testing.assert_allclose(edge.covariance, np.diag([1 / 4, 1 / 5, 1 / 8]))


def test_noise_can_be_square_roots_or_covariances(tmp_path):
    path = write(tmp_path, "ODOMETRY 0 1 1 2 0.5 2 1 0 4 0 8", "LANDMARK 1 5 3 4 2 0 4")
    roots = read_graph(path, noise="square_root_information")
    U = np.array([[2, 1, 0], [0, 4, 0], [0, 0, 8.0]])
    np.testing.assert_allclose(roots.pose_edges[0].covariance, np.linalg.inv(U.T @ U), rtol=1e-12)
    np.testing.assert_allclose(roots.landmark_edges[0].covariance, np.diag([1 / 4, 1 / 16]))
    plain = read_graph(path, noise="covariance")
    np.testing.assert_allclose(plain.landmark_edges[0].covariance, np.diag([2.0, 4.0]))
    with pytest.raises(DataError, match="set noise to 'covariance' or 'square_root_information'"):
        read_graph(path)


def test_bearing_range_kinds(tmp_path):
    path = write(tmp_path, "BR 0 9 0.25 4 0.02 0.1", "EDGE_BEARING_RANGE_SE2_XY 0 8 -0.5 3 100 5 25")
    br, own = read_graph(path).landmark_edges
    assert br.sensor == own.sensor == "range_bearing"
    np.testing.assert_array_equal(br.measured, [4, 0.25])
    np.testing.assert_allclose(br.covariance, np.diag([0.1**2, 0.02**2]))
    np.testing.assert_array_equal(own.measured, [3, -0.5])
    np.testing.assert_allclose(own.covariance, np.linalg.inv([[25, 5], [5, 100]]), rtol=1e-12)


@pytest.mark.parametrize(
    ("name", "noise"), [("victoriaPark_reduced_1k.g2o", "information"), ("example.graph", "auto")]
)
def test_planar_pose_edges_agree_with_gtsams_reader(name, noise):
    ours = read_graph(wheel_file(name), noise=noise)
    theirs, _ = (
        gtsam.readG2o(str(wheel_file(name)), False)
        if name.endswith("g2o")
        else gtsam.load2D(str(wheel_file(name)))
    )
    factors = [theirs.at(i) for i in range(theirs.size())]
    between = {tuple(f.keys()): f for f in factors if isinstance(f, gtsam.BetweenFactorPose2)}
    assert len(between) == len(ours.pose_edges)
    for edge in ours.pose_edges:
        factor = between[(edge.first, edge.second)]
        np.testing.assert_allclose(edge.T, factor.measured().matrix(), rtol=0, atol=1e-14)
        covariance = np.linalg.inv(factor.noiseModel().information())
        np.testing.assert_allclose(edge.covariance, covariance, rtol=1e-9, atol=1e-14)


def test_bearing_range_edges_agree_with_gtsams_reader():
    ours = read_graph(wheel_file("example.graph"))
    theirs, _ = gtsam.load2D(str(wheel_file("example.graph")))
    factors = [theirs.at(i) for i in range(theirs.size())]
    seen = [f for f in factors if isinstance(f, gtsam.BearingRangeFactor2D)]
    assert len(seen) == len(ours.landmark_edges) == 422
    for edge, factor in zip(ours.landmark_edges, seen, strict=True):
        assert edge.pose == factor.keys()[0]
        assert edge.landmark == gtsam.Symbol(factor.keys()[1]).index()
        measured = factor.measured()
        np.testing.assert_allclose(
            edge.measured, [measured.range(), measured.bearing().theta()], rtol=0, atol=1e-12
        )
        sigmas = factor.noiseModel().sigmas()
        np.testing.assert_allclose(np.sqrt(np.diag(edge.covariance)), sigmas[::-1], rtol=1e-12)


@pytest.mark.parametrize("name", ["Klaus3.g2o", "known_landmark_localization_20.g2o"])
def test_spatial_edges_agree_with_gtsams_reader(name):
    ours = read_graph(wheel_file(name))
    assert ours.space_dim == 3
    theirs, initial = gtsam.readG2o(str(wheel_file(name)), True)
    factors = [theirs.at(i) for i in range(theirs.size())]
    between = {tuple(f.keys()): f for f in factors if isinstance(f, gtsam.BetweenFactorPose3)}
    for edge in ours.pose_edges:
        factor = between[(edge.first, edge.second)]
        np.testing.assert_allclose(edge.T, factor.measured().matrix(), rtol=0, atol=1e-6)
        covariance = np.linalg.inv(factor.noiseModel().information())
        np.testing.assert_allclose(edge.covariance, covariance, rtol=0, atol=1e-12)
    for pose, T in ours.poses.items():
        np.testing.assert_allclose(T, initial.atPose3(pose).matrix(), rtol=0, atol=1e-6)
    assert ours.landmark_edges or name == "Klaus3.g2o"


def test_spatial_information_moves_rotation_to_the_front(tmp_path):
    generator = np.random.default_rng(3)
    A = generator.standard_normal((6, 6))
    information = A @ A.T + 6 * np.eye(6)
    numbers = " ".join(repr(float(x)) for x in information[np.triu_indices(6)])
    path = write(tmp_path, f"EDGE_SE3:QUAT 0 1 1 2 3 0 0 0 1 {numbers}")
    covariance = read_graph(path).pose_edges[0].covariance
    expected = np.linalg.inv(information)
    np.testing.assert_allclose(covariance[:3, :3], expected[3:, 3:], rtol=1e-10)
    np.testing.assert_allclose(covariance[3:, 3:], expected[:3, :3], rtol=1e-10)
    np.testing.assert_allclose(covariance[:3, 3:], expected[3:, :3], rtol=1e-10)


def test_sensor_offsets_are_folded_into_the_measurement(tmp_path):
    # The sensor sits 1 m ahead and looks to the left: its x axis is the body's y axis.
    turn = "0 0 0.7071067811865476 0.7071067811865476"
    path = write(tmp_path, "EDGE_SE3_TRACKXYZ 0 4 2 3 0 0 1 0 0 4 0 16", f"PARAMS_SE3OFFSET 2 1 0 0 {turn}")
    edge = read_graph(path).landmark_edges[0]
    np.testing.assert_allclose(edge.measured, [1, 3, 0], rtol=0, atol=1e-14)
    np.testing.assert_allclose(edge.covariance, np.diag([1 / 4, 1.0, 1 / 16]), rtol=0, atol=1e-14)
    plain = read_graph(wheel_file("edge_se3_trackxyz_example.g2o")).landmark_edges[0]
    shifted = read_graph(wheel_file("edge_se3_trackxyz_nonidentity_offset.g2o")).landmark_edges[0]
    np.testing.assert_allclose(plain.measured, [2, 1, 3])
    np.testing.assert_allclose(shifted.measured, [2.1, 1, 3])


def test_turning_an_edge_keeps_its_cost():
    """gtsam's BetweenFactor with the turned measurement has the same error at any poses."""
    generator = np.random.default_rng(8)
    graph = read_graph(wheel_file("w100.graph"))
    for edge in graph.pose_edges[:20]:
        A = generator.standard_normal((3, 3))
        edge = type(edge)(edge.first, edge.second, edge.T, A @ A.T + np.eye(3), edge.where)
        values = gtsam.Values()
        for key in (edge.first, edge.second):
            values.insert(key, gtsam.Pose2(*generator.uniform(-2, 2, 3)))
        errors = []
        for e in (edge, turned(edge)):
            noise = gtsam.noiseModel.Gaussian.Covariance(e.covariance)
            measured = gtsam.Pose2(*g.se2_coordinates(e.T))
            errors.append(gtsam.BetweenFactorPose2(e.first, e.second, measured, noise).error(values))
        assert errors[0] == pytest.approx(errors[1], rel=1e-9)


def test_comments_blank_lines_and_known_extras(tmp_path):
    path = write(
        tmp_path,
        "# a comment",
        "",
        "FIX 0",
        "VERTEX_SE2 0 1 2 3 # trailing",
        "VERTEX_XY 9 4 5",
        "EQUIV 3 1",
        "#slamcmp-time 0 2.5",
        "EDGE_PRIOR_SE2 0 1 2 3 4 0 0 4 0 4",
    )
    graph = read_graph(path)
    np.testing.assert_allclose(g.se2_coordinates(graph.poses[0]), [1, 2, 3])
    np.testing.assert_array_equal(graph.landmarks[9], [4, 5])
    assert graph.equivalent == [(3, 1)]
    assert graph.times == {0: 2.5}
    np.testing.assert_allclose(graph.prior.covariance, 0.25 * np.eye(3))


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (
            ["EDGE_SE2 0 1 1 2"],
            r":1: EDGE_SE2 is followed by 4 numbers where 11 are needed: i j dx dy dtheta",
        ),
        (["", "VERTEX_SE2 0 1 2 x"], r":2: 'x' is not a finite number"),
        (["VERTEX_SE2 0 1 2 nan"], r":1: 'nan' is not a finite number"),
        (["VERTEX_SE2 0.5 1 2 3"], r":1: '0.5' is not an id"),
        (["VERTEX_XY 0 1 2", "VERTEX_XY 0 1 2"], r":2: VERTEX_XY 0 stands twice"),
        (["EDGE_SE2_XY 0 1 1 2 1 2 1"], r":1: the noise numbers are not a positive definite information"),
        (["EDGE2 0 1 1 2 0 1 2 1 1 0 0"], r":1: .*TORO's order"),
        (["BR 0 1 0.1 -4 0.1 0.1"], r":1: the range is -4.0; a positive one"),
        (["BR 0 1 0.1 4 0 0.1"], r":1: BR has sigmas 0.0 and 0.1; positive ones"),
        (["VERTEX_SE3:QUAT 0 0 0 0 0 0 0 2"], r":1: the quaternion has norm 2; 1 is needed"),
        (["EDGE_SE3_TRACKXYZ 0 1 5 0 0 1 1 0 0 1 0 1"], r":1: there is no PARAMS_SE3OFFSET 5"),
        (["VERTEX_SE2 0 0 0 0", "VERTEX_TRACKXYZ 1 0 0 0"], r":1 is planar and .*:2 spatial"),
        (["VERTEX_SE2 0 0 0 0", "VERTEX_SE2 1 0 0 0", "FIX 1"], r":3: FIX 1; only the first pose"),
        (["EDGE_PRIOR_SE2 0 1 2 3 4 0 0 4 0 4"] * 2, r":2: a second prior; the first is at .*:1"),
        (["EDGE_SE3_PRIOR 0 0 1 2 3 0 0 0 1" + " 1" * 21], r":1: EDGE_SE3_PRIOR uses offset 0"),
        (["MYSTERY 1", "MYSTERY 2"], r"does not know: 2 x MYSTERY \(first at line 1\); it knows BR, EDGE2"),
        (["#slamcmp-sensor sonar"], r":1: sensor 'sonar'; range_bearing or relative_position is needed"),
        (["#slamcmp-time 0"], r":1: #slamcmp-time is followed by 1 numbers where 2"),
    ],
)
def test_complaints_name_the_place_and_the_remedy(tmp_path, lines, message):
    path = write(tmp_path, *lines)
    with pytest.raises(DataError, match=message) as raised:
        read_graph(path)
    assert str(raised.value).startswith(str(path))


def test_unknown_kinds_are_counted_aloud(tmp_path):
    path = write(tmp_path, "VERTEX_SE2 0 0 0 0", "EDGE_BEARING_SE2_XY 0 1 0.3 5", "WEIRD", "WEIRD")
    expected = "1 x EDGE_BEARING_SE2_XY (first at line 2), 2 x WEIRD (first at line 3)"
    (told,) = graph_log(read_graph(path), name="some").warnings
    assert told == f"some.g2o: left out lines of kinds this reader does not know: {expected}"
    assert read_graph(wheel_file("example.graph")).warnings == []


def test_missing_and_binary_files(tmp_path):
    with pytest.raises(MissingDataError, match="no such graph file"):
        read_graph(tmp_path / "none.g2o")
    path = tmp_path / "binary.g2o"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DataError, match="not a text file"):
        read_graph(path)
