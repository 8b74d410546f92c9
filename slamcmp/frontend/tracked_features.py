"""The front end on images: points followed over frames become the landmarks of a frozen stream."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Annotated

import numpy as np
from annotated_types import Ge, Gt, Interval, Le, Lt

from slamcmp.errors import UsageError
from slamcmp.randomness import random_streams
from slamcmp.registry import front_ends
from slamcmp.support.memory import keep_freed_memory
from slamcmp.types import Frame, FrontEndReport, Log, MeasurementStream, Problem

if TYPE_CHECKING:
    from slamcmp.frontend.vision.checks.motion_check import MotionCheck
    from slamcmp.frontend.vision.tracking.tracker import FeatureTracker, TrackingSettings
    from slamcmp.frontend.vision.wrong_matches import MatchRecord

Share = Annotated[float, Gt(0), Lt(1)]
_CLOCKS = "are the clocks of camera and odometry apart"


@front_ends.register("tracked_features", images=True)
def tracked_features(
    log: Log,
    seed: int,
    *,
    features: Annotated[int, Ge(16)] = 500,
    levels: Annotated[int, Ge(1), Le(16)] = 1,
    followed: Annotated[int, Ge(8)] = 150,
    sigma_px: Annotated[float, Gt(0)] = 0.5,
    disparity_sigma_px: Annotated[float, Gt(0)] = 0.2,
    depth_sigma_per_m2: Annotated[float, Gt(0)] = 0.002,
    depth_min_m: Annotated[float, Gt(0)] = 0.3,
    ratio: Annotated[float, Interval(gt=0, le=1)] = 0.8,
    threshold_px: Annotated[float, Gt(0)] = 1.5,
    gate_probability: Share = 0.999,
    min_sightings: Annotated[int, Ge(1)] = 2,
    memory: Annotated[int, Ge(0)] = 30,
    parallax_min_deg: Annotated[float, Gt(0)] = 3.0,
    wrong_match_share: Annotated[float, Interval(ge=0, lt=1)] = 0.0,
) -> MeasurementStream:
    """Landmarks from Harris corners with ORB descriptors, followed through a camera's images.

    A point with depth (stereo, RGB-D) is measured as (u_left, u_right, v). A single camera waits until
    odometry has given a point enough parallax; it then enters the map triangulated, and is measured as
    (u, v) from the next image on. The pixels that placed it are not used again; the odometry between them
    is, by every back end alike: that it enters twice is an approximation. Points that enter together share
    its errors; their disparities are therefore stated with ten times their own variance. What placed a point
    and what measures it later are of one corner and err alike: they are stated with 1.5 and 3 times theirs.

    Args:
        log: its sensor is a camera and it has images.
        seed: of RANSAC's samples and of wrong matches.
        features: corners described in an image.
        levels: scales that corners are looked for at, 2^(1/4) apart; 1 is the image alone. What comes nearer
            fast is then found again at another scale, where its place is known less well by that factor.
        followed: points followed at a time; new ones replace those that were lost.
        sigma_px: of a corner's position. A peak between whole pixels is known to some tenths of a pixel,
            and shifts a little when the view of the corner changes.
        disparity_sigma_px: of a stereo disparity, from aligned patches.
        depth_sigma_per_m2: of an RGB-D depth: sigma [m] at 1 m, growing with the square of the depth.
        depth_min_m: nearer points are not measured.
        ratio: a match must be closer than this share of the next best.
        threshold_px: largest Sampson distance of a match that obeys the epipolar geometry.
        gate_probability: share of correct matches that the Mahalanobis test lets through.
        min_sightings: a point is a landmark from this sighting on, so that no single bad match makes one.
        memory: frames that a landmark out of sight is remembered and looked for; longer than a lap, loops
            are closed at the landmarks, and the back ends have to keep them.
        parallax_min_deg: angle between the first and the present ray of a point that a single camera places.
        wrong_match_share: this share of the matches is made wrong before they are tested, for experiments.

    Returns:
        The stream, on SE(3); its report counts what each stage removed, frame by frame, and the frames that
        were skipped or could not be tested, by reason.

    Raises:
        UsageError: the log has no images, or its sensor is not a camera.
    """
    from slamcmp.frontend.vision.tracking.tracker import TrackingSettings

    settings = TrackingSettings(
        features=features,
        levels=levels,
        followed=followed,
        ratio=ratio,
        threshold_px=threshold_px,
        gate_probability=gate_probability,
        sigma_px=sigma_px,
        disparity_sigma_px=disparity_sigma_px,
        depth_sigma_per_m2=depth_sigma_per_m2,
        min_sightings=min_sightings,
        memory=memory,
        parallax_min_deg=parallax_min_deg,
        depth_min_m=depth_min_m,
        wrong_match_share=wrong_match_share,
    )
    return follow(log, seed, settings)[0]


def follow(log: Log, seed: int, settings: TrackingSettings) -> tuple[MeasurementStream, list[MatchRecord]]:
    """The stream, and the matches of every image for setting them against the truth."""
    from slamcmp.frontend.vision.checks.motion_check import MotionCheck
    from slamcmp.frontend.vision.one_thread import one_thread
    from slamcmp.frontend.vision.tracking.tracker import STAGES, FeatureTracker
    from slamcmp.frontend.vision.wrong_matches import TrueMatches, score_matches

    if log.images is None:
        raise UsageError(
            f"tracked_features needs images, and the log {log.name!r} has none; for a log of labelled "
            "detections there is front end 'labelled'"
        )
    tracker = FeatureTracker(log.problem.sensor, settings, random_streams(seed).front_end)
    check = MotionCheck(tracker.sensor)
    frames, counts, kept, records = [], [], [], []
    events: Counter[str] = Counter()
    skipped: Counter[str] = Counter()
    times: dict[str, list[float]] = {}
    keep_freed_memory()
    with one_thread():
        for k, t in enumerate(log.t.tolist()):
            image = log.images[k]
            check.look(image.image, log.T_prev_body[k])
            sighting = tracker.step(image, log.T_prev_body[k], log.Q[k])
            seen = sighting.detections
            frames.append(
                Frame(k, t, log.T_prev_body[k], log.Q[k], seen.ids, seen.z, seen.R, sighting.entries)
            )
            counts.append(sighting.counts)
            kept.append(sighting.kept)
            if sighting.event:
                events[sighting.event] += 1
                if sighting.matches is None:
                    skipped[sighting.event] += 1
            if sighting.matches is not None:
                records.append(sighting.matches)
            for name, value in sighting.times_ms.items():
                times.setdefault(name, []).append(value)
    report = FrontEndReport(
        STAGES,
        np.array(counts, dtype=np.int64),
        tuple(kept),
        dict(sorted(events.items())),
        {name: np.array(values) for name, values in times.items()},
        (
            *_skipped(skipped, log),
            *_against_odometry(tracker, check, log),
        ),
        score_matches(records, log.images).counts() if isinstance(log.images, TrueMatches) else {},
    )
    problem = Problem(log.problem.T_world_body, log.problem.P, tracker.sensor)
    return MeasurementStream(problem, tuple(frames), report), records


def _against_odometry(tracker: FeatureTracker, check: MotionCheck, log: Log) -> list[str]:
    """What the images say against their camera and the odometry, each thing once."""
    if log.t.size < 2:
        return []
    step_s = float(np.median(np.diff(log.t)))
    told = tracker.warnings(step_s)
    # Where the picture's shift tells a delay too, the motion of the points has told it.
    return told + [each for each in check.findings(step_s) if not (_CLOCKS in each and _CLOCKS in str(told))]


def _skipped(reasons: Counter[str], log: Log) -> list[str]:
    """What did not come through, said where results are read."""
    total = log.t.size
    told = [
        f"{log.name}: {count} of {total} frames were skipped, odometry only: {reason}"
        for reason, count in reasons.most_common()
    ]
    if sum(reasons.values()) == total:
        told.append(f"{log.name}: not one image could be used; every back end has nothing but odometry")
    return told
