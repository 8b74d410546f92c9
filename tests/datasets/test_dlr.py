"""DLR's map.circles: a small file in its format by the formulas of its header, and the recorded one."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from slamcmp import geometry
from slamcmp.datasets.dlr import dlr
from slamcmp.errors import DataError, MissingDataError
from tests.recorded_data import recorded

HEAD = "# Format:\n#  STEP <image.ppm> <dX> <dY> <dPhi> ...\n \n"
STEPS = [(0.1, -0.2, 0.05), (0.02, -0.6, 0.3), (-0.05, -0.5, -0.4), (0.0, -0.7, 0.9)]
DISCS = {3: (1.0, -4.0), 8: (-2.0, -3.0)}
COVARIANCE = (4e-4, 1e-4, 9e-4, 2e-5, 3e-5, 1e-4)
"""xx, xy, yy, x phi, y phi, phi phi."""


def write(folder: Path, *, tag: str = "LANDMARK_C", more: str = "") -> Path:
    """Discs seen exactly, in the file's own frame: -Y ahead, X to the right, a plain rotation by Phi."""
    lines = []
    X = Y = Phi = 0.0
    for k, (dX, dY, dPhi) in enumerate(STEPS):
        if k:
            X += math.cos(Phi) * dX - math.sin(Phi) * dY
            Y += math.sin(Phi) * dX + math.cos(Phi) * dY
            Phi += dPhi
        lines.append(f"STEP e.{k:04d} {dX} {dY} {dPhi} " + " ".join(map(str, COVARIANCE)))
        for name, (U, V) in DISCS.items():
            a, b = U - X, V - Y
            pX, pY = math.cos(Phi) * a + math.sin(Phi) * b, -math.sin(Phi) * a + math.cos(Phi) * b
            lines.append(f"{tag} {pX:.12f} {pY:.12f} 0.{9 - k} 0.002 0.0005 0.004 {name}")
    (folder / "map.circles").write_text(HEAD + "\n".join(lines) + "\n" + more)
    return folder


@pytest.mark.parametrize("tag", ["LANDMARK_C", "LANDMARK"])
def test_seen_exactly_each_disc_stays_where_it_is(tmp_path: Path, tag: str) -> None:
    """In the frame of the first image: x ahead is -Y, y to the left is -X."""
    log = dlr(path=str(write(tmp_path, tag=tag)))
    for T, seen in zip(geometry.dead_reckoning(np.eye(3), log.T_prev_body), log.detections, strict=True):
        assert seen.ids.tolist() == [3, 8]
        assert geometry.transform(T, seen.z) == pytest.approx(
            np.array([[-V, -U] for U, V in DISCS.values()]), abs=1e-9
        )
    assert log.detections[0].R[0] == pytest.approx(np.array([[0.004, 0.0005], [0.0005, 0.002]]))
    # The step before the first image leads from nowhere.
    assert log.T_prev_body[0] == pytest.approx(np.eye(3))
    assert not log.Q[0].any()


def test_a_step_s_covariance_is_that_of_drawn_steps(tmp_path: Path) -> None:
    """Drawn in the frame before the step, seen in the tangent after it."""
    log = dlr(path=str(write(tmp_path)))
    xx, xy, yy, xp, yp, pp = np.array(COVARIANCE) * 1e-4
    C = np.array([[xx, xy, xp], [xy, yy, yp], [xp, yp, pp]])
    drawn = np.random.default_rng(0).multivariate_normal(STEPS[3], C, 20_000)
    mean = geometry.se2(0.7, 0.0, -0.9)
    assert log.T_prev_body[3] == pytest.approx(mean)
    w = geometry.local(mean, geometry.se2(-drawn[:, 1], -drawn[:, 0], -drawn[:, 2]))
    assert log.Q[3] * 1e-4 == pytest.approx(np.cov(w.T), rel=0.1, abs=1e-9)


def test_what_can_be_chosen(tmp_path: Path) -> None:
    path = str(write(tmp_path))
    assert {name for seen in dlr(path=path, ids="none").detections for name in seen.ids.tolist()} == {-1}
    sure = dlr(path=path, least_quality=0.75)
    assert [seen.ids.size for seen in sure.detections] == [2, 2, 0, 0]
    assert sure.warnings == ("left out 4 landmarks of a quality below 0.75",)
    assert dlr(path=path, steps=2).t.size == 2
    wide, plain = dlr(path=path, sensor_scale=2.0, odometry_scale=3.0), dlr(path=path)
    assert pytest.approx(9 * plain.Q) == wide.Q
    assert pytest.approx(4 * plain.detections[0].R) == wide.detections[0].R


def test_several_ids_are_none(tmp_path: Path) -> None:
    log = dlr(
        path=str(write(tmp_path, more="LANDMARK_C 1 -2 0.9 0.002 0 0.004 3 8\nLANDMARK_C 0 -2 1 1 0 1 -1\n"))
    )
    assert log.detections[-1].ids.tolist() == [3, 8, -1, -1]
    assert log.warnings == ("1 landmarks were given several ids: read as identified by nobody",)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("STEP e.1 0.1 0.2", r"map\.circles:16: 4 fields where 11 are needed; is the file truncated"),
        ("LANDMARK_C 0.1 0.2 1 1 0 1", "7 fields where at least 8"),
        ("LANDMARK_C 0.1 0.2 1 1 2 1 4", "covariance is not positive definite"),
        ("LANDMARK_C 0.1 nan 1 1 0 1 4", "'nan' is not a finite number"),
        ("LANDMARK_C 0.1 0.2 1 1 0 1 4.5", "'4.5' is not an id"),
        ("VERTEX2 0 1 2 3", "begins with 'VERTEX2'; STEP or LANDMARK_C is needed"),
    ],
)
def test_a_wrong_line_is_named(tmp_path: Path, line: str, message: str) -> None:
    with pytest.raises(DataError, match=message):
        dlr(path=str(write(tmp_path, more=line + "\n")))


def test_what_is_missing_is_told(tmp_path: Path) -> None:
    with pytest.raises(MissingDataError, match="steps and landmarks of the DLR data set"):
        dlr(path=str(tmp_path))
    with pytest.raises(MissingDataError, match="sfbtr8"):
        dlr(path=str(tmp_path / "nowhere"))
    (tmp_path / "map.circles").write_text("LANDMARK_C 0.1 0.2 1 1 0 1 4\n")
    with pytest.raises(DataError, match="a landmark before the first STEP"):
        dlr(path=str(tmp_path))
    (tmp_path / "map.circles").write_text(HEAD)
    with pytest.raises(DataError, match=r"0 step\(s\); at least two"):
        dlr(path=str(tmp_path))


def test_the_recorded_discs_are_where_odometry_expects_them() -> None:
    """Of 400 steps: discs seen twice in a row, against the covariances that the file states."""
    log = dlr(path=str(recorded("dlr")), steps=400)
    distances = []
    for k in range(1, 400):
        before, now = log.detections[k - 1], log.detections[k]
        T = geometry.inverse(log.T_prev_body[k])
        for name, z, R in zip(now.ids.tolist(), now.z, now.R, strict=True):
            for i in np.flatnonzero(before.ids == name) if name >= 0 else []:
                at = geometry.transform(T, before.z[i][None])[0]
                J = np.array([[-1.0, 0.0, at[1]], [0.0, -1.0, -at[0]]])
                S = R + T[:2, :2] @ before.R[i] @ T[:2, :2].T + J @ log.Q[k] @ J.T
                distances.append((z - at) @ np.linalg.solve(S, z - at) / 2)
    assert len(distances) > 1000
    assert np.median(distances) < np.log(2) * 1.5
    assert np.mean(np.array(distances) < 6.9) > 0.99
