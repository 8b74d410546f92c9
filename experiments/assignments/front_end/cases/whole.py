"""From two pictures to F, and the work whose time is taken."""

import numpy as np

from slamcmp.grading.results.scoring import as_array

from .drawn import BITS, KEPT, crowd, describe, draw, maxima
from .matched import WRONG_PX, distances, matches, rms, robust


def two_pictures(functions, generator):
    """The whole chain: from two drawn pictures to F. Local maxima and descriptors are ours."""
    rows, columns = np.mgrid[:96, :128].astype(float)
    place = np.stack([columns, rows], axis=-1)
    step = np.array([0.45, 0.08, 0.2])
    phase = generator.uniform(0, 2 * np.pi, 2)

    def in_second(seen):
        depth = 4.5 + 1.2 * np.sin(seen[..., 0] / 16 + phase[0]) + 0.8 * np.sin(seen[..., 1] / 12 + phase[1])
        body = np.concatenate([(seen - [64, 48]) / 110, np.ones((*seen.shape[:-1], 1))], axis=-1)
        body = body * depth[..., None] - step
        return 110 * body[..., :2] / body[..., 2:] + [64, 48]

    # What the second camera sees at a place is where the first one saw it.
    source = place.copy()
    for _ in range(40):
        source += place - in_second(source)
    seed = int(generator.integers(1 << 30))
    found, descriptors = [], []
    for seen in (place, source):
        image = draw(np.random.default_rng(seed), *np.moveaxis(seen, -1, 0), 50, (128, 96))
        response = functions.call("harris_response", image, 5, 0.05)
        xy, strength = maxima(as_array(response, image.shape, "the Harris response"))
        kept = functions.call("suppress", xy, strength, KEPT, 0.9)
        found.append(xy[as_array(kept, (KEPT,), "the answer of suppress").astype(int)])
        descriptors.append(describe(image, found[-1]))
    pairs = np.asarray(functions.call("match", *descriptors, 0.8)).astype(int).reshape(-1, 2)
    F, _ = robust(functions, generator, found[0][pairs[:, 0]], found[1][pairs[:, 1]], threshold_px=1.5)
    # Below this the error depends on what RANSAC happened to draw.
    error = max(rms(distances(F, place.reshape(-1, 2), in_second(place).reshape(-1, 2))), 8.0)
    return np.concatenate([np.ravel(found), [len(pairs), error]])


def work(functions, generator):
    image = generator.uniform(size=(120, 160))
    bits = generator.uniform(size=(2, 150, BITS)) < 0.5
    for _ in range(4):
        functions.call("harris_response", image, 5, 0.05)
        functions.call("suppress", *crowd(generator, 300), 100, 0.9)
        functions.call("match", *bits, 0.8)
        first, second, _, _ = matches(generator, 100, 0.25, 0.1, WRONG_PX)
        robust(functions, generator, first, second)
