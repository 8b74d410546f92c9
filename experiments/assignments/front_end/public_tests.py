"""Run next to your front_end.py: python public_tests.py. The expected numbers are worked out by hand."""

import numpy as np
from front_end import (
    at_full_size,
    fundamental_least_squares,
    harris_response,
    mahalanobis_test,
    match,
    pyramid,
    ransac_fundamental,
    samples_needed,
    sampson_distance,
    scaled,
    suppress,
)


def test_harris_response():
    # A slope of 1 in x: I_x² sums to 9 in every full window of 3 x 3; one direction only, so det M = 0.
    slope = np.tile(np.arange(6.0), (5, 1))
    np.testing.assert_allclose(harris_response(slope, 3, 0.04)[1:-1, 1:-1], -0.04 * 9**2)
    # z = x y has the gradient (y, x): at (3, 2) Σ I_x² = 42, Σ I_y² = 87 and Σ I_x I_y = 54.
    saddle = np.outer(np.arange(5.0), np.arange(7.0))
    expected = 42 * 87 - 54**2 - 0.05 * (42 + 87) ** 2
    np.testing.assert_allclose(harris_response(saddle, 3, 0.05)[2, 3], expected)


def test_suppress():
    # Corners on a line. The second one is next to the strongest, the last one far from all.
    xy = np.array([[0.0, 0.0], [1.0, 0.0], [4.0, 0.0], [9.0, 0.0]])
    response = np.array([10.0, 8.0, 5.0, 1.0])
    # Radii: infinite, 1, 3, 5.
    assert list(suppress(xy, response, 3, 0.9)) == [0, 3, 2]
    # With c = 0.75 the strongest is not clearly stronger than the second any more.
    assert list(suppress(xy, response, 2, 0.75)) == [0, 1]


def test_match():
    one = np.array([[0, 0, 0, 0, 0, 0], [1, 1, 1, 1, 1, 1], [1, 1, 1, 1, 1, 0]], dtype=bool)
    two = np.array([[1, 1, 1, 1, 1, 1], [0, 0, 0, 0, 0, 1], [0, 0, 1, 1, 1, 1]], dtype=bool)
    # Bits that differ: [6, 1, 4], [0, 5, 2], [1, 4, 3]. The third one's closest prefers the second one.
    np.testing.assert_array_equal(match(one, two, 0.8), [[0, 1], [1, 0]])
    # 1 of 4 bits is too much for a ratio of 0.2, 0 of 2 bits never is.
    np.testing.assert_array_equal(match(one, two, 0.2), [[1, 0]])


def test_pyramid():
    image = np.array([[0.0, 2.0, 4.0, 4.0, 9.0], [2.0, 4.0, 0.0, 4.0, 9.0], [9.0, 9.0, 9.0, 9.0, 9.0]])
    half, quarter = pyramid(np.kron(image, np.ones((2, 2))), 2)
    np.testing.assert_allclose(half, image)
    # Means of two squares; the odd row and column are left out.
    np.testing.assert_allclose(quarter, [[2.0, 3.0]])


def test_at_full_size():
    # Pixel 0 of the half is pixels 0 and 1 of the picture, its middle at 0.5.
    # Pixel 3 of the quarter is 12 to 15.
    np.testing.assert_allclose(at_full_size(np.array([[0.0, 1.0]]), 1), [[0.5, 2.5]])
    np.testing.assert_allclose(at_full_size(np.array([[3.0, 0.0]]), 2), [[13.5, 1.5]])


def sideways(count):
    """The camera moves to the right: points keep their row, and F = [[0, 0, 0], [0, 0, -1], [0, 1, 0]]."""
    generator = np.random.default_rng(1)
    first = generator.uniform(0, 100, (count, 2))
    return first, first - np.column_stack([generator.uniform(5, 30, count), np.zeros(count)])


SIDEWAYS = np.array([[0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])


def test_fundamental_least_squares():
    F = scaled(fundamental_least_squares(*sideways(20)))
    assert min(np.abs(F - SIDEWAYS / np.sqrt(2)).max(), np.abs(F + SIDEWAYS / np.sqrt(2)).max()) < 1e-9


def test_sampson_distance():
    # One row apart, half of it on either side: 1 / √2 px.
    np.testing.assert_allclose(
        sampson_distance(SIDEWAYS, [[3.0, 7.0]] * np.ones((1, 2)), np.array([[1.0, 8.0]])), 2**-0.5
    )


def test_samples_needed():
    # log(0.01) / log(1 - 1/256) = 1176.6
    assert samples_needed(0.5, 0.99) == 1177
    assert samples_needed(1.0, 0.99) == 1


def test_ransac_fundamental():
    first, second = sideways(40)
    second[:10, 1] += np.linspace(30, 80, 10)
    F, inliers = ransac_fundamental(first, second, 1.0, 0.999, 1000, 0)
    np.testing.assert_array_equal(inliers, np.arange(40) >= 10)
    np.testing.assert_allclose(sampson_distance(F, first, second)[10:], 0, atol=1e-6)


def test_mahalanobis_test():
    # 3 px where the standard deviation is 2 px, 2 px where it is 1 px: 9/4 + 4/1 = 6.25 > 5.991.
    z, S = np.array([103.0, 52.0]), np.diag([4.0, 1.0])
    squared, accepted = mahalanobis_test(z, np.array([100.0, 50.0]), S)
    np.testing.assert_allclose(squared, 6.25)
    assert not accepted
    assert mahalanobis_test(z, np.array([100.0, 50.5]), S)[1]


if __name__ == "__main__":
    for name, test in list(globals().items()):
        if name.startswith("test_"):
            test()
            print(f"{name}: ok")
