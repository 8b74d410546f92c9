"""Graphs whose ids are any names, and graphs that are no chain of odometry.

Right values by hand or by gtsam.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import gtsam
import numpy as np
import pytest

from slamcmp import geometry as g
from slamcmp.datasets.graphs.graph import graph_log
from slamcmp.datasets.graphs.graph_file import graph_file
from slamcmp.datasets.graphs.graph_reader import read_graph
from slamcmp.datasets.graphs.graph_types import PoseEdge, name_of
from slamcmp.datasets.graphs.odometry_chain import fused
from slamcmp.errors import DataError
from slamcmp.types import Log

NOISE = "10000 0 0 10000 0 10000"


def chain(*poses: int) -> list[str]:
    """A robot that goes 1 m ahead a step, past these poses."""
    return [f"EDGE_SE2 {a} {b} 1 0 0 {NOISE}" for a, b in pairwise(poses)]


def sights(landmark: int, *poses: int) -> list[str]:
    """Of a landmark at (2, 3) from the poses at x = 0, 1, …"""
    return [f"EDGE_SE2_XY {pose} {landmark} {2 - k} 3 100 0 100" for k, pose in enumerate(poses)]


def log_of(tmp_path: Path, *lines: str, **settings) -> Log:
    path = tmp_path / "some.g2o"
    path.write_text("\n".join(lines) + "\n")
    return graph_log(read_graph(path), name="some", **settings)


def refused(tmp_path: Path, *lines: str) -> str:
    with pytest.raises(DataError) as raised:
        log_of(tmp_path, *lines)
    return str(raised.value).removeprefix(f"{tmp_path / 'some.g2o'}")


# ---- ids are names ----


def test_negative_landmarks_are_used_and_keep_their_names(tmp_path):
    poses = range(5)
    log = log_of(tmp_path, *chain(*poses), *(line for i in (-1, -2, 7) for line in sights(i, *poses)))
    assert [seen.ids.tolist() for seen in log.detections] == [[0, 1, 2]] * 5
    assert log.own_ids.tolist() == [-2, -1, 7]
    assert "from 0 = -2 to 2 = 7" in log.warnings[0]


def test_ids_that_fit_are_left_alone(tmp_path):
    log = log_of(tmp_path, *chain(0, 1), *sights(1 << 50, 0, 1), *sights(0, 0, 1))
    assert log.detections[0].ids.tolist() == [0, 1 << 50]
    assert log.own_ids is None
    assert log.warnings == ()


@pytest.mark.parametrize("offset", [0, 7, -5, 1 << 40])
def test_negative_poses_close_their_loop(tmp_path, offset):
    poses = [offset + k - 3 for k in range(5)]
    log = log_of(tmp_path, *chain(*poses), f"EDGE_SE2 {poses[4]} {poses[0]} -4 0 0 {NOISE}")
    related = log.relative_poses[4]
    assert related.frames.tolist() == [0]
    np.testing.assert_allclose(related.T_earlier_body[0], g.se2(4, 0, 0), atol=1e-15)
    assert [each is None for each in log.relative_poses] == [True] * 4 + [False]


def test_keys_of_gtsams_symbols(tmp_path):
    poses = [gtsam.symbol("x", k) for k in range(4)]
    trees = [gtsam.symbol("l", k) for k in (1, 2)]
    log = log_of(tmp_path, *chain(*poses), *(line for tree in trees for line in sights(tree, *poses)))
    assert log.own_ids.tolist() == trees
    assert [seen.ids.tolist() for seen in log.detections] == [[0, 1]] * 4
    assert f"0 = {trees[0]} (l1)" in log.warnings[0]
    assert name_of(poses[3]) == f"{poses[3]} (x3)"
    # A chain of one robot and one of another have no edge between them.
    told = refused(tmp_path, *chain(*poses), *chain(*(gtsam.symbol("y", k) for k in range(2))))
    assert f"no edge joins pose {poses[3]} (x3) and pose {gtsam.symbol('y', 0)} (y0)" in told


@pytest.mark.parametrize("name", [-1, -(1 << 62), 12, 1 << 33])
def test_other_numbers_are_no_symbols(name):
    assert name_of(name) == str(name)


# ---- what is no chain of odometry ----


@pytest.mark.parametrize("marker", [100, 6, -7])
@pytest.mark.parametrize("vertex", [True, False])
def test_a_marker_stored_as_a_pose_is_refused_with_its_line(tmp_path, marker, vertex):
    lines = [
        *chain(0, 1, 2, 3),
        f"EDGE_SE2 0 {marker} 2 3 0 {NOISE}",
        f"EDGE_SE2 3 {marker} -1 3 0 {NOISE}",
    ]
    told = refused(tmp_path, *([f"VERTEX_SE2 {marker} 2 3 0"] if vertex else []), *lines)
    assert told.startswith(":1: " if vertex else ":4: ")
    assert f"pose {marker} is only looked at (from 0, 3)" in told


def test_a_marker_numbered_among_the_poses_is_refused(tmp_path):
    lines = [*chain(0, 1, 3, 4), f"EDGE_SE2 1 2 1 3 0 {NOISE}", f"EDGE_SE2 3 2 0 3 0 {NOISE}"]
    assert "pose 2 is only looked at (from 1, 3)" in refused(tmp_path, *lines)


@pytest.mark.parametrize(("marker", "reason"), [
    (100, "does not follow pose 3 in the numbering"),
    (4, "its edges lead the other way from those of the other poses"),
])  # fmt: skip
def test_a_marker_whose_edges_lead_from_it_is_named_itself(tmp_path, marker, reason):
    back = [f"EDGE_SE2 {marker} {k} {k - 2} -3 0 {NOISE}" for k in (0, 3)]
    told = refused(tmp_path, *chain(0, 1, 2, 3), *back)
    assert told.startswith(f":4: pose {marker} only looks at others (0, 3) and {reason}")
    among = [f"EDGE_SE2 2 {k} {k - 2} -3 0 {NOISE}" for k in (1, 3)]
    told = refused(tmp_path, *chain(0, 1, 3, 4), *among)
    assert told.startswith(":4: pose 2 only looks at others (1, 3) and the poses beside it are joined")


def test_an_edge_between_poses_ends_at_no_landmarks_vertex(tmp_path):
    told = refused(tmp_path, "VERTEX_XY 4 1 1", *chain(0, 1, 2, 3, 4))
    assert told.startswith(":5: an edge between poses, but 4 is a landmark's vertex")
    # Where poses and landmarks have numbers of their own, 2 is both.
    assert len(log_of(tmp_path, "VERTEX_XY 2 1 1", *chain(0, 1, 2, 3), *sights(2, 0, 1)).t) == 4


def test_a_jump_of_the_numbering_is_told(tmp_path):
    # A second session, or markers that are joined with one another: the file cannot tell.
    log = log_of(tmp_path, *chain(0, 1, 2, 3, 100, 101))
    assert "the numbers of the poses jump from 3 to 100" in log.warnings[0]
    assert log_of(tmp_path, *chain(*range(0, 60, 3))).warnings == ()
    assert log_of(tmp_path, *chain(3, 7, 8, 12, 19)).warnings == ()


def test_chains_with_other_steps_than_one_are_chains(tmp_path):
    # Every tenth pose; ids that landmarks have taken; keyframes as they came.
    assert len(log_of(tmp_path, *chain(0, 10, 20, 30)).t) == 4
    assert len(log_of(tmp_path, *chain(0, 1, 2, 4), *sights(3, 0, 1, 2, 4)).t) == 4
    assert len(log_of(tmp_path, *chain(3, 7, 8, 12, 19)).t) == 5
    backwards = [f"EDGE_SE2 {k + 1} {k} -1 0 0 {NOISE}" for k in range(3)]
    assert len(log_of(tmp_path, *backwards, f"EDGE_SE2 3 0 -3 0 0 {NOISE}").t) == 4
    # Each pose is needed to hold the chain together, so edges in both directions are odometry.
    both_ways = log_of(tmp_path, *chain(0, 1), backwards[1], *chain(2, 3))
    np.testing.assert_allclose(both_ways.T_prev_body[1:], [g.se2(1, 0, 0)] * 3, atol=1e-15)


def test_a_vertex_missing_where_the_others_have_one(tmp_path):
    vertices = [f"VERTEX_SE2 {k} {k} 0 0" for k in range(4)]
    told = refused(tmp_path, *vertices, *chain(0, 1, 2, 3), f"EDGE_SE2 3 9999 -3 0 0 {NOISE}")
    assert told.startswith(":8: pose 9999 has no vertex in the file, where 4 of the 5 poses")
    told = refused(
        tmp_path, *vertices, "VERTEX_XY 7 2 3", "VERTEX_XY 8 2 3", *chain(0, 1, 2, 3),
        *sights(7, 0), *sights(8, 1), *sights(77, 1),
    )  # fmt: skip
    assert told.startswith(":12: landmark 77 has no vertex in the file, where 2 of the 3 landmarks")
    # Starting values for the first pose only are common.
    assert len(log_of(tmp_path, vertices[0], *chain(0, 1, 2, 3)).t) == 4


# ---- parallel edges ----


def test_two_odometry_edges_are_one_motion(tmp_path):
    log = log_of(
        tmp_path,
        f"EDGE_SE2 0 1 1.00 0 0.00 {NOISE}",
        f"EDGE_SE2 0 1 1.02 0 0.02 {NOISE}",
        f"EDGE_SE2 1 2 1 0 0 {NOISE}",
    )
    np.testing.assert_allclose(g.se2_coordinates(log.T_prev_body[1]), [1.01, 0, 0.01], rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.sqrt(np.diag(log.Q[1])), [0.00707] * 3, rtol=0, atol=1e-5)
    assert log.relative_poses is None


@pytest.mark.parametrize("dim", [2, 3])
def test_fusing_is_what_gtsam_makes_of_parallel_edges(dim):
    """The optimum and the marginal covariance of a graph of the same between factors."""
    generator = np.random.default_rng(dim)
    p = 3 if dim == 2 else 6
    truth = g.exp(generator.normal(size=p))
    edges, graph, values = [], gtsam.NonlinearFactorGraph(), gtsam.Values()
    pose = (lambda T: gtsam.Pose2(*g.se2_coordinates(T))) if dim == 2 else gtsam.Pose3
    between = gtsam.BetweenFactorPose2 if dim == 2 else gtsam.BetweenFactorPose3
    for key in (0, 1):
        values.insert(key, pose(truth if key else np.eye(dim + 1)))
    for row in range(3):
        A = generator.normal(size=(p, p))
        covariance = 1e-4 * (A @ A.T + np.eye(p))
        T = truth @ g.exp(generator.multivariate_normal(np.zeros(p), covariance))
        edges.append(PoseEdge(0, 1, T, covariance, f"file:{row}"))
        graph.add(between(0, 1, pose(T), gtsam.noiseModel.Gaussian.Covariance(covariance)))
    graph.add(
        (gtsam.PriorFactorPose2 if dim == 2 else gtsam.PriorFactorPose3)(
            0, pose(np.eye(dim + 1)), gtsam.noiseModel.Isotropic.Sigma(p, 1e-7)
        )
    )
    settings = gtsam.LevenbergMarquardtParams()
    settings.setRelativeErrorTol(1e-14)
    settings.setAbsoluteErrorTol(0.0)
    best = gtsam.LevenbergMarquardtOptimizer(graph, values, settings).optimize()
    one = fused(edges)
    theirs = (best.atPose2(1) if dim == 2 else best.atPose3(1)).matrix()
    np.testing.assert_allclose(one.T, theirs, rtol=0, atol=1e-7)
    covariance = gtsam.Marginals(graph, best).marginalCovariance(1)
    np.testing.assert_allclose(one.covariance, covariance, rtol=1e-6, atol=1e-12)


def test_parallel_edges_beside_bearing_range_sights(tmp_path):
    log = log_of(tmp_path, *chain(0, 1, 2), *chain(0, 1), "BR 0 9 0.3 2.0 0.01 0.1")
    np.testing.assert_allclose(np.sqrt(np.diag(log.Q[1])), np.sqrt(0.5) * np.full(3, 0.01))
    np.testing.assert_allclose(log.T_prev_body[1], g.se2(1, 0, 0), atol=1e-15)


def test_contradictions_are_refused_with_their_lines(tmp_path):
    told = refused(tmp_path, *chain(0, 1), f"EDGE_SE2 1 0 -1.5 0 0 {NOISE}")
    assert told.startswith(":1: this edge and that of line 2 measure the same motion")
    twice = ["EDGE_SE2_XY 1 7 2 3 100 0 100", "EDGE_SE2_XY 1 7 5 9 100 0 100"]
    told = refused(tmp_path, *chain(0, 1), *twice)
    assert told.startswith(":2: this sight of landmark 7 and that of line 3 are from the same pose")
    bearings = ["BR 1 -7 0.1 4 0.01 0.1", "BR 1 -7 0.4 4 0.01 0.1"]
    told = refused(tmp_path, *chain(0, 1), *bearings)
    assert told.startswith(":2: this sight of landmark -7 ")
    # Half a turn from either side is one bearing, and three sigmas are no contradiction.
    half = ["BR 1 7 3.14159 4 0.01 0.1", "BR 1 7 -3.14159 4.3 0.01 0.1"]
    assert log_of(tmp_path, *chain(0, 1), *half).detections[1].z[0, 0] == pytest.approx(4.15)


# ---- lines ----


def test_fix_takes_several_ids(tmp_path):
    assert len(log_of(tmp_path, *chain(0, 1), "FIX 0").t) == 2
    assert refused(tmp_path, *chain(0, 1), "FIX 0 1").startswith(":2: FIX 1; only the first pose can be held")
    assert ":2: FIX is followed by 0 numbers where at least 1 are needed: ids" in refused(
        tmp_path, *chain(0, 1), "FIX"
    )


@pytest.mark.parametrize("small", [1e-18, 1e-9, 1.0])
def test_definite_is_a_matter_of_correlation(tmp_path, small):
    """Information of 1e18 beside 100: a direction known well, no fault; nor with a correlation of 0.9."""
    log = log_of(tmp_path, f"EDGE_SE2 0 1 1 0 0 {1 / small!r} 0 0 {1 / small!r} 0 100")
    np.testing.assert_allclose(np.diag(log.Q[1]), [small, small, 0.01], rtol=1e-12)
    cross = 0.9 * float(np.sqrt(100 / small))
    log = log_of(tmp_path, f"EDGE_SE2 0 1 1 0 0 {1 / small!r} 0 {cross!r} {1 / small!r} 0 100")
    expected = np.array([small, 0.01]) / (1 - 0.81)
    np.testing.assert_allclose(np.diag(log.Q[1])[[0, 2]], expected, rtol=1e-9)
    told = refused(tmp_path, f"EDGE_SE2 0 1 1 0 0 {1 / small!r} 0 {cross / 0.9!r} {1 / small!r} 0 100")
    assert told.startswith(":1: the noise numbers are not a positive definite information")


def test_a_last_line_that_was_cut_is_told(tmp_path):
    path = tmp_path / "cut.g2o"
    path.write_text("\n".join(chain(0, 1))[:-4])
    assert "the last line is not ended by a line break" in read_graph(path).warnings[0]
    path.write_text("\n".join(chain(0, 1))[:-6])
    with pytest.raises(DataError, match=r"cut\.g2o:1: EDGE_SE2 is followed by 10 numbers"):
        read_graph(path)


def test_stamps_are_all_there_and_go_forward(tmp_path):
    stamps = ["#slamcmp-time 0 1.5", "#slamcmp-time 1 2.5", "#slamcmp-time 2 2.5"]
    assert log_of(tmp_path, *chain(0, 1), *stamps[:2]).t.tolist() == [1.5, 2.5]
    told = refused(tmp_path, *chain(0, 1, 2), *stamps)
    assert told.startswith(":5: time 2.5 s of pose 2 does not come after 2.5 s of pose 1")
    told = refused(tmp_path, *chain(0, 1, 2), *stamps[:2])
    assert "pose 2 has no time stamp where 2 of 3 poses have one" in told
    assert refused(tmp_path, *chain(0, 1), *stamps).startswith(":4: a time stamp of pose 2, which the file")


# ---- loop closures ----


def test_loop_closures_are_relative_poses_as_measured(tmp_path):
    log = log_of(
        tmp_path,
        *chain(0, 1, 2, 3),
        "EDGE_SE2 0 2 2 0.1 0.2 4 0 0 16 0 25",
        "EDGE_SE2 3 0 -3 0 0 4 0 0 16 0 25",
    )
    onward, back = log.relative_poses[2], log.relative_poses[3]
    np.testing.assert_allclose(onward.T_earlier_body[0], g.se2(2, 0.1, 0.2))
    np.testing.assert_allclose(onward.P[0], np.diag([1 / 4, 1 / 16, 1 / 25]))
    np.testing.assert_allclose(back.T_earlier_body[0], g.se2(3, 0, 0), atol=1e-15)
    # Turned round, the heading's noise moves the far end sideways: 1/16 + 3² / 25 m².
    np.testing.assert_allclose(np.diag(back.P[0]), [1 / 4, 1 / 16 + 9 / 25, 1 / 25])


def test_places_are_told(tmp_path):
    closure = f"EDGE_SE2 3 0 -3 0 0 {NOISE}"
    log = log_of(tmp_path, *chain(0, 1, 2, 3), closure, closures="places")
    assert log.relative_poses is None
    assert log.warnings[0].startswith(
        "some.g2o: 1 loop closures between poses were turned into sights of places"
    )
    assert graph_file(path="w100.graph").relative_poses is not None
