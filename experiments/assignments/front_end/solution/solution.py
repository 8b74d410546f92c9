"""A front end: Harris, adaptive non-maximal suppression, matching, a pyramid, RANSAC, the Mahalanobis test.

Harris and Stephens 1988; Brown, Szeliski and Winder 2005, sec. 3; Lowe 2004, sec. 7.1; Hartley and Zisserman
2004, algorithms 11.1 and 4.6, eq. 11.9 and 4.18.
"""

import math

import numpy as np

SAMPLE = 8
CHI2_95 = {1: 3.841, 2: 5.991, 3: 7.815, 4: 9.488, 5: 11.07, 6: 12.59}


def harris_response(image, window, k):
    """det M - k (trace M)² at every pixel."""
    I_y, I_x = np.gradient(image)
    xx, xy, yy = (window_sum(product, window) for product in (I_x * I_x, I_x * I_y, I_y * I_y))
    determinant = xx * yy - xy**2
    trace = xx + yy
    return determinant - k * trace**2


def suppress(xy, response, count, c):
    """Indices of the corners that are farthest from a clearly stronger one."""
    squared = ((xy[:, None] - xy[None]) ** 2).sum(axis=-1)
    stronger = response[:, None] < c * response[None]
    radius = np.sqrt(np.where(stronger, squared, np.inf).min(axis=1))
    return np.lexsort((-response, -radius))[:count]


def match(descriptors1, descriptors2, ratio):
    """Pairs that are each other's closest, and clearly closer than the second best."""
    distance = hamming(descriptors1, descriptors2)
    best = distance.argmin(axis=1)
    closest, second = np.sort(distance, axis=1)[:, :2].T
    mutual = distance.argmin(axis=0)[best] == np.arange(len(distance))
    clear = closest < ratio * second
    kept = np.flatnonzero(mutual & clear)
    return np.stack([kept, best[kept]], axis=1)


def pyramid(image, levels):
    """Ever smaller pictures, each half as wide and high as the one before."""
    images = []
    for _ in range(levels):
        even = image[: image.shape[0] // 2 * 2, : image.shape[1] // 2 * 2]
        image = (even[0::2, 0::2] + even[1::2, 0::2] + even[0::2, 1::2] + even[1::2, 1::2]) / 4
        images.append(image)
    return images


def at_full_size(xy, level):
    """Where in the picture pixels of a level are: the middles of pixels have whole coordinates."""
    return (xy + 0.5) * 2.0**level - 0.5


def fundamental_least_squares(first, second):
    """The normalised eight-point algorithm on all matches."""
    (x1, T1), (x2, T2) = normalised(first), normalised(second)
    A = (x2[:, :, None] * x1[:, None, :]).reshape(-1, 9)
    F = np.linalg.svd(A)[2][-1].reshape(3, 3)
    U, s, Vt = np.linalg.svd(F)
    s[2] = 0.0
    return scaled(T2.T @ (U * s) @ Vt @ T1)


def sampson_distance(F, first, second):
    """First-order distance of the matches from obeying F."""
    x1, x2 = homogeneous(first), homogeneous(second)
    lines2, lines1 = x1 @ F.T, x2 @ F
    algebraic = np.abs((x2 * lines2).sum(axis=1))
    slope = np.sqrt(lines2[:, 0] ** 2 + lines2[:, 1] ** 2 + lines1[:, 0] ** 2 + lines1[:, 1] ** 2)
    return algebraic / slope


def samples_needed(inlier_share, confidence):
    """Samples until one holds inliers only, with the given confidence."""
    clean = inlier_share**SAMPLE
    if clean >= 1.0:
        return 1
    return max(1, math.ceil(math.log1p(-confidence) / math.log1p(-clean)))


def ransac_fundamental(first, second, threshold_px, confidence, samples_max, seed):
    """F that most matches agree with, fitted to all of them, and which they are."""
    generator = np.random.default_rng(seed)
    best, best_F = np.zeros(len(first), dtype=bool), None
    drawn, needed = 0, samples_max
    while drawn < needed:
        drawn += 1
        sample = generator.choice(len(first), SAMPLE, replace=False)
        F = fundamental_least_squares(first[sample], second[sample])
        inliers = sampson_distance(F, first, second) <= threshold_px
        if inliers.sum() > best.sum():
            best, best_F = inliers, F
            needed = min(samples_max, samples_needed(best.mean(), confidence))
    F, inliers = best_F, best
    for _ in range(20):
        F = fundamental_least_squares(first[inliers], second[inliers])
        before, inliers = inliers, sampson_distance(F, first, second) <= threshold_px
        if np.array_equal(before, inliers):
            break
    return F, inliers


def mahalanobis_test(z, z_predicted, S):
    """Squared Mahalanobis distance, and whether it is within the 95 % bound."""
    y = z - z_predicted
    squared = float(y @ np.linalg.solve(S, y))
    return squared, squared <= CHI2_95[len(y)]


def window_sum(values, window):
    """Sums over a centred square; outside of the image there is nothing."""
    padded = np.pad(values, window // 2)
    return np.lib.stride_tricks.sliding_window_view(padded, (window, window)).sum(axis=(2, 3))


def hamming(descriptors1, descriptors2):
    """How many bits differ, for every pair."""
    one, two = descriptors1.astype(float), descriptors2.astype(float)
    return one @ (1 - two).T + (1 - one) @ two.T


def normalised(points):
    """Homogeneous points with centroid 0 and mean distance √2, and the matrix that did it."""
    centre = points.mean(axis=0)
    scale = np.sqrt(2) / np.hypot(*(points - centre).T).mean()
    T = np.array([[scale, 0, -scale * centre[0]], [0, scale, -scale * centre[1]], [0, 0, 1]])
    return homogeneous(points) @ T.T, T


def homogeneous(points):
    """(m, 3) from (m, 2)."""
    return np.column_stack([points, np.ones(len(points))])


def scaled(F):
    """F with norm 1 and its largest entry positive."""
    return F / np.linalg.norm(F) * np.sign(F.flat[np.argmax(np.abs(F))])
