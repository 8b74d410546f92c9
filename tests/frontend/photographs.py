"""The photographs that gtsam's wheel carries, as grey images."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import gtsam
import numpy as np
from numpy.typing import NDArray

from slamcmp.image_files import read_image

FOLDER = Path(gtsam.__file__).parent / "Data" / "Balbianello"


@cache
def photograph(number: int) -> NDArray[np.uint8]:
    """Photograph 1 to 5, (427, 640)."""
    return read_image(FOLDER / f"BalbianelloMedium-{number}.jpg")
