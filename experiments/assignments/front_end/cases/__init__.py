"""Data of the front end's tests: drawn pictures, bits that flip, and matches of a scene seen twice."""

from .drawn import (
    crowds,
    descriptions,
    half_the_size,
    harris_statements,
    pictures,
    pictures_to_shrink,
    places_in_levels,
)
from .matched import (
    bent,
    epipolar_statements,
    majority,
    outlier_scenes,
    outliers,
    predicted_observations,
    ransac_statements,
    right_matches,
    scenes,
    shares,
)
from .whole import two_pictures, work

__all__ = [
    "crowds",
    "descriptions",
    "half_the_size",
    "harris_statements",
    "pictures",
    "pictures_to_shrink",
    "places_in_levels",
    "bent",
    "epipolar_statements",
    "majority",
    "outlier_scenes",
    "outliers",
    "predicted_observations",
    "ransac_statements",
    "right_matches",
    "scenes",
    "shares",
    "work",
    "two_pictures",
]
