"""The whole front end on rendered images, whose true correspondences are known."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from slamcmp.backends.gtsam_smoothers.batch import Batch
from slamcmp.errors import UsageError
from slamcmp.experiment.job.make_stream import make_stream
from slamcmp.frontend.stream_file import load_stream, save_stream
from slamcmp.frontend.tracked_features import follow, tracked_features
from slamcmp.frontend.vision.tracking.tracker import STAGES, TrackingSettings
from slamcmp.frontend.vision.wrong_matches import score_matches
from slamcmp.models.camera import MonoCamera, StereoCamera
from slamcmp.types import CameraFrame, Log
from slamcmp.worlds.planar import circle
from slamcmp.worlds.rendered import rendered

SMALL = {"width_px": 320, "height_px": 240}


@cache
def room(camera: str, steps: int, seed: int = 0, small: bool = True) -> Log:
    """A rendered drive whose images are drawn once."""
    log = rendered(seed, camera=camera, steps=steps, **(SMALL if small else {}))
    return replace(log, images=Drawn(log.images))


class Drawn(list):
    """Images in memory that still know the truth."""

    def __init__(self, images: object) -> None:
        super().__init__(images)  # type: ignore[call-overload]
        self.true_pixels = images.true_pixels  # type: ignore[attr-defined]
        self.surface_points = images.surface_points  # type: ignore[attr-defined]


def test_a_third_of_wrong_matches_is_found() -> None:
    log = room("stereo", 40, small=False)
    settings = TrackingSettings(**{**tracked_features.__kwdefaults__, "wrong_match_share": 0.3})
    _, records = follow(log, 3, settings)
    scores = score_matches(records, log.images)
    assert scores.matches > 3000
    assert scores.precision["matched"] < 0.72
    assert scores.precision["passed"] >= 0.98
    assert scores.recall["passed"] >= 0.9
    # Each test has its part.
    assert scores.precision["matched"] + 0.03 < scores.precision["epipolar"] < scores.precision["passed"]


@pytest.mark.parametrize(("camera", "levels"), [("stereo", 1), ("rgbd", 1), ("stereo", 4)])
def test_measurements_are_where_the_truth_says(camera: str, levels: int) -> None:
    """Against each landmark's median place by true poses: a wrong R, frame or id would show."""
    log = room(camera, 30)
    stream = tracked_features(log, 0, followed=60, levels=levels)
    # A corner of a smaller image is known by that image's pixels.
    variances = {
        round(float(v), 6) for frame in stream.frames for v in frame.R[:, 2, 2] / frame.R[:, 2, 2].min()
    }
    assert variances == {round(2.0 ** (0.5 * level), 6) for level in range(levels)}
    sensor = stream.problem.sensor
    assert isinstance(sensor, StereoCamera)
    seen: dict[int, list[tuple[int, np.ndarray, np.ndarray]]] = {}
    for frame in stream.frames:
        for landmark, z, R in zip(frame.ids.tolist(), frame.z, frame.R, strict=True):
            seen.setdefault(landmark, []).append((frame.k, z, R))
    squared = []
    for sightings in (each for each in seen.values() if len(each) >= 5):
        poses = [log.truth.T_world_body[k] for k, _, _ in sightings]
        place = np.median(
            [sensor.invert(T, z) for T, (_, z, _) in zip(poses, sightings, strict=True)], axis=0
        )
        for T, (_, z, R) in zip(poses, sightings, strict=True):
            y = z - sensor.predict(T, place)
            squared.append(y @ np.linalg.solve(R, y))
    # Chi-square with 3 degrees of freedom: median 2.37, 95 % below 7.81. Corners are better than stated in
    # the median, and have longer tails than a Gaussian.
    assert len(squared) > 500
    assert 0.1 < np.median(squared) < 2.37
    assert (np.array(squared) < 7.81).mean() > 0.9


def test_a_single_camera_enters_landmarks_where_they_are() -> None:
    log = room("mono", 40)
    stream = tracked_features(log, 0)
    camera = stream.problem.sensor
    assert isinstance(camera, MonoCamera)
    pair, errors, pixels = camera.entry_sensor, [], []
    entered: dict[int, np.ndarray] = {}
    for frame in stream.frames:
        pose = log.truth.T_world_body[frame.k]
        if frame.entries is not None:
            surface = log.images.surface_points(frame.k, frame.entries.z[:, [0, 2]])
            y = frame.entries.z - pair.predict(pose, surface)
            errors += [each @ np.linalg.solve(R, each) for each, R in zip(y, frame.entries.R, strict=True)]
            entered |= dict(zip(frame.entries.ids.tolist(), surface, strict=True))
        expected = [camera.predict(pose, entered[i]) for i in frame.ids.tolist()]
        pixels += [np.linalg.norm(z - e) for z, e in zip(frame.z, expected, strict=True)]
    assert len(errors) > 60
    # All landmarks that enter in one image share odometry's error: no bound for independent ones.
    assert np.median(errors) < 2 * 2.37
    assert (np.array(errors) < 16.3).mean() > 0.8
    assert np.median(pixels) < 1.0
    assert stream.frames[-1].ids.size > 10


def test_a_standing_camera_makes_no_motion() -> None:
    still = room("stereo", 2)
    rng = np.random.default_rng(1)
    frame = still.images[0]

    def noisy(image: np.ndarray) -> np.ndarray:
        return np.clip(image + rng.normal(0, 3, image.shape), 0, 255).astype(np.uint8)

    count = 12
    Q = np.tile(np.diag([1e-3, 1e-3, 5e-3, 1e-2, 1e-2, 1e-3]) ** 2, (count, 1, 1))
    Q[0] = 0.0
    log = replace(
        still,
        t=np.arange(count) * 0.1,
        T_prev_body=np.tile(np.eye(4), (count, 1, 1)),
        Q=Q,
        detections=still.detections[:1] * count,
        truth=None,
        images=[CameraFrame(noisy(frame.image), noisy(frame.right)) for _ in range(count)],
    )
    stream = tracked_features(log, 0, followed=60)
    assert stream.report.events == {"no epipolar test: no motion": count - 1}
    assert min(frame.ids.size for frame in stream.frames) > 30
    batch = Batch(stream.problem)
    for each in stream.frames:
        batch.update(each)
    moved = np.linalg.inv(stream.problem.T_world_body) @ batch.trajectory().T_world_body
    # Corners of one point jitter by a third of a pixel at most: millimetres at two to five metres.
    assert np.linalg.norm(moved[:, :3, 3], axis=1).max() < 0.005


def test_bad_images_are_skipped_with_their_reason_and_leave_the_odometry() -> None:
    log = room("stereo", 16)
    images = list(log.images)
    good = images[0]
    images[4] = CameraFrame(None, problem="file is truncated")
    images[5] = CameraFrame(np.zeros_like(good.image), good.right)
    images[6] = CameraFrame(images[6].image, None)
    images[7] = CameraFrame(images[7].image[:100], images[7].right)
    images[8] = CameraFrame(images[8].image, images[8].right[:100])
    images[12] = CameraFrame(None)
    stream = tracked_features(replace(log, images=images), 0, followed=60)
    skipped = {event: n for event, n in stream.report.events.items() if "epipolar" not in event}
    assert skipped == {
        "file is truncated": 1,
        "all black": 1,
        "right image: no image": 1,
        "320×100 pixels where 320×240 are needed": 1,
        "right image: 320×100 pixels where 320×240 are needed": 1,
        "no image": 1,
    }
    sizes = [frame.ids.size for frame in stream.frames]
    assert sizes[4:9] == [0] * 5
    assert sizes[12] == 0
    assert min(sizes[i] for i in (0, 3, 9, 11, 13, 15)) > 20
    # Points from before the five bad images are found again, by their prediction.
    again = np.intersect1d(stream.frames[3].ids, stream.frames[9].ids)
    assert again.size > 10
    for frame in stream.frames:
        np.testing.assert_array_equal(frame.T_prev_body, log.T_prev_body[frame.k])
        np.testing.assert_array_equal(frame.Q, log.Q[frame.k])
    totals = stream.report.totals()
    assert totals["frames: all black"] == 1
    columns = stream.report.counts
    np.testing.assert_array_equal(columns[:, 0] - columns[:, 1:-1].sum(axis=1), columns[:, -1])
    assert totals["kept"] == sum(sizes)
    assert stream.report.stages == STAGES


def test_nothing_to_see_gives_odometry_only() -> None:
    log = room("mono", 2)
    flat = CameraFrame(np.full((240, 320), 90, np.uint8))
    stream = tracked_features(replace(log, images=[flat, flat]), 0)
    assert stream.report.events == {"no contrast": 2}
    assert [frame.ids.size for frame in stream.frames] == [0, 0]


def test_the_same_seed_gives_the_same_stream_and_it_can_be_stored(tmp_path: Path) -> None:
    log = room("mono", 40)
    first, again = (tracked_features(log, 5) for _ in range(2))
    assert first.digest == again.digest
    save_stream(first, tmp_path / "stream.npz")
    stored = load_stream(tmp_path / "stream.npz")
    assert stored.digest == first.digest
    assert stored.report.events == first.report.events
    assert set(first.report.times_ms) >= {"features", "matching", "verification"}


def test_making_a_stream_tells_how_many_images_are_done() -> None:
    beat = [0.0, 0.0, 0.0]
    source = ("rendered", {"camera": "mono", "steps": 3, **SMALL})
    stream, _ = make_stream(source, ("tracked_features", {"features": 50}), 0, beat)
    assert beat[1] == len(stream.frames) == 3


def test_opencv_keeps_to_one_thread_and_gives_the_others_back() -> None:
    log = room("mono", 2)
    threads = []

    class Counting(list):
        def __getitem__(self, k: object) -> object:
            threads.append(cv2.getNumThreads())
            return super().__getitem__(k)  # type: ignore[index]

    before = cv2.getNumThreads()
    cv2.setNumThreads(3)
    try:
        tracked_features(replace(log, images=Counting(log.images)), 0)
        assert threads == [1, 1]
        assert cv2.getNumThreads() == 3
    finally:
        cv2.setNumThreads(before)


def test_a_log_without_camera_or_images_is_refused() -> None:
    with pytest.raises(UsageError, match="needs images"):
        tracked_features(circle(0, steps=5), 0)
    log = room("mono", 2)
    planar = circle(0, steps=2)
    with pytest.raises(UsageError, match="range_bearing"):
        tracked_features(replace(planar, images=list(log.images)), 0)
