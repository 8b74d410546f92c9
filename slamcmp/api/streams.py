"""The measurement stream of a source, ready for any number of back ends."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from slamcmp.api.plugins import chosen
from slamcmp.experiment.job import make_stream as making
from slamcmp.registry import front_ends, sources
from slamcmp.types import GroundTruth, MeasurementStream


@dataclass(frozen=True)
class SourceStream(MeasurementStream):
    """A stream with what its source knows besides; a back end is given the frames, never this."""

    truth: GroundTruth | None = field(default=None, compare=False, repr=False)
    """None where the log has none. Its ``outliers`` mark the stream's observations."""
    seed: int = field(default=0, compare=False)
    source: str = field(default="", compare=False)
    """Registered name."""
    warnings: tuple[str, ...] = field(default=(), compare=False)
    """What a reader of results must know about the log."""

    def __repr__(self) -> str:
        frames, truth = len(self.frames), "no truth" if self.truth is None else "truth"
        about = f"{self.source!r}, seed {self.seed}: {frames} frames, {truth}, digest {self.digest[:12]}"
        return f"<SourceStream {about}>"


def make_stream(
    name: str, seed: int = 0, *, front_end: str | Mapping[str, Any] = "labelled", **parameters: Any
) -> SourceStream:
    """The stream that a source's log becomes in the front end: the same bytes for every back end.

    >>> import slamcmp
    >>> stream = slamcmp.make_stream("circle", 3, landmarks=10, steps=20)
    >>> stream
    <SourceStream 'circle', seed 3: 20 frames, truth, digest ...>
    >>> stream.frames[1].z.shape[1], stream.truth.positions.shape
    (2, (10, 2))
    >>> slamcmp.make_stream("circle", 3, landmark=10)
    Traceback (most recent call last):
    slamcmp...ConfigError: circle['landmark']: unknown key 'landmark'; did you mean 'landmarks'? Known: ...

    Args:
        name: of a registered source, or ``file.py:function``.
        seed: of the world and its noise; a recorded log takes none.
        front_end: a name, or a mapping with ``name`` and parameters.
        parameters: the source's own; ``slamcmp list sources NAME`` shows them.

    Raises:
        UsageError: there is no such source or front end, or a parameter is wrong.
        MissingDataError: a file it needs is not there.
    """
    _, of_source = chosen(sources, {"name": name, **parameters}, "source")
    _, of_front_end = chosen(front_ends, front_end, "front_end")
    front_end_name = front_end if isinstance(front_end, str) else front_end["name"]
    stream, log = making.make_stream((name, of_source), (front_end_name, of_front_end), seed)
    return SourceStream(
        stream.problem,
        stream.frames,
        stream.report,
        truth=making.truth_of_stream(log.truth, stream),
        seed=seed,
        source=name,
        warnings=(*log.warnings, *(stream.report.warnings if stream.report else ())),
    )
