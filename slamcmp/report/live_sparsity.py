"""The information matrix over time, and its fill-in one elimination after the other, as data for the page."""

from __future__ import annotations

from typing import Any

import numpy as np

from slamcmp.report.figures.drawable import typical_trial
from slamcmp.report.figures.runs.sparsity import (
    Graph,
    eliminate,
    marginalised,
    minimum_degree,
    shared_measurements,
    shown_frames,
    stream_of,
)
from slamcmp.results.store import Results
from slamcmp.types import MeasurementStream

MOMENTS = 24
"""Of the time slider."""
Fill = tuple[int, int, int]
"""Two variables, and which elimination (the first is 1) joined them."""


def live_sparsity(results: Results) -> dict[str, Any]:
    """The blocks of the typical trial at some moments.

    Raises:
        NotDrawable: the stream is gone, or its first frames alone have too many variables.
    """
    stream = stream_of(results, typical_trial(results))
    counts = np.unique(np.linspace(2, shown_frames(stream), MOMENTS).round().astype(int))
    return {"kind": "sparsity", "moments": [_moment(stream, int(count)) for count in counts]}


def fill_steps(graph: Graph, order: list[int]) -> list[Fill]:
    """The blocks that elimination fills, each with the step at which it does."""
    left = {node: set(neighbours) for node, neighbours in graph.items()}
    known = {node: set(neighbours) for node, neighbours in graph.items()}
    found: list[Fill] = []
    for step, node in enumerate(order, start=1):
        neighbours = sorted(left[node])
        for place, one in enumerate(neighbours):
            for other in neighbours[place + 1 :]:
                if other not in known[one]:
                    known[one].add(other)
                    known[other].add(one)
                    found.append((one, other, step))
        eliminate(left, node)
    return found


def _moment(stream: MeasurementStream, count: int) -> dict[str, Any]:
    """One position of the time slider: variables by their number, poses first."""
    graph = shared_measurements(stream, count)
    order = minimum_degree(graph, last=count - 1)
    kept = [count - 1, *range(count, len(graph))]
    left = marginalised(graph, kept)
    landmarks = list(dict.fromkeys(int(i) for frame in stream.frames[:count] for i in frame.ids))
    return {
        "t": round(float(stream.frames[count - 1].t), 3),
        "names": [*(f"pose {k}" for k in range(count)), *(f"landmark {each}" for each in landmarks)],
        "edges": [[i, j] for i in graph for j in sorted(graph[i]) if j < i],
        "order": order,
        "fill": fill_steps(graph, order),
        "kept": kept,
        "left": [[i, j] for i in left for j in sorted(left[i]) if j < i and j not in graph[i]],
    }
