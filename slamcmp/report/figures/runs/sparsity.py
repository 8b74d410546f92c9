"""What keeping the past costs in blocks: the information matrix, its factor, and what a filter keeps.

Everything is read off the measurement stream alone: which poses and landmarks share a measurement. A block of
the information matrix is not zero where two variables do (Dellaert and Kaess 2006, sec. III). Eliminating a
variable joins all its neighbours: the fill-in of the Cholesky factor, and, where the variable is a past pose
that a filter marginalises, the density of what is left.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray

from slamcmp.errors import SlamcmpError
from slamcmp.frontend.stream_file import load_stream
from slamcmp.registry import figures
from slamcmp.report.figures import style
from slamcmp.report.figures.drawable import NotDrawable, typical_trial
from slamcmp.results.grid import trial_name
from slamcmp.results.store import Results
from slamcmp.types import MeasurementStream

VARIABLES_MAX = 90
"""Poses and landmarks of the last moment: more would be grey."""
SHARES = (0.2, 0.55, 1.0)
"""Of the frames that are shown, the moments."""
Graph = dict[int, set[int]]
"""Neighbours of each variable."""
_COLOURS = ListedColormap(["#ffffff", "#0072B2", "#E69F00"])
_NONZERO, _FILL = 1, 2


@figures.register(
    "sparsity",
    title="Sparsity and fill-in, step by step",
    needs=("the stream of the typical trial",),
    on_request=True,
    caption=(
        "Blocks of the typical trial as time goes on, poses first and landmarks by their first sighting. "
        "First the information matrix of a smoother, which has a block where two variables share a "
        "measurement; then its Cholesky factor, eliminated by minimum degree with the newest pose last, as "
        "an incremental smoother does; last what a filter keeps, the newest pose and the landmarks, after "
        "every past pose was marginalised. Orange is fill-in: blocks that no measurement made."
    ),
)
def plot_sparsity(results: Results) -> Figure:
    """Information matrix, factor and marginal of a filter at three moments of the typical trial."""
    trial = typical_trial(results)
    stream = stream_of(results, trial)
    frames = shown_frames(stream)
    moments = sorted({max(2, round(share * frames)) for share in SHARES})
    title = f"What is kept, and what it fills: {trial_name(results, trial)}"
    figure = style.new_figure(3.3 * len(moments) + 0.4, 10.2, title)
    grid = figure.subplots(3, len(moments), squeeze=False)
    for column, count in enumerate(moments):
        graph = shared_measurements(stream, count)
        poses, size = count, len(graph)
        information = pattern(graph, range(size))
        order = minimum_degree(graph, last=poses - 1)
        factor = filled_pattern(graph, order)
        kept = [poses - 1, *range(poses, size)]
        left = marginal_pattern(graph, kept)
        t = stream.frames[count - 1].t
        _draw(grid[0, column], information, f"{count} poses, {t:g} s\ninformation: {blocks(information)}")
        _draw(grid[1, column], np.tril(factor), f"factor: {blocks(np.tril(factor))}")
        _draw(grid[2, column], left, f"filter: {blocks(left)}")
    keys = [
        style.line_key("shares a measurement", color="#0072B2", marker="s", linestyle=""),
        style.line_key("fill-in", color="#E69F00", marker="s", linestyle=""),
    ]
    style.legend_below(figure, keys)
    return figure


def stream_of(results: Results, trial: int) -> MeasurementStream:
    """What all back ends were given in this trial.

    Raises:
        NotDrawable: the file is gone.
    """
    digest = str(results.trials.loc[results.trials["trial"] == trial, "digest"].iloc[0])
    try:
        return load_stream(results.folder / "streams" / f"{digest}.npz")
    except SlamcmpError as error:
        raise NotDrawable(f"the stream is not there any more: {error}") from error


def shown_frames(stream: MeasurementStream) -> int:
    """How many frames have at most :data:`VARIABLES_MAX` poses and landmarks together.

    Raises:
        NotDrawable: hardly any.
    """
    known: set[int] = set()
    for count, frame in enumerate(stream.frames, start=1):
        known |= {int(each) for each in frame.ids}
        if count + len(known) > VARIABLES_MAX:
            break
    else:
        count = len(stream.frames) + 1
    if count < 4:
        raise NotDrawable(f"the first frames alone have more than {VARIABLES_MAX} variables")
    return count - 1


def shared_measurements(stream: MeasurementStream, count: int) -> Graph:
    """Which variables share a measurement in the first ``count`` frames: all poses, then landmarks."""
    graph: Graph = {k: set() for k in range(count)}
    number: dict[int, int] = {}
    for k, frame in enumerate(stream.frames[:count]):
        if k:
            _join(graph, k - 1, k)
        for landmark in map(int, frame.ids):
            place = number.setdefault(landmark, count + len(number))
            graph.setdefault(place, set())
            _join(graph, k, place)
        if frame.relative_poses is not None:
            for earlier in map(int, frame.relative_poses.frames):
                _join(graph, earlier, k)
    return graph


def minimum_degree(graph: Graph, last: int) -> list[int]:
    """An order of elimination: always the variable with fewest neighbours left, ``last`` in the end."""
    left = {node: set(neighbours) for node, neighbours in graph.items()}
    order = []
    while len(left) > 1:
        node = min((each for each in left if each != last), key=lambda each: (len(left[each]), each))
        order.append(node)
        eliminate(left, node)
    return [*order, last]


def filled_pattern(graph: Graph, order: Sequence[int]) -> NDArray[np.int8]:
    """The factor's blocks in the order of elimination, as a symmetric matrix: 1 as measured, 2 filled."""
    filled = {node: set(neighbours) for node, neighbours in graph.items()}
    left = {node: set(neighbours) for node, neighbours in graph.items()}
    for node in order:
        for neighbour in left[node]:
            _join(filled, node, neighbour)
        eliminate(left, node)
    return _marked(graph, filled, order)


def marginal_pattern(graph: Graph, kept: Sequence[int]) -> NDArray[np.int8]:
    """The blocks of what is left when all other variables are marginalised: 1 as measured, 2 filled."""
    return _marked(graph, marginalised(graph, kept), kept)


def marginalised(graph: Graph, kept: Sequence[int]) -> Graph:
    """Who shares something with whom when all other variables are marginalised."""
    left = {node: set(neighbours) for node, neighbours in graph.items()}
    for node in sorted(set(graph) - set(kept)):
        eliminate(left, node)
    return left


def pattern(graph: Graph, order: Iterable[int]) -> NDArray[np.int8]:
    """The information matrix's blocks."""
    return _marked(graph, graph, list(order))


def blocks(marks: NDArray[np.int8]) -> str:
    """``120 blocks of 400, 30 filled``."""
    filled = int((marks == _FILL).sum())
    text = f"{int((marks > 0).sum())} blocks of {marks.size}"
    return f"{text}, {filled} filled" if filled else text


def _marked(graph: Graph, known: Graph, order: Sequence[int]) -> NDArray[np.int8]:
    place = {node: i for i, node in enumerate(order)}
    marks = np.zeros((len(order), len(order)), dtype=np.int8)
    for node, i in place.items():
        marks[i, i] = _NONZERO
        for neighbour in known[node]:
            if neighbour in place:
                marks[i, place[neighbour]] = _NONZERO if neighbour in graph[node] else _FILL
    return marks


def _join(graph: Graph, one: int, other: int) -> None:
    if one != other:
        graph[one].add(other)
        graph[other].add(one)


def eliminate(left: Graph, node: int) -> None:
    """Take a variable out; its neighbours then share what it knew."""
    neighbours = left.pop(node)
    for each in neighbours:
        left[each] |= neighbours
        left[each] -= {each, node}


def _draw(axes: Axes, marks: NDArray[np.int8], title: str) -> None:
    axes.imshow(marks, cmap=_COLOURS, vmin=0, vmax=2, interpolation="nearest")
    axes.set_title(title, fontsize=8.5)
    axes.set_xticks([])
    axes.set_yticks([])
    axes.grid(visible=False)
