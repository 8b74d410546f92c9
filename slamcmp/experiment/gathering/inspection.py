"""Why a run failed or lost its consistency, as columns of the trials table."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from slamcmp.errors import SlamcmpError
from slamcmp.experiment.gathering.own_names import own_names
from slamcmp.frontend.stream_file import load_stream
from slamcmp.metrics.divergence import explain, find_suspect, first_departure
from slamcmp.metrics.map_shift import map_departure
from slamcmp.types import GroundTruth, IntArray, MeasurementStream, Run

FINDINGS: dict[str, Any] = {
    "departure_test": "",
    "departure_frame": math.nan,
    "departure_landmark": pd.NA,
    "departure_sigmas": math.nan,
    "diagnosis": "",
}
"""The columns, as they stand for a run that shows no fault: which test failed first and at which frame, the
landmark behind it, how far off its observation was, and all that in a sentence."""


class Inspector:
    """Looks at the runs of one trial; the stream is only read where a run needs an explanation."""

    def __init__(
        self, stream_file: Path, truth: GroundTruth | None, borrowed: bool, own_ids: IntArray | None = None
    ) -> None:
        self._stream_file, self._truth, self._borrowed = stream_file, truth, borrowed
        self._own_ids = own_ids

    def findings(self, run: Run) -> dict[str, Any]:
        """The columns :data:`FINDINGS` of one run."""
        departure = first_departure(run, self._truth, reference=self._borrowed)
        if (self._truth is None or self._borrowed) and self._stream is not None:
            known = [each for each in (departure, map_departure(self._stream, run)) if each is not None]
            departure = min(known, key=lambda each: each.k, default=None)
        if departure is None and (run.status == "ok" or not run.online.t.size):
            return dict(FINDINGS)
        suspect = None
        if self._stream is not None:
            last = run.online.t.size if departure is None else departure.k
            # What another back end says is no ground to call a measurement wrong.
            suspect = find_suspect(self._stream, run, None if self._borrowed else self._truth, last)
            if suspect is not None:
                (name,) = own_names(np.array([suspect.landmark]), self._own_ids)
                suspect = replace(suspect, landmark=int(name))
        found = {**FINDINGS, "diagnosis": explain(run, departure, suspect)}
        if departure is not None:
            found |= {"departure_test": departure.test, "departure_frame": float(departure.k)}
        if suspect is not None:
            found |= {"departure_landmark": suspect.landmark, "departure_sigmas": suspect.sigmas}
        return found

    @cached_property
    def _stream(self) -> MeasurementStream | None:
        """None where the file is gone or damaged: tables of old runs are made all the same."""
        try:
            return load_stream(self._stream_file)
        except (SlamcmpError, OSError):
            return None
