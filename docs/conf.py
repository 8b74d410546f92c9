"""The documentation site, built by Sphinx: make docs.

Pages are Markdown (MyST), as they are read in the repository; what they cannot hold by hand (commands,
plug-ins, shipped experiments) comes from directives in site_directives.py, and the reference from docstrings.
Nothing is fetched from anywhere, neither by the build nor by the pages.
"""

from __future__ import annotations

import os
import re
import sys
import tomllib
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
sys.path.insert(0, str(DOCS))

import site_directives  # noqa: E402

import slamcmp  # noqa: E402

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]

project = "slamcmp"
author = "the slamcmp authors"
copyright = f"{author}; {PROJECT['license']} licence"
version = release = slamcmp.__version__
language = "en_GB"

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build"]
myst_heading_anchors = 4
default_role = "code"
nitpicky = False

html_theme = "furo"
html_title = f"slamcmp {release}"
html_static_path: list[str] = []
html_show_sourcelink = False
html_copy_source = False

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True

os.environ["NO_COLOR"] = "1"


def leave_the_site(_app: Any, name: str, text: list[str]) -> None:
    """Links to files outside of docs/ lead to the repository."""
    page = DOCS / f"{name}.md"

    def link(found: re.Match[str]) -> str:
        address, _, place = found[1].partition("#")
        if "://" in address or not address:
            return found[0]
        target = (page.parent / address).resolve()
        if target.is_relative_to(DOCS) and not target.is_dir():
            return found[0]
        kind = "tree" if target.is_dir() else "blob"
        inside = target.relative_to(ROOT).as_posix()
        return f"]({PROJECT['urls']['Homepage']}/{kind}/main/{inside}{'#' + place if place else ''})"

    text[0] = re.sub(r"\]\(([^)\s]+)\)", link, text[0])


def single_backticks_are_code(
    _app: Any, _what: str, _name: str, _thing: Any, _options: Any, lines: list[str]
) -> None:
    """What stands in single backticks is code, as everywhere else in these pages."""
    lines[:] = [re.sub(r"(?<![`:\w])`([^`<>]+)`(?![`_\w])", r"``\1``", line) for line in lines]


def setup(app: Any) -> None:
    """Called by Sphinx."""
    app.connect("source-read", leave_the_site)
    app.connect("autodoc-process-docstring", single_backticks_are_code)
    site_directives.add_to(app)
