"""Wrong labels, ghosts, bursts and slip: as often as asked, apart from each other, and without a hint."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from slamcmp import geometry as g
from slamcmp.frontend.labelled import labelled
from slamcmp.registry import sources
from slamcmp.types import Log

KINDS: dict[str, dict[str, Any]] = {
    "labels": {"wrong_association_fraction": 0.2},
    "clutter": {"clutter_per_frame": 1.5},
    "bursts": {"burst_probability": 0.03, "burst_frames": 4},
    "slip": {"slip_probability": 0.2, "slip_share": 0.5},
}
WORLDS: list[tuple[str, dict[str, Any]]] = [
    ("circle", {"steps": 300}),
    ("random", {"steps": 300, "sensor": "relative_position", "odometry": "encoders"}),
    ("space", {"steps": 120, "landmarks": 200}),
]


def make(name: str, seed: int = 3, **parameters: Any) -> Log:
    log: Log = sources.get(name).target(seed, **parameters)
    assert log.truth is not None
    assert log.truth.outliers is not None
    return log


@pytest.mark.parametrize(
    ("name", "parameters", "digest"),
    [
        ("circle", {}, "cf65007340edd50c4932ad7f3409649cc0f8f8bd81885cfa0b13f97781f16615"),
        (
            "circle",
            {"outlier_fraction": 0.2},
            "bd0202c76fdc4fa4b42fc44f4452922a171c1e96c0e1ac23e5f85f446709d576",
        ),
        ("space", {"steps": 40}, "f9b4b8a8e34151ad019bdb11e25f18133822ec6a89d1deeab6cd6d7d3a393a7f"),
    ],
)
def test_worlds_without_them_are_those_of_before(name: str, parameters: dict[str, Any], digest: str) -> None:
    """Digests of the version before there were such outliers."""
    assert labelled(make(name, **parameters), 3, gate_probability=None).digest == digest


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("name", "parameters"), WORLDS)
def test_each_kind_leaves_everything_else_as_it_was(name: str, parameters: dict[str, Any], kind: str) -> None:
    base, spoilt = make(name, **parameters), make(name, **parameters, **KINDS[kind])
    np.testing.assert_array_equal(spoilt.truth.T_world_body, base.truth.T_world_body)
    if kind != "slip":
        np.testing.assert_array_equal(spoilt.T_prev_body, base.T_prev_body)
    different = 0
    for before, after, wild in zip(base.detections, spoilt.detections, spoilt.truth.outliers, strict=True):
        right = after.ids[~wild]
        assert np.isin(right, before.ids).all()
        np.testing.assert_array_equal(after.z[~wild], before.z[np.isin(before.ids, right)])
        if kind in ("labels", "slip"):
            np.testing.assert_array_equal(after.ids, before.ids)
        different += int(wild.sum())
    assert (different > 0) == (kind != "slip")


@pytest.mark.parametrize(("name", "parameters"), WORLDS)
def test_wrong_labels_measure_another_landmark_in_sight(name: str, parameters: dict[str, Any]) -> None:
    log = make(name, **parameters, **KINDS["labels"])
    wrong = total = 0
    for T, seen, wild in zip(log.truth.T_world_body, log.detections, log.truth.outliers, strict=True):
        wrong, total = wrong + int(wild.sum()), total + (wild.size if wild.size > 1 else 0)
        true = log.problem.sensor.predict(T, log.truth.positions[seen.ids])
        for z, R, row in zip(seen.z[wild], seen.R[wild], np.flatnonzero(wild), strict=True):
            residual = log.problem.sensor.residual(z, true)
            distances = np.einsum("mi,ij,mj->m", residual, np.linalg.inv(R), residual)
            # 5 sigma and a half of two or three components; of its own landmark only by nearness.
            assert np.delete(distances, row).min() < 30
    # Four standard deviations of a binomial share.
    assert abs(wrong / total - 0.2) < 4 * np.sqrt(0.2 * 0.8 / total)


@pytest.mark.parametrize(("name", "parameters"), WORLDS)
def test_ghosts_are_as_many_as_asked_under_labels_that_are_not_in_sight(
    name: str, parameters: dict[str, Any]
) -> None:
    base, log = make(name, **parameters), make(name, **parameters, **KINDS["clutter"])
    counts = []
    for before, after, wild in zip(base.detections, log.detections, log.truth.outliers, strict=True):
        assert not np.isin(after.ids[wild], before.ids).any()
        counts.append(int(wild.sum()))
    # Poisson of mean 1.5: four standard deviations of the mean.
    assert abs(np.mean(counts) - 1.5) < 4 * np.sqrt(1.5 / len(counts))
    assert max(counts) > 2


@pytest.mark.parametrize(("name", "parameters"), WORLDS)
def test_in_a_burst_nothing_is_right_and_it_lasts(name: str, parameters: dict[str, Any]) -> None:
    log = make(name, **parameters, **KINDS["bursts"])
    inside = [bool(wild.all()) for wild in log.truth.outliers if wild.size]
    assert all(not wild.any() or wild.all() for wild in log.truth.outliers)
    share = np.mean(inside)
    # Bursts of 4 that begin at 3 % of the frames outside one: 0.12 / (0.97 + 0.12) of all frames, roughly.
    assert 0.02 < share < 0.3
    padded = np.diff(np.concatenate([[0], np.array(inside, dtype=int), [0]]))
    lengths = np.flatnonzero(padded == -1) - np.flatnonzero(padded == 1)
    assert (lengths[:-1] >= 4).all()


@pytest.mark.parametrize(("name", "parameters"), WORLDS)
def test_wheels_that_slip_turn_further_than_the_robot_moves(name: str, parameters: dict[str, Any]) -> None:
    parameters = {**parameters, "noise_scale": 1e-3}
    base, log = make(name, **parameters), make(name, **parameters, **KINDS["slip"])
    # The velocities of the step, along its arc.
    part = slice(3, 6) if name == "space" else slice(0, 2)
    before, after = (g.log(each.T_prev_body)[1:, part] for each in (base, log))
    slipping = np.linalg.norm(after - before, axis=1) > 1e-9
    assert abs(slipping.mean() - 0.2) < 4 * np.sqrt(0.16 / slipping.size)
    ratio = np.linalg.norm(after, axis=1)[slipping] / np.linalg.norm(before, axis=1)[slipping]
    # Of two wheels one alone; in a bend it is the longer or the shorter way.
    expected, tolerance = (1.25, 0.02) if name == "random" else (1.5, 2e-3)
    np.testing.assert_allclose(ratio, expected, rtol=tolerance)
    if name == "random":
        turn = g.se2_coordinates(log.T_prev_body)[1:, 2] - g.se2_coordinates(base.T_prev_body)[1:, 2]
        # The left wheel rolls half a step further, 0.5 m from the right one.
        assert (turn[slipping] < -0.3).all()


@pytest.mark.parametrize(("name", "parameters"), WORLDS)
def test_the_stream_has_no_hint(name: str, parameters: dict[str, Any]) -> None:
    """Sorted labels, one of each, and covariances by the rule of right ones; the truth stays behind."""
    log = make(name, **parameters, **{key: value for kind in KINDS.values() for key, value in kind.items()})
    stream = labelled(log, 3, gate_probability=None)
    for frame in stream.frames:
        assert (np.diff(frame.ids) > 0).all()
        if name == "space":
            deviations = np.sqrt(np.diagonal(frame.R, axis1=1, axis2=2))
            assert (deviations >= 0.01 * 0.1 - 1e-12).all()
            assert (deviations <= 0.01 * 20.0).all()
        elif frame.ids.size:
            np.testing.assert_array_equal(frame.R, np.tile(frame.R[0], (frame.ids.size, 1, 1)))
    assert not hasattr(stream, "truth")
    again = labelled(make(name, **parameters), 3, gate_probability=None)
    assert [frame.Q.shape for frame in stream.frames] == [frame.Q.shape for frame in again.frames]
