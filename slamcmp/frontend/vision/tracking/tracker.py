"""Follow points from image to image and measure those that are landmarks.

An image goes through the course's three steps: features; association, by descriptor among the features near
a track's predicted place; outlier rejection, by the epipolar geometry of the last two images and then by
the Mahalanobis test against the prediction. What passes corrects the tracks' own filters and is handed on.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from time import perf_counter

import numpy as np
from scipy.special import chdtri

from slamcmp.errors import UsageError
from slamcmp.frontend.vision.features.suppression import suppress_cells
from slamcmp.frontend.vision.geometry.triangulation import PoseHistory
from slamcmp.frontend.vision.image_pair import Features, extract_features
from slamcmp.frontend.vision.matching import match_candidates
from slamcmp.frontend.vision.pyramid import extract_pyramid
from slamcmp.frontend.vision.tracking.common_motion import common_motion
from slamcmp.frontend.vision.tracking.epipolar_test import epipolar_test
from slamcmp.frontend.vision.tracking.error_correlation import SETTLED, ErrorCorrelation
from slamcmp.frontend.vision.tracking.frame_checks import FrameChecks
from slamcmp.frontend.vision.tracking.measuring import Measured, Noise, measuring
from slamcmp.frontend.vision.tracking.placing import SIGHTING, place_rays
from slamcmp.frontend.vision.tracking.search_windows import Windows, search_windows
from slamcmp.frontend.vision.tracking.track_table import TrackTable
from slamcmp.frontend.vision.wrong_matches import MatchRecord, spoil_matches
from slamcmp.models.camera import Camera, MonoCamera, StereoCamera
from slamcmp.models.motion import compose_increments
from slamcmp.types import BoolArray, CameraFrame, Detections, FloatArray, IntArray

STAGES = ("unmatched", "epipolar", "mahalanobis", "no_depth", "no_parallax", "unconfirmed")
"""Why a feature is no measurement: no track claims it, a test, no depth, or a track that is no landmark
yet."""
UNMATCHED, EPIPOLAR, MAHALANOBIS, NO_DEPTH, NO_PARALLAX, UNCONFIRMED, KEPT, ENTERED = range(len(STAGES) + 2)
_SEARCH_FACTOR = 2.0
"""On the Mahalanobis test's limit: an honest test needs candidates that fail it."""
_REJECTIONS_MAX = 3
_HISTORY = 120
"""Images that a ray may wait for its parallax."""
_SPACING_PX = 12
"""Between a new track and all others, along either axis."""
_WIDEST_PX = 60.0
"""Deviation of a predicted place beyond which a track is not looked for."""
_LONG_AGO = 10
"""Frames out of sight after which a likeness in a wide window proves little: no epipolar test backs it."""
_SURE_BITS = 32
"""Largest descriptor distance, of 256, of such a match. From one image to the next nine in ten of the right
ones are below 45; of those found again after a lap by less alike descriptors, one in four was wrong."""
_MATCHES_MIN = 12
"""Fewer do not hold a pose well: the common motion is not asked, and new points count without waiting."""


@dataclass(frozen=True)
class TrackingSettings:
    """The parameters of :func:`slamcmp.frontend.tracked_features.tracked_features`."""

    features: int
    levels: int
    followed: int
    ratio: float
    threshold_px: float
    gate_probability: float
    sigma_px: float
    disparity_sigma_px: float
    depth_sigma_per_m2: float
    min_sightings: int
    memory: int
    parallax_min_deg: float
    depth_min_m: float
    wrong_match_share: float


@dataclass(frozen=True)
class Sighting:
    """What one image gave."""

    detections: Detections
    entries: Detections | None
    kept: BoolArray
    """Which features became a measurement or an entry, (features,)."""
    counts: tuple[int, ...]
    """Features, what each of STAGES took, and what was kept."""
    event: str
    """Why the image was skipped, or why its epipolar test was; empty in the normal case."""
    times_ms: dict[str, float]
    matches: MatchRecord | None = None


class FeatureTracker:
    """From one camera's images and odometry to measurements of landmarks.

    Args:
        camera: what the images were taken with.
        settings: the front end's parameters.
        generator: for RANSAC's samples, and for wrong matches where they are asked for.

    Raises:
        UsageError: the sensor is not a camera.
    """

    def __init__(self, camera: object, settings: TrackingSettings, generator: np.random.Generator) -> None:
        if not isinstance(camera, Camera):
            raise UsageError(
                "tracked_features follows points in a camera's images; the log's sensor is "
                f"{getattr(camera, 'name', camera)!r}"
            )
        self._settings = settings
        self._generator = generator
        noise = Noise(settings.sigma_px, settings.disparity_sigma_px, settings.depth_sigma_per_m2)
        self.sensor, self._measure = measuring(
            camera,
            noise,
            features=settings.features,
            levels=settings.levels,
            depth_min_m=settings.depth_min_m,
        )
        self._image_camera = MonoCamera(
            fx_px=camera.fx_px,
            fy_px=camera.fy_px,
            cx_px=camera.cx_px,
            cy_px=camera.cy_px,
            T_body_camera=camera.T_body_camera,
        )
        self._tracks = TrackTable.empty()
        self._history = PoseHistory(_HISTORY)
        self._correlation = ErrorCorrelation()
        self._since_image = np.eye(4), np.zeros((6, 6))
        self._checks = FrameChecks(
            camera, self.sensor, features=settings.features, depth_min_m=settings.depth_min_m
        )
        self._gap = 0
        """Frames since the last image that could be used."""
        self._size = (0, 0)
        self._frame = -1
        self._next_id = 0
        share = settings.gate_probability
        self._gate = float(chdtri(self.sensor.dim, 1.0 - share))
        self._pixel_gate = float(chdtri(2, 1.0 - share))

    def warnings(self, step_s: float) -> list[str]:
        """What the images so far say against the calibration or the odometry, with the likely cause.

        ``step_s`` is the usual time between two frames.
        """
        return self._checks.findings(step_s)

    def step(self, frame: CameraFrame, T_prev_body: FloatArray, Q: FloatArray) -> Sighting:
        """Take in the next frame and the odometry that led to it; a bad image leaves only the odometry."""
        tracks = self._tracks
        self._frame += 1
        self._gap += 1
        tracks.move(T_prev_body, Q)
        increment = T_prev_body, Q
        self._since_image = increment if self._gap == 1 else compose_increments(self._since_image, increment)
        problem = self._checks.problem(frame, self._since_image)
        if problem:
            tracks.keep(tracks.age <= self._settings.memory)
            return self._nothing(problem)
        assert frame.image is not None
        clock = _Clock()
        self._size = frame.image.shape[1], frame.image.shape[0]
        if self._settings.levels == 1:
            features = extract_features(frame.image, count=self._settings.features)
        else:
            count, levels = self._settings.features, self._settings.levels
            features = extract_pyramid(frame.image, count=count, levels=levels)
        clock.lap("features")
        measured = self._measure(frame, features)
        self._checks.look(features, measured, self._since_image)
        clock.lap("depth")
        windows = self._look_ahead()
        clock.lap("prediction")
        which, chosen = self._match(windows, features)
        rows = windows.rows[which]
        clock.lap("matching")
        epipolar, event = epipolar_test(
            tracks,
            rows,
            features.xy[chosen],
            self._image_camera,
            self._history,
            seed=int(self._generator.integers(2**31)),
            threshold_px=self._settings.threshold_px,
        )
        clock.lap("verification")
        by_window = windows.distances(which, features.xy[chosen]) <= self._pixel_gate
        agrees = self._agrees(by_window, rows, features.xy[chosen], measured, chosen)
        self._sharpen(rows, chosen, measured, epipolar & agrees)
        agrees &= self._agrees(by_window, rows, features.xy[chosen], measured, chosen)
        passed = epipolar & agrees
        record = MatchRecord(
            self._frame, tracks.age[rows], tracks.pixel[rows], features.xy[chosen], epipolar, passed
        )
        tracks.rejections[rows[~passed]] += 1
        fates = np.where(epipolar, MAHALANOBIS, EPIPOLAR)
        fates[passed], entries = self._correct(rows[passed], chosen[passed], features, measured)
        kept = fates == KEPT
        new, new_rows = self._start(features, chosen, measured, self._settings.followed - int(passed.sum()))
        if kept.sum() >= _MATCHES_MIN:
            new, new_rows = new[:0], new_rows[:0]
        seen, seen_rows = np.concatenate([chosen[kept], new]), np.concatenate([rows[kept], new_rows])
        self._name(seen_rows)
        # The tests above judge one image at a time; a back end adds up what repeats itself.
        R = (
            self._correlation.factor
            * (1.0 if isinstance(self.sensor, StereoCamera) else SIGHTING)
            * measured.R[seen]
        )
        detections = Detections(measured.z[seen], R, tracks.id[seen_rows])
        self._forget()
        self._gap = 0
        self._since_image = np.eye(4), np.zeros((6, 6))
        clock.lap("tracks")
        counts = np.bincount(fates, minlength=ENTERED + 1)
        counts[UNMATCHED] = len(features.xy) - len(rows) - len(new)
        counts[KEPT] += len(new) + counts[ENTERED]
        mask = np.zeros(len(features.xy), dtype=bool)
        mask[seen] = mask[chosen[fates == ENTERED]] = True
        return Sighting(
            detections,
            entries,
            mask,
            (len(features.xy), *counts[:ENTERED].tolist()),
            event,
            clock.times_ms,
            record,
        )

    def _nothing(self, event: str) -> Sighting:
        nobody, d = np.zeros(0, dtype=bool), self.sensor.dim
        return Sighting(
            Detections(np.empty((0, d)), np.empty((0, d, d)), np.empty(0, np.int64)),
            None,
            nobody,
            (0,) * (len(STAGES) + 2),
            event,
            {},
        )

    def _look_ahead(self) -> Windows:
        """Windows in the new image, after the history has come up to it."""
        self._history.advance(*self._since_image)
        back = self._tracks.view_back
        back[back >= 0] += 1
        # What is older than the history has lost its pose.
        back[back >= len(self._history.T_view)] = -1
        return search_windows(
            self._tracks,
            self._image_camera,
            self._history,
            self._size,
            sigma_px=self._settings.sigma_px,
            depth_min_m=self._settings.depth_min_m,
            widest_px=_WIDEST_PX,
        )

    def _match(self, windows: Windows, features: Features) -> tuple[IntArray, IntArray]:
        """Windows and features that belong together, (m,) and (m,)."""
        settings = self._settings
        candidates = windows.near(features.xy, _SEARCH_FACTOR * self._pixel_gate)
        matches = match_candidates(
            self._tracks.descriptor[windows.rows], features.descriptors, *candidates, ratio=settings.ratio
        )
        long_ago = self._tracks.age[windows.rows[matches.pairs[:, 0]]] > _LONG_AGO
        which, chosen = matches.pairs[~long_ago | (matches.distance <= _SURE_BITS)].T
        if settings.wrong_match_share > 0:
            chosen = spoil_matches(chosen, len(features.xy), settings.wrong_match_share, self._generator)
        return which, chosen

    def _agrees(
        self, by_window: BoolArray, rows: IntArray, now: FloatArray, measured: Measured, chosen: IntArray
    ) -> BoolArray:
        """The Mahalanobis test: of the whole measurement, else of the pixel; for rays by their window."""
        agrees = by_window.copy()
        placed, valid = self._tracks.placed[rows], measured.valid[chosen]
        whole, pixel_only = (placed & valid).nonzero()[0], (placed & ~valid).nonzero()[0]
        by = chosen[whole]
        squared = self._tracks.distances(rows[whole], self.sensor, measured.z[by], measured.R[by])
        agrees[whole] = squared <= self._gate
        if not pixel_only.size:
            return agrees
        R = np.broadcast_to(self._settings.sigma_px**2 * np.eye(2), (pixel_only.size, 2, 2))
        squared = self._tracks.distances(rows[pixel_only], self._image_camera, now[pixel_only], R)
        agrees[pixel_only] = squared <= self._pixel_gate
        return agrees

    def _sharpen(self, rows: IntArray, chosen: IntArray, measured: Measured, trusted: BoolArray) -> None:
        """Move all tracks by what the trusted matches say together about the odometry's error."""
        tracks = self._tracks
        which = np.flatnonzero(trusted & tracks.placed[rows] & measured.valid[chosen])
        if len(which) < _MATCHES_MIN:
            return
        q, z, R = tracks.q[rows[which]], measured.z[chosen[which]], measured.R[chosen[which]]
        expected, H_point = self.sensor.linearise_in_body(q)
        H = H_point @ tracks.by_motion(q)
        _, Q = self._since_image
        S = H_point @ tracks.C[rows[which]] @ H_point.mT - H @ Q @ H.mT + R
        xi, left = common_motion(self.sensor.residual(z, expected), S, H, Q)
        tracks.correct_motion(xi, Q, left)

    def _correct(
        self, rows: IntArray, chosen: IntArray, features: Features, measured: Measured
    ) -> tuple[IntArray, Detections | None]:
        """Correct the tracks and place what can be placed: the fate of each match, and the entries."""
        tracks, settings = self._tracks, self._settings
        placed, valid = tracks.placed[rows], measured.valid[chosen]
        whole, pixel_only = placed & valid, placed & ~valid
        latest = tracks.correct(
            rows[whole], self.sensor, measured.z[chosen[whole]], measured.R[chosen[whole]]
        )
        latest[tracks.sightings[rows[whole]] < SETTLED] = np.nan
        self._correlation.learn(latest, tracks.note_innovations(rows[whole], latest))
        R = np.broadcast_to(settings.sigma_px**2 * np.eye(2), (int(pixel_only.sum()), 2, 2))
        tracks.correct(rows[pixel_only], self._image_camera, features.xy[chosen[pixel_only]], R)
        tracks.see(rows, features.descriptors[chosen], features.xy[chosen])
        fate = np.full(len(rows), NO_PARALLAX)
        fate[placed] = np.where(tracks.sightings[rows[placed]] >= settings.min_sightings, KEPT, UNCONFIRMED)
        fate[(fate == KEPT) & ~valid] = NO_DEPTH
        new = place_rays(
            tracks,
            rows[~placed],
            self._image_camera,
            self._history,
            sigma_px=settings.sigma_px,
            parallax_min_deg=settings.parallax_min_deg,
            depth_min_m=settings.depth_min_m,
            gate_probability=settings.gate_probability,
        )
        tracks.rejections[new.contradicted] = _REJECTIONS_MAX
        self._name(new.rows)
        fate[tracks.placed[rows] & ~placed] = ENTERED
        return fate, Detections(new.z, new.R, tracks.id[new.rows]) if new.rows.size else None

    def _name(self, rows: IntArray) -> None:
        """Give new landmarks their ids; none is ever used again."""
        nameless = rows[self._tracks.id[rows] < 0]
        self._tracks.id[nameless] = np.arange(self._next_id, self._next_id + nameless.size)
        self._next_id += nameless.size

    def _start(
        self, features: Features, taken: IntArray, measured: Measured, wanted: int
    ) -> tuple[IntArray, IntArray]:
        """New tracks from features that are left, spread over the image; the features, and the new rows.

        The rows are empty for rays: only a measurement that places a point makes a landmark.
        """
        free = measured.valid.copy()
        free[taken] = False
        candidates = np.flatnonzero(free)
        candidates = candidates[~_crowded(features.xy[candidates], features.xy[taken])]
        if wanted <= 0 or not candidates.size:
            return np.empty(0, np.int64), np.empty(0, np.int64)
        spread = suppress_cells(features.xy[candidates], features.response[candidates], wanted)
        new = candidates[spread]
        rows = self._tracks.add(features.descriptors[new], features.xy[new])
        if not isinstance(self.sensor, StereoCamera):
            return new[:0], rows[:0]
        self._tracks.place(rows, self.sensor, measured.z[new], measured.R[new])
        return new, rows

    def _forget(self) -> None:
        """Landmarks are remembered for a while; what is none yet must be seen in every image."""
        tracks = self._tracks
        patience = np.where(tracks.id >= 0, self._settings.memory, 0)
        tracks.keep((tracks.age <= patience) & (tracks.rejections < _REJECTIONS_MAX))


def _crowded(xy: FloatArray, taken: FloatArray) -> BoolArray:
    """Which pixels (m, 2) lie within the spacing of those taken (n, 2), a mask over them, (m,)."""
    # Read as unsigned, what lies before the interval is beyond its end: one comparison an axis.
    column, row = np.rint(xy.T).astype(np.int32)
    first_column, first_row = np.rint(taken.T).astype(np.int32) - _SPACING_PX
    near = (column[:, None] - first_column).view(np.uint32) <= 2 * _SPACING_PX
    near &= (row[:, None] - first_row).view(np.uint32) <= 2 * _SPACING_PX
    crowded: BoolArray = near.any(axis=1)
    return crowded


@dataclass
class _Clock:
    times_ms: dict[str, float] = field(default_factory=dict)
    _since: float = field(default_factory=perf_counter)

    def lap(self, name: str) -> None:
        now = perf_counter()
        self.times_ms[name] = 1e3 * (now - self._since)
        self._since = now
