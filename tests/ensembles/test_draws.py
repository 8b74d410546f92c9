"""Counter-based noise: published answers, moments, and draws that have nothing to do with one another."""

from __future__ import annotations

import numpy as np
import pytest

from slamcmp.ensembles.kernels.draws import PART, SENSOR, normals, philox, uniforms

# The known answers that come with Random123 for philox4x32, ten rounds: counter, key, words.
KNOWN = [
    ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
    (
        (0xFFFFFFFF,) * 4,
        (0xFFFFFFFF,) * 2,
        (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD),
    ),
    (
        (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
        (0xA4093822, 0x299F31D0),
        (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
    ),
]


@pytest.mark.parametrize(("counter", "key", "words"), KNOWN)
def test_philox_gives_its_authors_answers(counter, key, words) -> None:
    assert philox(*map(np.uint64, (*counter, *key))) == words


def test_uniform_numbers_have_all_their_bits() -> None:
    a, b = np.transpose([uniforms(5, k, SENSOR, 2) for k in range(4000)])
    for each in (a, b):
        assert 0 < each.min() < 0.002
        assert 0.998 < each.max() < 1
        # 53 bits: the fraction of the last few is as even as the number itself (5 sigma).
        low = (each * 2**45) % 1.0
        assert abs(low.mean() - 0.5) < 5 / np.sqrt(12 * 4000)


def test_normal_numbers_are_normal_and_independent() -> None:
    draws = np.array([[normals(seed, k, PART, 0) for k in range(40)] for seed in range(100)])
    flat = draws.reshape(-1, 2)
    n = len(flat)
    # Five standard errors of each moment.
    assert np.abs(flat.mean(axis=0)).max() < 5 / np.sqrt(n)
    assert np.abs((flat**2).mean(axis=0) - 1).max() < 5 * np.sqrt(2 / n)
    assert np.abs((flat**4).mean(axis=0) - 3).max() < 5 * np.sqrt(96 / n)
    pairs = [
        (flat[:, 0], flat[:, 1]),
        (draws[:, 1:, 0].ravel(), draws[:, :-1, 0].ravel()),
        (draws[1:, :, 0].ravel(), draws[:-1, :, 0].ravel()),
    ]
    for a, b in pairs:
        assert abs(np.mean(a * b)) < 5 / np.sqrt(len(a))


def test_another_seed_frame_kind_or_number_is_another_draw() -> None:
    here = (7, 3, SENSOR, 2)
    others = [
        (8, 3, SENSOR, 2),
        (7, 4, SENSOR, 2),
        (7, 3, PART, 2),
        (7, 3, SENSOR, 3),
        (7 + 2**32, 3, SENSOR, 2),
    ]
    assert normals(*here) == normals(*here)
    assert len({normals(*each) for each in [here, *others]}) == 6
