"""A front end: fill in the functions and hand in this file as front_end.py.

Pixels are (x, y) = (column, row), images arrays (height, width) of grey values. A match is a row of ``first``
and the same row of ``second``: where a point of the scene is in the one picture and in the other.
"""

import numpy as np

SAMPLE = 8
"""Matches that determine F."""

CHI2_95 = {1: 3.841, 2: 5.991, 3: 7.815, 4: 9.488, 5: 11.07, 6: 12.59}
"""Below this lie 95 % of a sum of 1, 2, … squares of independent N(0, 1)."""


def harris_response(image, window, k):
    """Harris's corner response det M - k (trace M)² at every pixel.

    M = [[Σ I_x², Σ I_x I_y], [Σ I_x I_y, Σ I_y²]]. Take np.gradient for I_y (along axis 0) and I_x (along
    axis 1). The sums are over a square of window x window pixels with the pixel in its middle; what of it
    lies outside of the image adds nothing.

    Args:
        image: (height, width).
        window: side of the square [px], odd.
        k: Harris's constant.

    Returns:
        the response, (height, width).
    """
    raise NotImplementedError


def suppress(xy, response, count, c):
    """Adaptive non-maximal suppression: few corners, spread over the picture.

    The radius of corner i is its distance to the nearest corner j that is clearly stronger,
    response_i < c · response_j; it is infinite where there is none.

    Args:
        xy: pixels of the corners, (m, 2).
        response: of the corners, (m,).
        count: how many to keep.
        c: 0.9, say.

    Returns:
        indices (count,) of the corners with the largest radii, the largest first; the stronger one first
        where both are infinite.
    """
    raise NotImplementedError


def match(descriptors1, descriptors2, ratio):
    """Match binary descriptors by the number of bits in which they differ.

    A pair is kept if each is the closest of the other, and if it differs in fewer than ratio times as many
    bits as the first one's second closest.

    Args:
        descriptors1: of the features in the first picture, booleans (n, bits).
        descriptors2: of those in the second one, (m, bits).
        ratio: below 1.

    Returns:
        pairs (p, 2): index in the first picture, index in the second; in the order of the first.
    """
    raise NotImplementedError


def pyramid(image, levels):
    """Ever smaller pictures, so that corners of other sizes are found.

    Every pixel of the next one is the mean of a square of 2 x 2 pixels of the one before; an odd last row or
    column is left out.

    Args:
        image: level 0, the picture itself, (height, width).
        levels: how many smaller ones.

    Returns:
        list of levels 1, 2, …: (height // 2, width // 2), half of that, and so on.
    """
    raise NotImplementedError


def at_full_size(xy, level):
    """Where pixels of a pyramid's image lie in the picture itself.

    The middle of a pixel has whole coordinates: pixel (0, 0) of level 1 covers pixels 0 and 1 of the picture
    in both directions, and its middle lies between them.

    Args:
        xy: pixels in the image of that level, (m, 2).
        level: 0 is the picture, 1 its half, 2 its quarter.

    Returns:
        pixels in the picture, (m, 2).
    """
    raise NotImplementedError


def fundamental_least_squares(first, second):
    """F with x2ᵀ F x1 = 0 from all matches: the normalised eight-point algorithm.

    Move the points of each picture so that their centroid is 0, and scale them so that their mean distance
    from it is √2. Minimise |A f| with |f| = 1. Set the smallest singular value of F to zero, then undo the
    normalisation.

    Args:
        first, second: m >= 8 matches in pixels, (m, 2) each.

    Returns:
        F (3, 3) as scaled() leaves it.
    """
    raise NotImplementedError


def scaled(F):
    """Given: F with norm 1 and its largest entry positive, for any multiple of F says the same."""
    return F / np.linalg.norm(F) * np.sign(F.flat[np.argmax(np.abs(F))])


def sampson_distance(F, first, second):
    """How far matches are from obeying F, to first order.

    |x2ᵀ F x1| divided by the root of (F x1)_1² + (F x1)_2² + (Fᵀ x2)_1² + (Fᵀ x2)_2².

    Args:
        F: (3, 3), of any scale.
        first, second: (m, 2) each.

    Returns:
        distances (m,) in pixels.
    """
    raise NotImplementedError


def samples_needed(inlier_share, confidence):
    """How many samples of eight matches hold one without outliers, with the given confidence.

    Args:
        inlier_share: share of the matches that are right, above 0 and up to 1.
        confidence: a probability below 1.

    Returns:
        the number, rounded up, at least 1. np.log1p(-p) is log(1 - p) also for tiny p.
    """
    raise NotImplementedError


def ransac_fundamental(first, second, threshold_px, confidence, samples_max, seed):
    """The F that most matches agree with.

    Draw eight matches, fit F to them, count the matches whose Sampson distance is at most the threshold,
    and keep the best. Stop after samples_needed() of the best share up to now, or after samples_max. Then
    fit F to all inliers of the best and find the inliers of that F, again and again until they stay the
    same (at most 20 times).

    Args:
        first, second: m matches, some of them wrong, (m, 2) each.
        threshold_px: largest distance of an inlier.
        confidence: that one sample was without outliers.
        samples_max: largest number of samples.
        seed: for np.random.default_rng, where the draws come from.

    Returns:
        F (3, 3) as scaled() leaves it, and which matches are its inliers, booleans (m,).
    """
    raise NotImplementedError


def mahalanobis_test(z, z_predicted, S):
    """Is a feature where it was predicted?

    Args:
        z: observation with d components, (d,).
        z_predicted: its prediction, (d,).
        S: covariance of their difference, (d, d).

    Returns:
        the squared Mahalanobis distance, and True where it is at most the 95 % bound for d components.
    """
    raise NotImplementedError
