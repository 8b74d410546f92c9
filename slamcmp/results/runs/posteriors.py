"""What back ends believed about pose and map at chosen frames: kept beside the run, and compared."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from slamcmp.errors import DataError
from slamcmp.metrics.information import posterior_kl
from slamcmp.support.files.atomic import write_atomically
from slamcmp.types import FloatArray, Landmarks


@dataclass(frozen=True)
class Posterior:
    """What a back end believed about pose and map after frame k."""

    k: int
    T_world_body: FloatArray
    landmarks: Landmarks
    joint: FloatArray
    """(p + n L, p + n L): pose in the body tangent, landmarks in world axes."""


def kl_series(posteriors: Sequence[Posterior], reference: Sequence[Posterior], frames: int) -> FloatArray:
    """KL divergence [nat] of each posterior from the reference's at the same frame, (frames,).

    NaN where one of the two is missing, or has a covariance that is singular (a start known exactly).
    """
    series = np.full(frames, math.nan)
    known = {each.k: each for each in reference}
    for own in posteriors:
        other = known.get(own.k)
        if other is None or own.k >= frames:
            continue
        try:
            series[own.k] = posterior_kl(
                own.T_world_body,
                own.landmarks,
                own.joint,
                other.T_world_body,
                other.landmarks,
                other.joint,
            )
        except DataError:
            continue
    return series


def save_posteriors(posteriors: Sequence[Posterior], path: Path) -> None:
    """Write them as one npz file.

    Raises:
        StorageError: it cannot be written.
    """
    arrays: dict[str, Any] = {"k": np.array([each.k for each in posteriors], dtype=np.int64)}
    for each in posteriors:
        arrays |= {
            f"{each.k}/T": each.T_world_body,
            f"{each.k}/ids": each.landmarks.ids,
            f"{each.k}/positions": each.landmarks.positions,
            f"{each.k}/covariances": each.landmarks.covariances,
            f"{each.k}/joint": each.joint,
        }
    write_atomically(path, lambda file: np.savez(file, **arrays))


def load_posteriors(path: Path) -> list[Posterior]:
    """Those of a file; none where there is no file that can be read."""
    try:
        with np.load(path, allow_pickle=False) as file:
            return [
                Posterior(
                    k,
                    file[f"{k}/T"],
                    Landmarks(file[f"{k}/ids"], file[f"{k}/positions"], file[f"{k}/covariances"]),
                    file[f"{k}/joint"],
                )
                for k in file["k"].tolist()
            ]
    except Exception:
        # As with run files: a changed byte surfaces as whatever zipfile or numpy meet first.
        return []
