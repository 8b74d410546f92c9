"""Versions of code follow its text and that of what it imports."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

from slamcmp.support.provenance.code_version import PACKAGE, code_version, import_closure, other_libraries


def test_version_follows_the_neighbours_that_are_imported(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("import helper\n")
    (tmp_path / "helper.py").write_text("GATE = 9\n")
    (tmp_path / "other.py").write_text("x = 1\n")
    first = code_version([tmp_path / "mine.py"])
    (tmp_path / "other.py").write_text("x = 22\n")
    assert code_version([tmp_path / "mine.py"]) == first
    (tmp_path / "helper.py").write_text("GATE = 16\n")
    assert code_version([tmp_path / "mine.py"]) != first


@pytest.mark.parametrize("name", ["TYPE_CHECKING", "typing.TYPE_CHECKING"])
def test_imports_for_type_checkers_alone_are_no_part_of_what_computes(tmp_path: Path, name: str) -> None:
    head = "import typing\nfrom typing import TYPE_CHECKING\n"
    (tmp_path / "mine.py").write_text(f"{head}if {name}:\n    import told\nelse:\n    import run\n")
    (tmp_path / "told.py").write_text("import run\n")
    (tmp_path / "run.py").touch()
    assert import_closure([tmp_path / "mine.py"]) == {tmp_path / "mine.py", tmp_path / "run.py"}


def test_libraries_of_others_are_known_by_their_version_or_their_absence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    site = tmp_path / "site"
    site.mkdir()
    monkeypatch.syspath_prepend(site)
    mine = tmp_path / "mine.py"
    mine.write_text("import math, numpy, slamcmp.types\nimport helper\n")
    (tmp_path / "helper.py").write_text("def solve():\n    from wanted_library.solvers import fast\n")
    assert other_libraries([mine]) == {"wanted_library": "absent"}
    # A module that lies on the path without a distribution.
    (site / "wanted_library.py").touch()
    importlib.invalidate_caches()
    assert other_libraries([mine]) == {"wanted_library": "without a version"}
    # A distribution of another name that brings it, as opencv-python-headless brings cv2.
    told = site / "wanted_for_python-2.5.dist-info"
    told.mkdir()
    (told / "METADATA").write_text("Metadata-Version: 2.1\nName: wanted-for-python\nVersion: 2.5\n")
    (told / "top_level.txt").write_text("wanted_library\n")
    assert other_libraries([mine]) == {"wanted_library": "wanted-for-python 2.5"}


def test_numba_counts_for_the_filters_that_it_compiles() -> None:
    back_ends = PACKAGE / "backends"
    for name in ("ekf_slam", "variants", "iterated", "ukf"):
        assert "numba" in other_libraries([back_ends / "filters" / f"{name}.py"]), name
    assert other_libraries([back_ends / "gtsam_smoothers" / "batch.py"]) == {}
