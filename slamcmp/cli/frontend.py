"""``slamcmp frontend``."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Annotated

import typer

from slamcmp.errors import DataError


def add_commands(app: typer.Typer) -> None:
    """Put this file's command into the application."""
    app.command(epilog="Example: slamcmp frontend left.jpg right.jpg --output figures")(frontend)


def frontend(
    images: Annotated[list[Path], typer.Argument(help="Photographs; each is matched with the next one.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the figures.")] = Path(
        "results/frontend"
    ),
    count: Annotated[int, typer.Option(min=8, help="Features an image.")] = 500,
    suppression: Annotated[
        str, typer.Option(help="cells (fast), brown (exact radii) or none (only the strongest).")
    ] = "cells",
    levels: Annotated[
        int, typer.Option(min=1, max=16, help="Scales that corners are looked for at; 1 is the image alone.")
    ] = 8,
    method: Annotated[
        str, typer.Option(help="magsac, ransac (written out) or least_squares (which breaks).")
    ] = "magsac",
    ratio: Annotated[
        float, typer.Option(min=0.1, max=1.0, help="A match must be closer than this share of the next best.")
    ] = 0.8,
    threshold_px: Annotated[float, typer.Option(min=0.1, help="Largest distance of an inlier.")] = 1.0,
    seed: Annotated[int, typer.Option(help="Of the sampling.")] = 0,
    formats: Annotated[list[str] | None, typer.Option("--format", help="png (default), svg or pdf.")] = None,
) -> None:
    """Harris corners, suppression and matches of photographs: three figures and a table of counts."""
    # Slow to import, and not needed for --help.
    from slamcmp.frontend.vision.image_pair import match_features
    from slamcmp.frontend.vision.pyramid import extract_pyramid
    from slamcmp.image_files import SIDE_MIN_PX, image_problem, read_image
    from slamcmp.report.figures.frontend.front_end import draw_front_end, front_end_tables

    pictures = [read_image(path) for path in images]
    for path, picture in zip(images, pictures, strict=True):
        # What is black or flat is named in the table; what is too small has no place for a corner.
        if min(picture.shape) < SIDE_MIN_PX:
            raise DataError(f"{path}: {image_problem(picture)}")
    names = [path.stem for path in images]
    features = [
        extract_pyramid(picture, count=count, levels=levels, suppression=suppression)  # type: ignore[arg-type]
        for picture in pictures
    ]
    pairs = [
        match_features(
            first,
            second,
            seed=seed,
            ratio=ratio,
            method=method,  # type: ignore[arg-type]
            threshold_px=threshold_px,
        )
        for first, second in pairwise(features)
    ]
    for table in front_end_tables(names, features, pairs):
        if len(table):
            print(table.to_string(index=False, float_format=lambda value: f"{value:.1f}"), end="\n\n")
    for path in draw_front_end(names, pictures, features, pairs, output, formats=formats or ("png",)):
        print(path)
