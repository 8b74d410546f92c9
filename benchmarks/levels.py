"""What corners at more than one scale cost when points are followed: time and measurements against one level.

``tracked_features`` on a rendered drive with one camera and, where ``SLAMCMP_DATA`` names them, on pieces of
KITTI 06 (one camera) and 7-Scenes (RGB-D). Processor time, levels in turn, the smallest of two rounds; the
measurements are those of the stream.

Run ``python benchmarks/levels.py`` (about two minutes; ``--keep FILE`` writes the numbers down).
"""

from __future__ import annotations

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"

import argparse
import json
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from slamcmp.datasets.images.kitti_odometry import kitti_odometry
from slamcmp.datasets.images.seven_scenes import seven_scenes
from slamcmp.frontend.tracked_features import tracked_features
from slamcmp.types import CameraFrame, Log
from slamcmp.worlds.rendered import rendered

LEVELS = (1, 4, 8)
FRAMES = 35


def drives() -> Iterator[tuple[str, Log]]:
    yield "rendered room, one camera", rendered(0, camera="mono", steps=FRAMES)
    data = os.environ.get("SLAMCMP_DATA")
    if not data:
        return
    yield "KITTI 06", kitti_odometry(0, folder=str(Path(data) / "kitti06_first51"), steps=FRAMES)
    yield "7-Scenes", seven_scenes(0, folder=str(Path(data) / "7scenes_redkitchen"), steps=FRAMES)


def measure(log: Log) -> dict[str, dict[str, float]]:
    # Read beforehand: what an image costs to read or render does not count.
    assert log.images is not None
    images: list[CameraFrame] = [log.images[k] for k in range(log.t.size)]
    log = Log(**{**vars(log), "images": images})
    seconds: dict[int, list[float]] = {levels: [] for levels in LEVELS}
    kept: dict[int, int] = {}
    for _ in range(2):
        for levels in LEVELS:
            start = time.process_time()
            stream = tracked_features(log, 0, levels=levels)
            seconds[levels].append(time.process_time() - start)
            kept[levels] = sum(frame.ids.size for frame in stream.frames)
    return {
        f"levels_{levels}": {
            "time_ratio": round(min(seconds[levels]) / min(seconds[1]), 2),
            "measurements_share": round(kept[levels] / kept[1], 2),
        }
        for levels in LEVELS[1:]
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--keep", metavar="FILE", help="write the numbers to FILE, too")
    options = parser.parse_args()
    result = {name: measure(log) for name, log in drives()}
    text = json.dumps(result, indent=1, ensure_ascii=False) + "\n"
    sys.stdout.write(text)
    if options.keep:
        Path(options.keep).write_text(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
