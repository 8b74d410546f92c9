"""Make the images of README and docs from the shipped experiments: python docs/make_figures.py [IMAGE …]

Runs what has no result yet into the results folder (minutes for the smaller experiments, half an hour for
all) and draws each figure into docs/images. Estimates repeat to the last digit; panels of times are those
of the machine, and only comparable with --jobs 1 on a quiet one.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from pathlib import Path

from PIL import Image
from run_page import run_page

from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.experiment.config.shipped import find_experiment
from slamcmp.experiment.runner import run_experiment
from slamcmp.frontend.vision.image_pair import extract_features, match_features
from slamcmp.report import draw_figures
from slamcmp.report.figures.frontend.front_end import draw_front_end

DOCS = Path(__file__).resolve().parent

IMAGES = {
    "dial.png": ("dial", "dial"),
    "attribution.png": ("dial", "attribution"),
    "filter_vs_smoother.png": ("filter_vs_smoother", "sweep"),
    "observability.png": ("observability", "observability"),
    "kl_from_batch.png": ("observability", "kl_from_batch"),
    "association.png": ("association", "association"),
    "victoria_park_map.png": ("victoria_park", "map"),
    "rendered_room_map.png": ("rendered_room", "map"),
    "quickstart_errors.png": ("quickstart", "errors"),
    "unknown_association.png": ("unknown_association", "sweep"),
    "lecture_harris_corners.png": ("lecture/figure_1_harris_corners", "harris_corners"),
    "lecture_after_suppression.png": ("lecture/figure_2_suppression", "after_suppression"),
    "lecture_matches.png": ("lecture/figure_3_matches", "matches"),
    "lecture_ransac.png": ("lecture/problem_1_ransac", "ransac"),
}
"""File in docs/images: shipped experiment, figure."""

STUDY = {
    "answer_regimes.png": ("answer/relative_position", "regimes"),
    "answer_gain.png": ("answer/relative_position", "gain"),
    "answer_honesty.png": ("answer/relative_position", "honesty"),
}
"""The same, of the study that takes hours (``make answer``): drawn where they are named."""

MATCHES = {"rendered_room_matches.png": ("rendered_room", (20, 30))}
"""File in docs/images: shipped experiment with a camera, two of its first trial's images."""

PAGES = {
    "lecture_problem_1.png": "lecture/problem-1-ransac.md",
    "lecture_problem_2.png": "lecture/problem-2-linear-system.md",
    "lecture_problem_3.png": "lecture/problem-3-propagation.md",
    "lecture_problem_4.png": "lecture/problem-4-update.md",
    "lecture_problem_5.png": "lecture/problem-5-linearisation.md",
    "lecture_problem_6.png": "lecture/problem-6-ekf-propagation.md",
}
"""File in docs/images: the page whose own code draws it."""

LARGE_BYTES = 300_000
"""From here on a figure is made smaller: a checkout has all of them."""


def make(names: list[str], results: Path, jobs: int | None) -> None:
    """Run the experiments that these images need, and draw them.

    Raises:
        SystemExit: a figure could not be drawn; the message says why.
    """
    images = IMAGES | STUDY
    for experiment in dict.fromkeys(images[name][0] for name in names):
        found = run_experiment(
            find_experiment(experiment), folder=results / experiment, jobs=jobs, progress=True
        )
        for name in names:
            if images[name][0] != experiment:
                continue
            figure = images[name][1]
            with tempfile.TemporaryDirectory() as folder:
                files = draw_figures(found, [figure], Path(folder), ["png"])
                if not files:
                    sys.exit(f"{name}: figure {figure!r} was not drawn: {files.skipped[figure]}")
                keep(files[0], name)
            print(f"docs/images/{name}")


def keep(drawn: Path, name: str) -> None:
    """Put a figure where the pages have it; large ones in 128 colours, a third of the size."""
    kept = DOCS / "images" / name
    if drawn.stat().st_size < LARGE_BYTES:
        shutil.copyfile(drawn, kept)
        return
    with Image.open(drawn) as picture:
        picture.convert("RGB").quantize(128, method=Image.Quantize.MAXCOVERAGE).save(kept, optimize=True)


def make_matches(name: str) -> None:
    """Draw what ``slamcmp frontend`` draws of two images, for images that are not files."""
    experiment, pair = MATCHES[name]
    source = load_experiment(find_experiment(experiment)).source
    log = source.plugin().target(0, **source.parameters)
    pictures = [log.images[k].image for k in pair]
    features = [extract_features(picture, count=500) for picture in pictures]
    matches = match_features(*features, seed=0)
    with tempfile.TemporaryDirectory() as folder:
        titles = [f"image {k}" for k in pair]
        files = draw_front_end(titles, pictures, features, [matches], Path(folder))
        drawn = next(file for file in files if file.stem == "matches")
        keep(drawn, name)
    print(f"docs/images/{name}")


def make_of_page(name: str) -> None:
    """Run the page's code, and keep the figure."""
    with tempfile.TemporaryDirectory() as folder:
        run_page(DOCS / PAGES[name], Path(folder))
        keep(Path(folder) / name, name)
    print(f"docs/images/{name}")


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n", 1)[1])
    known = [*IMAGES, *MATCHES, *PAGES, *STUDY]
    parser.add_argument(
        "images", nargs="*", metavar="IMAGE", help=f"of {', '.join(known)}; default: all but the study's"
    )
    parser.add_argument("--results", type=Path, default=Path("results"), help="default: results")
    parser.add_argument("--jobs", type=int, default=None, help="default: one for each core")
    options = parser.parse_args()
    unknown = sorted(set(options.images) - set(known))
    if unknown:
        parser.error(f"no image {', '.join(unknown)}; known: {', '.join(known)}")
    names = options.images or [*IMAGES, *MATCHES, *PAGES]
    for name in names:
        if name in MATCHES:
            make_matches(name)
        if name in PAGES:
            make_of_page(name)
    of_experiments = [name for name in names if name not in {*MATCHES, *PAGES}]
    make(of_experiments, options.results, options.jobs)


if __name__ == "__main__":
    main()
