"""What a wheel holds: the package, and the folder ``experiments`` as ``slamcmp/shipped``.

Inside the package the shipped experiments and assignments are found wherever pip puts it (a virtual
environment, ``--user``, ``--target``). All else is in pyproject.toml.
"""

from pathlib import Path

from setuptools import find_packages, setup

SHIPPED = "slamcmp.shipped"
KINDS = ["*.yaml", "*.py", "*.md", "*.ipynb"]


def shipped_packages() -> dict[str, str]:
    """Every folder below ``experiments`` by the dotted name it is installed under."""
    folders = {path.parent for kind in KINDS for path in Path("experiments").rglob(kind)}
    return {".".join([SHIPPED, *folder.parts[1:]]): folder.as_posix() for folder in sorted(folders)}


shipped = shipped_packages()
setup(
    packages=[*find_packages(include=["slamcmp*"]), *shipped],
    package_dir={"slamcmp": "slamcmp", **shipped},
    package_data={
        "slamcmp": ["py.typed"],
        "slamcmp.report": ["templates/*"],
        "slamcmp.grading.results": ["templates/*"],
        "slamcmp.grading.run": ["bundle_files/*"],
        **dict.fromkeys(shipped, KINDS),
    },
)
