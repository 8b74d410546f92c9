"""Make the images of README and docs from the shipped experiments: python docs/make_figures.py [IMAGE …]

Runs what has no result yet into the results folder (minutes for the smaller experiments, a quarter of an hour
for all) and draws each figure into docs/images. Estimates repeat to the last digit; panels of times are those
of the machine, and only comparable with --jobs 1 on a quiet one.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from pathlib import Path

from slamcmp.experiment.runner import run_experiment
from slamcmp.experiment.shipped import find_experiment
from slamcmp.report import draw_figures

DOCS = Path(__file__).resolve().parent

IMAGES = {
    "dial.png": ("dial", "dial"),
    "attribution.png": ("dial", "attribution"),
    "filter_vs_smoother.png": ("filter_vs_smoother", "sweep"),
    "observability.png": ("observability", "observability"),
    "kl_from_batch.png": ("observability", "kl_from_batch"),
    "association.png": ("association", "association"),
    "victoria_park_map.png": ("victoria_park", "map"),
}
"""File in docs/images: shipped experiment, figure."""


def make(names: list[str], results: Path, jobs: int | None) -> None:
    """Run the experiments that these images need, and draw them.

    Raises:
        SystemExit: a figure could not be drawn; the message says why.
    """
    for experiment in dict.fromkeys(IMAGES[name][0] for name in names):
        found = run_experiment(
            find_experiment(experiment), folder=results / experiment, jobs=jobs, progress=True
        )
        for name in names:
            if IMAGES[name][0] != experiment:
                continue
            figure = IMAGES[name][1]
            with tempfile.TemporaryDirectory() as folder:
                files = draw_figures(found, [figure], Path(folder), ["png"])
                if not files:
                    sys.exit(f"{name}: figure {figure!r} was not drawn: {files.skipped[figure]}")
                shutil.copyfile(files[0], DOCS / "images" / name)
            print(f"docs/images/{name}")


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n", 1)[1])
    parser.add_argument("images", nargs="*", metavar="IMAGE", help=f"of {', '.join(IMAGES)}; default: all")
    parser.add_argument("--results", type=Path, default=Path("results"), help="default: results")
    parser.add_argument("--jobs", type=int, default=None, help="default: one for each core")
    options = parser.parse_args()
    unknown = sorted(set(options.images) - set(IMAGES))
    if unknown:
        parser.error(f"no image {', '.join(unknown)}; known: {', '.join(IMAGES)}")
    make(options.images or list(IMAGES), options.results, options.jobs)


if __name__ == "__main__":
    main()
