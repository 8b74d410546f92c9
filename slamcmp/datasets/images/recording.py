"""From the files of a recording to a log: which frames count, their time stamps, odometry and prior.

A reader says only where the files are and what they mean: ``@image_source(name, …)`` above a function that
returns a :class:`Recording` registers a source with the reader's parameters and :class:`RecordingSettings`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Gt

from slamcmp.datasets.images.camera_frames import RecordedFrames
from slamcmp.datasets.images.recorded_odometry import OdometryKind, OdometryNoise, make_odometry
from slamcmp.errors import DataError
from slamcmp.models.camera import MonoCamera, RgbdCamera, StereoCamera
from slamcmp.randomness import random_streams
from slamcmp.registry import sources
from slamcmp.support.configuration.shared_settings import SharedSettings
from slamcmp.types import Detections, FloatArray, GroundTruth, Log, Problem

NotNegative = Annotated[float, Ge(0)]
AnyCamera = MonoCamera | StereoCamera | RgbdCamera

_GAP = 2.5
"""Times the median step: at one lost frame it is 2, which every recording has."""
_USUAL_STEP_S = (1e-4, 60.0)
"""Between images of a camera that moves: a high-speed camera's, and one photograph a minute."""
_OWN_WORLD = 1e-6
"""Deviation of a first pose that defines the world, per axis [rad, m]; smoothers need more than zero."""
_NAMED = 3
"""Frames that a warning names; the rest it counts."""


@dataclass(frozen=True)
class Recording:
    """What a reader found: one entry a frame, in the order of the files."""

    name: str
    t: FloatArray
    """(K,) [s]; any origin."""
    images: RecordedFrames
    camera: AnyCamera
    truth: FloatArray | None = None
    """``T_world_body`` (K, 4, 4), NaN where it is not known; None for a recording without."""
    odometry: FloatArray | None = None
    """Poses (K, 4, 4) that drift, NaN where they are not known."""
    files: tuple[Path, ...] = ()
    """What was read beside the images."""
    warnings: tuple[str, ...] = ()
    truth_sigma: float = 0.01
    """How well the true poses are known themselves, per axis [rad, m]: they were tracked, not given."""


@dataclass(frozen=True, kw_only=True)
class RecordingSettings:
    """Parameters that all recordings share."""

    start: Annotated[int, Ge(0)] = 0
    steps: Annotated[int, Ge(2)] | None = None
    every: Annotated[int, Ge(1)] = 1
    odometry: OdometryKind = "corrupted_truth"
    translation_sigma_m: Annotated[float, Gt(0)] = 0.005
    translation_sigma_per_m: NotNegative = 0.02
    rotation_sigma_deg: Annotated[float, Gt(0)] = 0.2
    speed_sigma_m_s: Annotated[float, Gt(0)] = 1.0
    turn_sigma_deg_s: Annotated[float, Gt(0)] = 45.0
    prior_sigma: NotNegative | None = None


def setting_docs() -> dict[str, str]:
    """What each shared parameter means."""
    return {
        "start": "Frames to leave out at the beginning",
        "steps": "Frames to keep at most",
        "every": "2 keeps every second frame",
        "odometry": "True motion with drawn noise, the claim that nothing moved, or what was recorded",
        "translation_sigma_m": "Of the odometry, a step of usual length, per axis",
        "translation_sigma_per_m": "Of the odometry, share of the distance of a step, per axis",
        "rotation_sigma_deg": "Of the odometry, a step of usual length, per axis",
        "speed_sigma_m_s": "Of constant_position: how fast the body may move",
        "turn_sigma_deg_s": "Of constant_position: how fast the body may turn",
        "prior_sigma": "Of the first pose, per axis [rad, m]; by default the truth's own, 1e-6 without truth",
    }


Reader = Callable[..., Recording]
Source = Callable[..., Log]


def image_source(
    name: str, *, paths: Sequence[str] = (), seeded: bool = True, **defaults: Any
) -> Callable[[Reader], Source]:
    """Register ``read(*, own…) -> Recording`` as a source of logs with images.

    ``paths`` names the parameters that are files or folders; ``defaults`` stand in place of the shared ones.
    """

    def decorate(read: Reader) -> Source:
        shared = SharedSettings(name, read, RecordingSettings, defaults)

        def split(parameters: dict[str, Any]) -> tuple[Recording, RecordingSettings]:
            settings, own = shared.split(parameters)
            return _selected(read(**own), settings), settings

        def files(**parameters: Any) -> list[Path]:
            recording, _ = split(parameters)
            return [*recording.files, *(path for each in recording.images.files for path in each.existing())]

        def source(seed: int, **parameters: Any) -> Log:
            return _log(*split(parameters), random_streams(seed).odometry)

        register = sources.register(
            name, seeded=seeded, images=True, files=files, paths=tuple(paths), parameter_docs=setting_docs
        )
        return register(shared.signed(source))

    return decorate


@dataclass
class _Selection:
    """Indices of the frames that are left, and what was said about the others."""

    recording: Recording
    kept: list[int]
    warnings: list[str] = field(default_factory=list)

    def file(self, index: int) -> str:
        return self.recording.images.files[index].left.name

    def leave_out(self, dropped: Sequence[int], why: str) -> None:
        if not dropped:
            return
        named = ", ".join(self.file(index) for index in dropped[:_NAMED])
        more = f" and {len(dropped) - _NAMED} more" if len(dropped) > _NAMED else ""
        self.warnings.append(f"left out {len(dropped)} frame(s) {why}: {named}{more}")
        gone = set(dropped)
        self.kept = [index for index in self.kept if index not in gone]


def _selected(recording: Recording, settings: RecordingSettings) -> Recording:
    """The frames to use, in the order of time, with time stamps from 0 on.

    Raises:
        DataError: fewer than two frames are left.
    """
    count = recording.t.size
    chosen = _Selection(recording, list(range(count)))
    if count > 1 and (np.diff(recording.t) < 0).any():
        back = int(np.argmax(np.diff(recording.t) < 0)) + 1
        chosen.warnings.append(
            f"time stamps go back at {chosen.file(back)}; frames are taken in order of time"
        )
        chosen.kept.sort(key=lambda index: float(recording.t[index]))
    repeats = [b for a, b in pairwise(chosen.kept) if recording.t[a] == recording.t[b]]
    chosen.leave_out(repeats, "with the time stamp of another")
    for poses, what in ((recording.truth, "ground truth"), (recording.odometry, "recorded odometry")):
        if poses is not None:
            known = np.isfinite(poses.reshape(count, -1).sum(axis=1))
            chosen.leave_out([index for index in chosen.kept if not known[index]], f"without {what}")
    stop = None if settings.steps is None else settings.start + settings.steps * settings.every
    kept = chosen.kept[settings.start : stop : settings.every]
    if len(kept) < 2:
        reasons = "; ".join(chosen.warnings) or "start, steps and every leave no more"
        raise DataError(
            f"{recording.name}: {len(kept)} of {count} frames are usable where at least 2 are needed "
            f"({reasons})"
        )
    t = recording.t[kept] - recording.t[kept[0]]
    names = [chosen.file(index) for index in kept]
    return Recording(
        recording.name,
        t,
        recording.images.subset(kept),
        recording.camera,
        None if recording.truth is None else recording.truth[kept],
        None if recording.odometry is None else recording.odometry[kept],
        recording.files,
        (*recording.warnings, *chosen.warnings, *_gaps(t, names)),
        recording.truth_sigma,
    )


def _gaps(t: FloatArray, names: Sequence[str]) -> list[str]:
    steps = np.diff(t)
    usual = float(np.median(steps))
    if not _USUAL_STEP_S[0] <= usual <= _USUAL_STEP_S[1]:
        return [
            f"the usual step from image to image is {usual:.3g} s, and the recording lasts "
            f"{t[-1] - t[0]:.3g} s: are the stamps in seconds? time_unit_s is 1e-9 for nanoseconds"
        ]
    wide = np.flatnonzero(steps > _GAP * usual).tolist()
    # The longest first: it is the one to look at.
    named = [
        f"{steps[k]:.3g} s before frame {k + 1} ({names[k + 1]})"
        for k in sorted(wide, key=lambda k: -steps[k])[:_NAMED]
    ]
    more = f" and {len(wide) - _NAMED} more" if len(wide) > _NAMED else ""
    return [f"{len(wide)} gap(s) in time: {', '.join(named)}{more}; usual is {usual:.3g} s"] if named else []


def _log(recording: Recording, settings: RecordingSettings, generator: np.random.Generator) -> Log:
    noise = OdometryNoise(
        settings.translation_sigma_m,
        settings.translation_sigma_per_m,
        settings.rotation_sigma_deg,
        settings.speed_sigma_m_s,
        settings.turn_sigma_deg_s,
    )
    increments, covariances = make_odometry(
        settings.odometry,
        recording.t,
        noise,
        generator,
        truth=recording.truth,
        recorded=recording.odometry,
    )
    dim = recording.camera.dim
    nothing = Detections(np.empty((0, dim)), np.empty((0, dim, dim)), np.empty(0, np.int64))
    truth = None
    start = np.eye(4)
    # Where nothing tells a pose, the first one is the world.
    sigma = _OWN_WORLD if recording.truth is None else recording.truth_sigma
    if settings.prior_sigma is not None:
        sigma = settings.prior_sigma
    if recording.truth is not None:
        start = recording.truth[0]
        truth = GroundTruth(recording.t, recording.truth, np.empty(0, np.int64), np.empty((0, 3)))
    return Log(
        recording.name,
        Problem(start, sigma**2 * np.eye(6), recording.camera),
        recording.t,
        increments,
        covariances,
        (nothing,) * recording.t.size,
        truth,
        recording.images,
        recording.warnings,
    )
