"""The way into compiled loops: a filter hands its frames over where a kernel knows its equations.

The equations are in the filters' own files; kernels repeat them for the plane, where numpy's calls take
longer than the arithmetic, and are tested against them. Taken where numba is installed (extra ``fast``), the
filter is one of this package's own, its sensor is compiled, and nobody listens to the covariance; otherwise
the filter does its frames itself. The choice falls with the first frame.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.metadata
import importlib.util
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol

import numpy as np

from slamcmp.backends.entries import Entries, placed
from slamcmp.backends.far_points import FARTHEST, far_off
from slamcmp.backends.filters.covariances.covariance import JointCovariance
from slamcmp.backends.filters.covariances.error_covariance import ErrorCovariance, lost_covariance
from slamcmp.models.sensors import RangeBearing, RelativePosition
from slamcmp.types import FloatArray, Frame, IntArray, SensorModel, Trajectory

SENSORS = (RangeBearing, RelativePosition)
OWN_MODULES = "slamcmp.backends.filters."


class Owner(Protocol):
    """What loops ask of the filter whose frames they do (map_filter.py)."""

    @property
    def covariance(self) -> ErrorCovariance:
        """P."""

    @property
    def sensor(self) -> SensorModel:
        """The problem's."""

    @property
    def mean_pose(self) -> FloatArray:
        """(n+1, n+1)."""

    @property
    def mean_landmarks(self) -> FloatArray:
        """(L, n)."""

    @property
    def places(self) -> dict[int, int]:
        """A landmark's place in the map by its name, to be added to."""

    def show(self, T: FloatArray, landmarks: FloatArray) -> None:
        """Take the means for one's own."""


@dataclass(frozen=True)
class Recipe:
    """What a kernel has to know of a filter; names are the kernels' own."""

    chart: str
    """BODY, BODY_WORLD, WORLD, RIGHT or LEFT."""
    join_first: bool
    policy: str = "LATEST"
    """LATEST, FIRST, FIRST_BUT_NEW, CONSTRAINED or TRUTH."""
    iterations: int = 0
    """Of the iterated filter; 0: not iterated."""
    tolerance: float = 0.0
    sigma_points: tuple[float, float, float] | None = None
    """alpha, beta and kappa of an unscented filter."""
    truth: Any = None
    """The policy TRUTH, which knows all poses and landmarks."""


@dataclass(frozen=True)
class Kernels:
    """The compiled modules, and the address of the BLAS that they call."""

    ekf: ModuleType
    ukf: ModuleType
    steps: ModuleType
    planar: ModuleType
    blas: int


@functools.cache
def kernels() -> Kernels | None:
    """The compiled modules of EKF and UKF with the address of their BLAS; None without numba.

    The first call on a machine compiles for about a minute, and says so; every later one reads a cache.
    """
    if importlib.util.find_spec("numba") is None:
        return None
    try:
        from numba import config
        from numba.core import event
    except ImportError:
        return None
    if config.DISABLE_JIT:
        return None

    class Told(event.Listener):  # type: ignore[misc]
        """Says once that something is compiled."""

        said = False

        def on_start(self, event: Any) -> None:  # noqa: ARG002
            if not self.said:
                print(
                    "slamcmp: compiling filters for this machine, about a minute, once",
                    file=sys.stderr,
                    flush=True,
                )
            self.said = True

        def on_end(self, event: Any) -> None:
            """Nothing to say."""

    with event.install_listener("numba:compile", Told()):
        from slamcmp.backends.filters.compiled import ekf_kernel, ekf_steps, planar, rank_update, ukf_kernel
    with contextlib.suppress(OSError):
        _mark().touch()
    return Kernels(ekf_kernel, ukf_kernel, ekf_steps, planar, rank_update.blas_address())


def prepare(back_ends: Iterable[Any]) -> None:
    """Compile now, in sight of the user and once, what jobs of these classes would each have to wait for."""
    ours = any(getattr(each, "__module__", "").startswith(OWN_MODULES) for each in back_ends)
    if ours and not is_kept():
        kernels()


def is_kept() -> bool:
    """Whether all kernels were compiled here before, as they are now and by the numba that is installed."""
    return importlib.util.find_spec("numba") is not None and _mark().exists()


def _mark() -> Path:
    folder = Path(__file__).parent / "compiled"
    texts = [path.read_bytes() for path in sorted(folder.glob("*.py"))]
    known = [*texts, importlib.metadata.version("numba").encode(), sys.version.encode()]
    return folder / "__pycache__" / f"kernels-{hashlib.sha256(b''.join(known)).hexdigest()[:16]}.kept"


class Loops:
    """A filter's frames done by a kernel, if there is one for it.

    Args:
        owner: the filter, whose state this keeps up to date.
        recipe: None: there is no kernel for it.
    """

    def __init__(self, owner: Owner, recipe: Recipe | None = None) -> None:
        self._owner, self._recipe = owner, recipe
        self._state: _State | None = None
        self._chosen = not self._is_compiled()
        if not self._chosen:
            # Here, where nobody measures how long a frame takes.
            self._chosen = kernels() is None

    @property
    def answer(self) -> tuple[FloatArray, FloatArray] | None:
        """Pose and covariance in the body tangent after the last frame; None where no kernel did it."""
        return None if self._state is None else self._state.answer

    def take(self, frame: Frame) -> bool:
        """Do a frame, or leave it to the filter and answer False."""
        if not self._chosen:
            self._choose(frame)
        if self._state is None:
            return False
        self._state.run((frame,))
        return True

    def run(self, frames: Sequence[Frame]) -> Trajectory | None:
        """Do all frames in one call; their online poses and covariances. None: left to the filter."""
        if not self._chosen and frames:
            self._choose(frames[0])
        if self._state is None:
            return None
        poses, covariances = self._state.run(frames)
        return Trajectory(np.array([frame.t for frame in frames]), poses, covariances)

    def _is_compiled(self) -> bool:
        """Whether there is a kernel for what the filter is, its sensor and its way to keep P."""
        owner, P = self._owner, self._owner.covariance
        return (
            self._recipe is not None
            and type(owner).__module__.startswith(OWN_MODULES)
            and type(owner.sensor) in SENSORS
            and owner.sensor.space_dim == 2
            and type(P) is ErrorCovariance
            and not P.is_robust
            and type(P.storage) is JointCovariance
        )

    def _choose(self, frame: Frame) -> None:
        """Listeners come after the filter was made and before its first frame."""
        self._chosen = True
        modules = None if self._owner.covariance.has_listeners else kernels()
        if self._recipe is not None and modules is not None:
            self._state = _State(self._owner, self._recipe, modules, frame.k)


class _State:
    """The arrays on which a kernel works, and what of them the filter shows."""

    def __init__(self, owner: Owner, recipe: Recipe, modules: Kernels, first: int) -> None:
        self._owner, self._blas, self._names = owner, modules.blas, modules.steps
        self._kernel = modules.ekf if recipe.sigma_points is None else modules.ukf
        polar = isinstance(owner.sensor, RangeBearing)
        chart, policy = getattr(modules.planar, recipe.chart), getattr(modules.steps, recipe.policy)
        self._options = np.array([0, chart, policy, polar, recipe.join_first, recipe.iterations])
        tuning = recipe.sigma_points or (FARTHEST, recipe.tolerance)
        self._tuning = np.array(tuning, dtype=np.float64)
        self._unscented = recipe.sigma_points is not None
        self._truth = recipe.truth
        self._T = np.array(owner.mean_pose)
        self._start = self._T[:2, 2].copy()
        self._T_memory = (
            self._T.copy() if self._truth is None else self._truth.poses(np.array([max(first - 1, 0)]))[0]
        )
        self._memory = np.zeros(6)
        self._memory[2:4] = self._start
        self._room = np.empty((0, 2))
        self._points = np.empty((0, 2))
        assert isinstance(owner.covariance.storage, JointCovariance)
        self._storage = owner.covariance.storage
        self._storage.keep_one_triangle()
        self.answer: tuple[FloatArray, FloatArray] = (self._T, owner.covariance.pose_block())
        # For one frame at a time, where making arrays would take longer than working on them.
        self._one = np.zeros(2, dtype=np.int64), np.zeros(1, dtype=np.int64)
        self._one_nis, self._one_dof = np.empty(1), np.empty(1, dtype=np.int64)

    def run(self, frames: Sequence[Frame]) -> tuple[FloatArray, FloatArray]:
        """Poses and covariances after each frame.

        Raises:
            DivergedError: no likelihood, or points too far off.
            DataError: a measurement does not place its landmark.
        """
        owner = self._owner
        if len(frames) == 1:
            (frame,) = frames
            T_prev_body, Q, ids, z, R = (
                frame.T_prev_body[None],
                frame.Q[None],
                frame.ids,
                frame.z,
                frame.R,
            )
            starts, ks = self._one
            starts[1], ks[0] = ids.size, frame.k
            nis, dof = self._one_nis, self._one_dof
        else:
            T_prev_body, Q = np.array([f.T_prev_body for f in frames]), np.array([f.Q for f in frames])
            ids = np.concatenate([f.ids for f in frames])
            seen = [f for f in frames if f.ids.size] or frames[:1]
            z, R = np.concatenate([f.z for f in seen]), np.concatenate([f.R for f in seen])
            starts = np.cumsum([0, *(f.ids.size for f in frames)])
            ks = np.array([f.k for f in frames])
            nis, dof = np.empty(len(ks)), np.empty(len(ks), dtype=np.int64)
        known = len(owner.places)
        numbers = self._numbers(ids)
        self._T[:], self._room[:known] = owner.mean_pose, owner.mean_landmarks
        poses, covariances = np.empty((len(ks), 3, 3)), np.empty((len(ks), 3, 3))
        P = self._storage.rows()
        of_frames = (starts, numbers, z, R, poses, covariances, nis, dof)
        if self._unscented:
            done = self._kernel.run(
                self._T,
                P,
                self._room,
                self._start,
                known,
                self._options,
                self._tuning,
                self._blas,
                ks,
                T_prev_body,
                Q,
                *of_frames,
            )
        else:
            T_true = T_prev_body if self._truth is None else self._truth.poses(ks)
            done = self._kernel.run(
                self._T,
                P,
                self._room,
                self._points,
                self._T_memory,
                self._memory,
                self._start,
                known,
                self._options,
                self._tuning,
                self._blas,
                ks,
                T_prev_body,
                Q,
                T_true,
                *of_frames,
            )
        if done < len(frames):
            self._say_why(frames[done])
        owner.covariance.begin_frame(frames[-1].k)
        if dof[-1]:
            owner.covariance.nis, owner.covariance.nis_dof = float(nis[-1]), int(dof[-1])
        # Read-only, they are answers that need no copy.
        poses.setflags(write=False)
        covariances.setflags(write=False)
        self.answer = poses[-1], covariances[-1]
        # Copies, for what a filter has shown stays as it was.
        owner.show(poses[-1], self._room[: len(owner.places)].copy())
        return poses, covariances

    def _numbers(self, ids: IntArray) -> IntArray:
        """Places of the landmarks in the state, new ones behind the known; makes room for them."""
        places = self._owner.places
        known = len(places)
        names = ids.tolist()
        try:
            return np.array([places[name] for name in names], dtype=np.int64)
        except KeyError:
            numbers = np.array([places.setdefault(name, len(places)) for name in names], dtype=np.int64)
        count = len(places)
        if count > known:
            if self._truth is not None:
                new = np.array(list(places)[known:])
                self._truth.new(self._T, new, np.empty((new.size, 2)))
                self._points = self._truth.true_landmarks
            if count > len(self._room):
                self._room = _enlarged(self._room, count)
                if self._truth is None:
                    self._points = _enlarged(self._points, count)
            self._storage.make_room(3 + 2 * count)
        return numbers

    def _say_why(self, frame: Frame) -> None:
        """Raise what the filter itself would have raised."""
        fault = self._options[0]
        if fault == self._names.FAR:
            raise far_off(frame.k, float(self._memory[4]), float(self._memory[5]))
        if fault == self._names.NOWHERE:
            owner = self._owner
            new = ~np.isfinite(owner.sensor.invert(self._T, frame.z)).all(axis=1)
            placed(owner.sensor, self._T, Entries(frame.ids[new], frame.z[new], frame.R[new], 0), frame.k)
        raise lost_covariance(frame.k)


def _enlarged(rows: FloatArray, count: int) -> FloatArray:
    """The rows with room for as many more as ``count``."""
    room = np.empty((2 * count, rows.shape[1]))
    room[: len(rows)] = rows
    return room
