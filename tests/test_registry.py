"""Plug-ins in a user's file: what changes is imported anew, what fails says where."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from slamcmp.errors import UsageError
from slamcmp.experiment.config.component import Component
from slamcmp.experiment.content_key import run_key
from slamcmp.registry import Registry, back_ends

CLASS = "class Mine:\n    def __init__(self, problem, *, gate={gate}): ...\n"


def default_gate(path: Path) -> int:
    return back_ends.get(f"{path}:Mine").parameters()["gate"].default


def test_changed_file_is_imported_anew(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text(CLASS.format(gate=9))
    assert default_gate(path) == 9
    before = back_ends.get(f"{path}:Mine").target
    assert back_ends.get(f"{path}:Mine").target is before
    path.write_text(CLASS.format(gate=16))
    assert default_gate(path) == 16


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("import sys\nsys.exit(3)\n", r"SystemExit: 3 \(mine\.py, line 2\)"),
        ("\n\nx = {}['gate']\n", r"KeyError: 'gate' \(mine\.py, line 3\)"),
        ("def f(:\n", r"SyntaxError: invalid syntax \(mine\.py, line 1\)"),
        (
            "import no_such_module_anywhere\n",
            r"No module named 'no_such_module_anywhere' \(mine\.py, line 1\)",
        ),
    ],
)
def test_file_that_does_not_import_is_a_usage_error(tmp_path: Path, content: str, told: str) -> None:
    path = tmp_path / "mine.py"
    path.write_text(content)
    for _ in range(2):
        with pytest.raises(UsageError, match=rf"mine\.py does not import: .*{told}$"):
            back_ends.get(f"{path}:Mine")


def test_annotation_that_cannot_be_evaluated_is_a_usage_error(tmp_path: Path) -> None:
    from slamcmp.support.configuration.plugin_models import parameter_model

    path = tmp_path / "mine.py"
    path.write_text(
        "from __future__ import annotations\nimport numpy as np\n"
        "class Mine:\n    def __init__(self, problem, *, gate: np.nosuch = 1): ...\n"
    )
    with pytest.raises(UsageError, match=r"mine\.py:Mine: its parameters cannot be read: AttributeError"):
        parameter_model(back_ends.get(f"{path}:Mine"))


@pytest.mark.parametrize(
    "naming",
    [
        "from {impl} import Mine\n",
        "import functools, {impl}\nMine = functools.partial({impl}.Mine, gate=3)\n",
    ],
    ids=["passed on", "partial"],
)
def test_key_follows_the_users_file_and_the_one_that_defines(tmp_path: Path, naming: str) -> None:
    impl = f"impl_{'partial' if 'partial' in naming else 'plain'}"
    path, other = tmp_path / "mine.py", tmp_path / f"{impl}.py"
    other.write_text(CLASS.format(gate=9))

    def key() -> str:
        return run_key("s", Component("back end", "mine.py:Mine", f"{path}:Mine", {}), 1.0, None)

    path.write_text(naming.format(impl=impl))
    first = key()
    path.write_text(naming.format(impl=impl) + "# changed\n")
    second = key()
    other.write_text(CLASS.format(gate=16) + "# changed\n")
    assert len({first, second, key()}) == 3


def test_registry_whose_import_failed_fails_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "half_package"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "broken.py").write_text("raise ImportError('needs a library')\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    registry = Registry("thing", "half_package")
    for _ in range(2):
        with pytest.raises(ImportError, match="needs a library"):
            registry.names()
    del sys.modules["half_package"]
