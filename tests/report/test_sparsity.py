"""Symbolic elimination against numbers: a random matrix of the pattern, factored and marginalised."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import slamcmp
from slamcmp.errors import UsageError
from slamcmp.report.figures.runs.sparsity import (
    blocks,
    filled_pattern,
    marginal_pattern,
    minimum_degree,
    pattern,
    shared_measurements,
    shown_frames,
)
from slamcmp.report.live_sparsity import fill_steps


@pytest.fixture(scope="module")
def stream():
    return slamcmp.make_stream("circle", 3, landmarks=12, steps=25, range_max_m=4.0)


def random_information(graph, seed=0):
    """Positive definite, and zero exactly where two variables share nothing."""
    shared = pattern(graph, range(len(graph))) > 0
    values = np.where(shared, np.random.default_rng(seed).normal(size=shared.shape), 0.0)
    values = values + values.T
    return values + np.diag(1.0 + np.abs(values).sum(axis=1))


@pytest.mark.parametrize("count", [2, 7, 25])
def test_the_graph_is_what_shares_a_measurement(stream, count):
    graph = shared_measurements(stream, count)
    seen = {int(i) for frame in stream.frames[:count] for i in frame.ids}
    assert len(graph) == count + len(seen)
    sights = sum(len(frame.ids) for frame in stream.frames[:count])
    assert sum(len(each) for each in graph.values()) == 2 * (sights + count - 1)
    assert graph[0] >= {1}
    assert all(node in graph[other] for node, others in graph.items() for other in others)


@pytest.mark.parametrize("natural", [True, False])
def test_fill_in_is_that_of_a_numeric_factor(stream, natural):
    graph = shared_measurements(stream, 25)
    order = list(graph) if natural else minimum_degree(graph, last=24)
    assert sorted(order) == list(range(len(graph)))
    assert natural or order[-1] == 24
    information = random_information(graph)[np.ix_(order, order)]
    # Far fill-in is tiny; what is structurally nothing is exactly zero.
    numeric = np.linalg.cholesky(information) != 0.0
    marks = filled_pattern(graph, order)
    assert (np.tril(marks > 0) == numeric).all()
    assert ((marks == 1) == (pattern(graph, order) == 1)).all()


def test_minimum_degree_fills_no_more_than_time_order(stream):
    graph = shared_measurements(stream, 25)
    fills = [int((filled_pattern(graph, o) == 2).sum()) for o in (minimum_degree(graph, 24), list(graph))]
    assert fills[0] <= fills[1]


def test_what_a_filter_keeps_is_the_schur_complement(stream):
    graph = shared_measurements(stream, 25)
    kept = [24, *range(25, len(graph))]
    gone = list(range(24))
    information = random_information(graph)
    left = information.copy()
    for node in gone:
        left -= np.outer(left[:, node], left[node]) / left[node, node]
    schur = information[np.ix_(kept, kept)] - information[np.ix_(kept, gone)] @ np.linalg.solve(
        information[np.ix_(gone, gone)], information[np.ix_(gone, kept)]
    )
    left = left[np.ix_(kept, kept)]
    assert left == pytest.approx(schur, abs=1e-9)
    marks = marginal_pattern(graph, kept)
    assert ((left != 0.0) == (marks > 0)).all()
    # All that was ever seen hangs together by the poses that are gone.
    assert (marks > 0).all()
    assert (marks == 2).any()


@pytest.mark.parametrize("natural", [True, False])
def test_each_elimination_fills_what_it_fills_in_numbers(stream, natural):
    graph = shared_measurements(stream, 14)
    order = list(graph) if natural else minimum_degree(graph, last=13)
    fill = fill_steps(graph, order)
    left = random_information(graph)[np.ix_(order, order)]
    place = {node: i for i, node in enumerate(order)}
    for step in range(1, len(order) + 1):
        before = left != 0.0
        column = left[:, step - 1].copy()
        left = left - np.outer(column, column) / column[step - 1]
        left[step - 1], left[:, step - 1] = 0.0, 0.0
        new = {tuple(sorted(pair)) for pair in zip(*np.nonzero((left != 0.0) & ~before), strict=True)}
        told = {tuple(sorted((place[i], place[j]))) for i, j, at in fill if at == step}
        assert told == new
    assert 2 * len(fill) == (filled_pattern(graph, order) == 2).sum()


def test_a_chain_and_a_star_by_hand():
    chain = {0: {1}, 1: {0, 2}, 2: {1}}
    assert (filled_pattern(chain, [0, 1, 2]) == 2).sum() == 0
    # The middle first joins the ends: one block, twice in a symmetric matrix.
    assert (filled_pattern(chain, [1, 0, 2]) == 2).sum() == 2
    star = {0: {1, 2, 3}, 1: {0}, 2: {0}, 3: {0}}
    assert (marginal_pattern(star, [1, 2, 3]) == [[1, 2, 2], [2, 1, 2], [2, 2, 1]]).all()
    assert blocks(marginal_pattern(star, [1, 2, 3])) == "9 blocks of 9, 6 filled"


def test_the_figure_is_drawn_where_it_is_asked_for(tmp_path):
    experiment = {
        "source": {"name": "circle", "landmarks": 12, "steps": 30},
        "back_ends": ["ekf_slam", "isam2"],
        "figures": ["sparsity"],
    }
    results = slamcmp.run(experiment, folder=tmp_path / "r", executor="serial", progress=False)
    figure = slamcmp.plot(results, figure="sparsity")
    titles = [axes.get_title() or axes.get_title(loc="left") for axes in figure.axes]
    assert len(titles) == 9
    assert sum("filled" in title for title in titles) >= 3
    stream = slamcmp.make_stream("circle", 0, landmarks=12, steps=30)
    assert f"{shown_frames(stream)} poses" in titles[2]
    with pytest.raises(UsageError, match="the stream is not there any more"):
        slamcmp.plot(dataclasses.replace(results, folder=tmp_path), figure="sparsity")
