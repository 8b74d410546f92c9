"""What a back end said, frame by frame, where it outlives the process; and what of it cannot be used."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamcmp.support.messages import told
from slamcmp.support.provenance.code_version import versions
from slamcmp.support.shared_arrays import SharedArrays
from slamcmp.types import (
    TANGENT_DIM,
    BoolArray,
    FloatArray,
    Frame,
    MeasurementStream,
    Run,
    Status,
    Trajectory,
)
from slamcmp.types.columns import parts

SERIES = "series/"
NAME_BYTES = 200
INDEFINITE = -1e-9
"""Smallest eigenvalue of a correlation matrix that still counts as rounding."""


class Collected:
    """What a back end said, in arrays made before the first frame."""

    def __init__(self, stream: MeasurementStream, shared: SharedArrays | None) -> None:
        frames, n = len(stream.frames), stream.problem.sensor.space_dim
        p = TANGENT_DIM[n]
        self._new = _unshared if shared is None else shared.new
        self.t = self._new("t", (frames,), 0.0)
        self.t[:] = [frame.t for frame in stream.frames]
        self.poses = self._new("poses", (frames, n + 1, n + 1), np.nan)
        self.covariances = self._new("covariances", (frames, p, p), np.nan)
        self.update_s = self._new("update_s", (frames,), 0.0)
        self.estimate_s = self._new("estimate_s", (frames,), 0.0)
        self.series: dict[str, FloatArray] = {}
        self._columns: dict[str, FloatArray] = {}
        """The same by the names that the back end gives them."""
        self.kept: list[BoolArray] | None = None
        self.done = 0
        self._checked = 0
        self._fault: str | None = None

    def note(self, k: int, values: Mapping[str, float]) -> None:
        known = self._columns
        for name, value in values.items():
            column = known.get(name)
            if column is None:
                # An author may call it anything; files and tables hold valid Unicode, and not endless.
                called = told(name, NAME_BYTES)
                column = self.series.get(called)
                if column is None:
                    column = self.series[called] = self._new(SERIES + called, (self.t.size,), np.nan)
                known[name] = column
            column[k] = value

    def keep_masks(self, stream: MeasurementStream) -> None:
        """Make room for which observations of each frame are used."""
        sizes = self._new("kept_sizes", (self.t.size,), 0, "int64")
        sizes[:] = [frame.ids.size for frame in stream.frames]
        masks = self._new("kept", (int(sizes.sum()),), False, "bool")
        self.kept = list(parts(masks, sizes))

    def keep(self, k: int, frame: Frame, back_end: Any) -> None:
        assert self.kept is not None
        kept = np.array(back_end.kept_observations(), dtype=bool)
        if kept.shape != frame.ids.shape:
            raise ValueError(f"kept_observations() has shape {kept.shape}; {frame.ids.shape} is needed")
        self.kept[k][...] = kept

    def where(self) -> str:
        return f"frame {self.done}" if self.done < self.t.size else "after the last frame"

    def first_bad(self) -> str | None:
        """Say what is wrong with the first unusable estimate and drop it with all that follows."""
        start, end = self._checked, self.done
        fault = first_fault(self.poses[start:end], self.covariances[start:end])
        self._checked = end
        if fault is not None and self._fault is None:
            self.done = self._checked = start + fault[0]
            self._fault = f"frame {self.done}: {fault[1]}"
        return self._fault

    def fields(self) -> dict[str, Any]:
        done = slice(self.done)
        return {
            "online": Trajectory(self.t[done], self.poses[done], self.covariances[done]),
            # Copies: a view would keep the file behind it open.
            "update_s": self.update_s[done].copy(),
            "estimate_s": self.estimate_s[done].copy(),
            "diagnostics": {name: column[done].copy() for name, column in self.series.items()},
            "kept_observations": None
            if self.kept is None
            else tuple(mask.copy() for mask in self.kept[done]),
        }


def recovered(
    shared: SharedArrays,
    done: int,
    *,
    label: str,
    parameters: Mapping[str, Any],
    digest: str,
    seed: int | None,
    frames: int,
    status: Status,
    message: str,
    space_dim: int = 2,
) -> Run:
    """The run of a process that was ended, with the ``done`` frames that it had finished.

    ``space_dim`` is only looked at where it had not come to its first frame.
    """
    arrays = shared.read()
    if not {"t", "poses", "covariances", "update_s", "estimate_s"} <= arrays.keys():
        done = 0
        arrays = {
            "t": np.empty(0),
            "poses": np.empty((0, space_dim + 1, space_dim + 1)),
            "covariances": np.empty((0, TANGENT_DIM[space_dim], TANGENT_DIM[space_dim])),
            "update_s": np.empty(0),
            "estimate_s": np.empty(0),
        }
    bad = first_fault(arrays["poses"][:done], arrays["covariances"][:done]) if done else None
    done = done if bad is None else bad[0]
    kept = None
    if {"kept", "kept_sizes"} <= arrays.keys():
        kept = tuple(parts(arrays["kept"], arrays["kept_sizes"]))[:done]
    return Run(
        back_end=label,
        parameters=parameters,
        digest=digest,
        seed=seed,
        frames=frames,
        status=status,
        message=message,
        online=Trajectory(arrays["t"][:done], arrays["poses"][:done], arrays["covariances"][:done]),
        update_s=arrays["update_s"][:done],
        estimate_s=arrays["estimate_s"][:done],
        diagnostics={
            name.removeprefix(SERIES): array[:done]
            for name, array in arrays.items()
            if name.startswith(SERIES)
        },
        kept_observations=kept,
        versions=versions(),
    )


def first_fault(poses: FloatArray, covariances: FloatArray) -> tuple[int, str] | None:
    """Index and description of the first pose or covariance ``(K, p, p)`` that cannot be used.

    A covariance may be singular (a start known exactly) but not indefinite beyond rounding; that is
    judged on the correlation matrix, for metres and radians differ by orders of magnitude.
    """
    finite_pose = np.asarray(np.isfinite(poses).all(axis=(1, 2)))
    finite = np.asarray(np.isfinite(covariances).all(axis=(1, 2)))
    good = np.where(finite[:, None, None], covariances, 0.0)
    sizes = np.abs(np.diagonal(good, axis1=1, axis2=2))
    scale = 1.0 / np.sqrt(np.where(sizes > 0, sizes, 1.0))
    correlation = good * scale[:, :, None] * scale[:, None, :]
    skewness = np.abs(correlation - np.swapaxes(correlation, 1, 2)).max(axis=(1, 2), initial=0.0)
    symmetric = np.asarray(skewness < 1e-6)
    smallest = np.linalg.eigvalsh(correlation)[:, 0]
    bad = ~(finite_pose & finite & symmetric & (smallest >= INDEFINITE))
    if not bad.any():
        return None
    k = int(np.argmax(bad))
    if not finite_pose[k]:
        return k, "the estimated pose is not finite"
    if not finite[k]:
        return k, "the estimated covariance is not finite"
    if not symmetric[k]:
        return k, "the estimated covariance is not symmetric"
    return k, (
        "the estimated covariance is not positive semi-definite "
        f"(smallest eigenvalue of its correlation matrix {smallest[k]:.3g})"
    )


def _unshared(_name: str, shape: tuple[int, ...], fill: float, dtype: str = "float64") -> NDArray[Any]:
    """An array of this process alone."""
    return np.full(shape, fill, dtype=dtype)
