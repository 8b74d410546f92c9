"""What a wheel holds: the package, and the folder ``experiments`` as ``slamcmp/shipped``, without solutions.

Inside the package the shipped experiments and assignments are found wherever pip puts it (a virtual
environment, ``--user``, ``--target``). Of an assignment a wheel holds what students get and nothing of the
staff's: no hidden test, solution or known mistake. All else is in pyproject.toml.
"""

import re
import tomllib
from pathlib import Path

from setuptools import find_packages, setup
from setuptools.command.build_py import build_py

SHIPPED = "slamcmp.shipped"
KINDS = ["*.yaml", "*.py", "*.md", "*.ipynb"]
FOR_STUDENTS = ["README.md", "starter.py", "public_tests.py", "lab.yaml"]
"""Of an assignment; slamcmp/grading/assignment/handout.py hands out the same."""


def shipped_packages() -> dict[str, str]:
    """Every folder below ``experiments`` by the dotted name it is installed under."""
    folders = {path.parent for kind in KINDS for path in Path("experiments").rglob(kind)}
    # Below an assignment's own folder all is the staff's.
    folders = {folder for folder in folders if not (is_assignment(folder) and len(folder.parts) > 3)}
    return {".".join([SHIPPED, *folder.parts[1:]]): folder.as_posix() for folder in sorted(folders)}


def is_assignment(folder: Path) -> bool:
    """Whether it is one, or inside of one."""
    return folder.parts[:2] == ("experiments", "assignments")


class BuildForStudents(build_py):
    """Modules are packed whatever ``package_data`` says: the staff's are left out here."""

    def find_package_modules(self, package: str, package_dir: str) -> list[tuple[str, str, str]]:
        found = super().find_package_modules(package, package_dir)
        staffs = is_assignment(Path(package_dir))
        return [each for each in found if not staffs or Path(each[2]).name in FOR_STUDENTS]


def long_description() -> str:
    """README.md with absolute links: on an index's page the repository's files are not beside it."""
    project = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8"))["project"]
    text = Path("README.md").read_text(encoding="utf-8")
    home = project["urls"]["Homepage"]
    text = re.sub(r"(!\[[^\]]*\]\()(?![a-z]+:|#)", rf"\1{home}/raw/main/", text)
    return re.sub(r"((?<!!)\[[^\]]*\]\()(?![a-z]+:|#)", rf"\1{home}/blob/main/", text)


shipped = shipped_packages()
setup(
    long_description=long_description(),
    long_description_content_type="text/markdown",
    packages=[*find_packages(include=["slamcmp*"]), *shipped],
    package_dir={"slamcmp": "slamcmp", **shipped},
    package_data={
        "slamcmp": ["py.typed"],
        "slamcmp.advice": ["templates/*"],
        "slamcmp.report": ["templates/*"],
        "slamcmp.grading.results": ["templates/*"],
        "slamcmp.grading.assignment": ["skeleton_files/*"],
        "slamcmp.grading.run": ["bundle_files/*"],
        **{name: FOR_STUDENTS if is_assignment(Path(folder)) else KINDS for name, folder in shipped.items()},
    },
    cmdclass={"build_py": BuildForStudents},
)
