"""A measurement stream from a source and a front end, and what of the log's truth belongs to it."""

from __future__ import annotations

import contextlib
import time
import traceback
from collections.abc import Mapping, MutableSequence, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import Any, overload

import numpy as np

from slamcmp.errors import SlamcmpError, UsageError
from slamcmp.experiment.job.planned import held_to_plan, inputs, require_unchanged, unseen_readers
from slamcmp.experiment.job.task import Task, stream_path
from slamcmp.frontend.stream_file import save_stream
from slamcmp.metrics.association import association_totals, in_own_names
from slamcmp.registry import front_ends, sources
from slamcmp.results.runs.run_file import StoredTruth, save_truth
from slamcmp.support.configuration.plugin_models import bind_parameters
from slamcmp.support.messages import describe, told
from slamcmp.support.provenance.opened_files import OpenedFiles
from slamcmp.types import CameraFrame, FloatArray, GroundTruth, Log, MeasurementStream


def make_stream(
    source: tuple[str, Mapping[str, Any]],
    front_end: tuple[str, Mapping[str, Any]],
    seed: int | None,
    heartbeat: MutableSequence[float] | None = None,
    watched: Watched | None = None,
) -> tuple[MeasurementStream, Log]:
    """The stream that a source and a front end, each (name, parameters), make from a seed; and its log.

    ``heartbeat[1]`` is set to the images taken so far; ``watched`` is who counts what they read.

    Raises:
        UsageError: one of them returns something else.
        Exception: whatever they raise.
    """
    seed = 0 if seed is None else seed
    watched = watched or Watched()
    with watched.source():
        plugin = sources.get(source[0])
        log: Log = plugin.target(seed, **bind_parameters(plugin, dict(source[1])))
    _require(log, Log, "source", plugin.name)
    if log.images is not None and heartbeat is not None:
        knows = hasattr(log.images, "true_pixels")
        images = (_CountedWithTruth if knows else _Counted)(log.images, heartbeat, watched)
        log = replace(log, images=images)
    with watched.front_end():
        plugin = front_ends.get(front_end[0])
        stream: MeasurementStream = plugin.target(log, seed, **bind_parameters(plugin, dict(front_end[1])))
    _require(stream, MeasurementStream, "front end", plugin.name)
    return stream, log


class Watched:
    """Who notes what a source and a front end read without Python's telling of it; nobody by default.

    Args:
        opened: what Python tells of meanwhile.
        declared: of the source and of the front end whether somebody vouches for it.
    """

    def __init__(self, opened: OpenedFiles | None = None, declared: tuple[bool, ...] = (True, True)) -> None:
        self._opened, self._declared = opened, declared

    def source(self) -> AbstractContextManager[object]:
        """While the source is at work."""
        return self._at_work(self._declared[0])

    def front_end(self) -> AbstractContextManager[object]:
        """While the front end is."""
        return self._at_work(self._declared[1])

    def _at_work(self, declared: bool) -> AbstractContextManager[object]:
        if self._opened is None:
            return contextlib.nullcontext()
        return self._opened.trusted() if declared else self._opened.reads.counted()


def _require(made: object, wanted: type, kind: str, name: str) -> None:
    if not isinstance(made, wanted):
        raise UsageError(f"{kind} {name!r} returned {type(made).__name__}; a {wanted.__name__} is needed")


class _Counted(Sequence[CameraFrame]):
    """Images that tell how many of them were asked for: making a stream of images takes a while.

    They are read when the front end asks for them, and are the source's business all the same.
    """

    def __init__(
        self, images: Sequence[CameraFrame], heartbeat: MutableSequence[float], watched: Watched
    ) -> None:
        self._images, self._heartbeat, self._watched = images, heartbeat, watched

    def __len__(self) -> int:
        return len(self._images)

    @overload
    def __getitem__(self, k: int) -> CameraFrame: ...
    @overload
    def __getitem__(self, k: slice) -> Sequence[CameraFrame]: ...
    def __getitem__(self, k: int | slice) -> CameraFrame | Sequence[CameraFrame]:
        self._heartbeat[1] += 1
        with self._watched.source():
            return self._images[k]


class _CountedWithTruth(_Counted):
    """Such images that know where they show the same surface."""

    def true_pixels(self, k: int, j: int, pixels: FloatArray) -> FloatArray:
        """Where frame j shows what frame k shows at pixels (m, 2)."""
        answer: FloatArray = self._images.true_pixels(k, j, pixels)  # type: ignore[attr-defined]
        return answer


def truth_of_stream(truth: GroundTruth | None, stream: MeasurementStream) -> GroundTruth | None:
    """A log's truth with its ``outliers`` over the stream's observations.

    They are None where the front end does not say which detections it kept. Landmarks bear the names that a
    front end without labels gave them.
    """
    if truth is not None and stream.report is not None and stream.report.association is not None:
        ids, positions = in_own_names(truth, stream.report.association)
        truth = replace(truth, ids=ids, positions=positions)
    if truth is None or truth.outliers is None:
        return truth
    outliers = None
    if stream.report is not None:
        kept = stream.report.kept
        fits = [mask.size == each.size for mask, each in zip(truth.outliers, kept, strict=True)]
        if all(fits):
            outliers = tuple(mask[each] for mask, each in zip(truth.outliers, kept, strict=True))
    return replace(truth, outliers=outliers)


def store_stream(task: Task, heartbeat: MutableSequence[float]) -> MeasurementStream | None:
    """Make the stream of a stream job and leave it, and what is known about it, in the results folder."""
    with held_to_plan(task) as opened:
        watched = Watched(opened, task.declared) if task.watched else None
        stream, known = _known_stream(task, heartbeat, watched)
    heartbeat[3] = time.monotonic()
    if stream is None:
        require_unchanged(task)
    else:
        save_stream(stream, stream_path(task.folder, stream.digest))
    unseen = unseen_readers(task, opened)
    if unseen:
        known = replace(known, warnings=(*known.warnings, _made_anew(task.declared, unseen)))
    save_truth(replace(known, inputs=inputs(task, opened)), task.result)
    return stream


def _made_anew(declared: tuple[bool, ...], unseen: str) -> str:
    kinds = [kind for kind, says in zip(("source", "front end"), declared, strict=True) if not says]
    registries = " and ".join(f"@{kind.replace(' ', '_')}s.register(..., files=...)" for kind in kinds)
    are, they_use, they_are = (
        ("is", "it uses", "it is") if len(kinds) == 1 else ("are", "they use", "they are")
    )
    return (
        f"the {' and the '.join(kinds)} {are} made anew each time, for {they_use} {unseen}, which may read "
        f"files that nobody sees; name them with {registries} and {they_are} kept"
    )


def _known_stream(
    task: Task, heartbeat: MutableSequence[float], watched: Watched | None
) -> tuple[MeasurementStream | None, StoredTruth]:
    """The stream of a stream job, and what is known about it; None where it cannot be made."""
    try:
        stream, log = make_stream(task.plugins[0], task.plugins[1], task.seed, heartbeat, watched)
        truth = truth_of_stream(log.truth, stream)
        totals = {} if stream.report is None else stream.report.totals()
        if log.truth is not None and truth is not None and truth.outliers is not None:
            for name, masks in (("outliers", log.truth.outliers), ("outliers kept", truth.outliers)):
                totals[name] = sum(int(mask.sum()) for mask in masks or ())
        closures = sum(
            frame.relative_poses.frames.size for frame in stream.frames if frame.relative_poses is not None
        )
        if closures:
            totals["loop closures"] = closures
        association = None if stream.report is None else stream.report.association
        if association is not None:
            totals |= {name: int(n) for name, n in association_totals(association).items()}
        of_front_end = () if stream.report is None else stream.report.warnings
        return stream, StoredTruth(
            stream.digest,
            len(stream.frames),
            truth,
            totals,
            warnings=tuple(map(told, (*log.warnings, *of_front_end, *_gaps(log)))),
            own_ids=None if association is not None else log.own_ids,
            association=association,
        )
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        expected = isinstance(error, SlamcmpError)
        if not expected:
            # For the log; what is expected says all in one line.
            with contextlib.suppress(Exception):
                traceback.print_exc()
        text = told(str(error)) if expected else describe(error)
        return None, StoredTruth("", 0, None, {}, (type(error).__name__, text))


def _gaps(log: Log) -> list[str]:
    """Where the truth knows no pose, for those who read the scores."""
    if log.truth is None or log.truth.known().all():
        return []
    known = log.truth.known()
    edges = np.flatnonzero(np.diff(np.concatenate([[True], known, [True]])))
    first, last = edges[0], edges[1] - 1
    more = f" and in {edges.size // 2 - 1} more places" if edges.size > 2 else ""
    return [
        f"{log.name}: the truth knows the pose in {int(known.sum())} of {known.size} frames (not in "
        f"frames {first} "
        f"to {last}{more}); scores are of those, truth_share tells how many they are"
    ]
