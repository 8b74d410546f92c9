"""The zip that Gradescope asks for: one upload, and every submission of an assignment is graded.

The same folder, set up in a container image, serves PrairieLearn.
"""

from __future__ import annotations

import importlib.metadata
import io
import json
import stat
import zipfile
from collections.abc import Iterator
from pathlib import Path

import slamcmp
from slamcmp.errors import MissingDataError, UsageError
from slamcmp.grading.hand_in.hand_in import Collector
from slamcmp.support.files.atomic import write_atomically
from slamcmp.support.files.shipped_files import shipped_folder

PACKAGE = Path(slamcmp.__file__).parent
FILES = Path(__file__).parent / "bundle_files"
TIME_LIMIT_S = 540.0
"""Less than the ten minutes after which Gradescope ends a container and gives 0."""
_EPOCH = (1980, 1, 1, 0, 0, 0)
"""The oldest time a zip can hold: equal content, equal bundle."""


def write_bundle(
    assignment: Path,
    path: Path,
    *,
    secret: bytes,
    accept_weak_sandbox: bool = False,
    time_limit_s: float = TIME_LIMIT_S,
) -> Path:
    """Write the autograder zip of an assignment folder to ``path``.

    It holds the secret and the solution: it is for the platform and the staff.

    Raises:
        MissingDataError: there is no such assignment.
        UsageError: slamcmp is not installed, so that its requirements are unknown.
        StorageError: the file cannot be written.
    """
    if not assignment.is_dir():
        raise MissingDataError(f"there is no assignment folder {assignment}")
    settings = {
        "assignment": assignment.name,
        "time_limit_s": time_limit_s,
        "accept_weak_sandbox": accept_weak_sandbox,
    }
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for script in sorted(FILES.iterdir()):
            if script.is_file():
                _add(archive, script.name, script.read_bytes(), 0o700)
        _add(archive, "settings.json", json.dumps(settings, indent=1).encode(), 0o600)
        _add(archive, "secret", secret, 0o600)
        name, text = _metadata()
        _add(archive, f"package/{name}", text.encode(), 0o600)
        _add(archive, "requirements.txt", "".join(f"{line}\n" for line in requirements()).encode(), 0o600)
        _add(archive, "constraints.txt", constraints().encode(), 0o600)
        for folder, into in ((PACKAGE, "package/slamcmp"), (assignment, f"assignments/{assignment.name}")):
            for file in _files(folder):
                name = f"{into}/{file.relative_to(folder).as_posix()}"
                _add(archive, name, file.read_bytes(), 0o600)
    write_atomically(path, lambda file: file.write(buffer.getvalue()))
    path.chmod(0o600)
    return path


def requirements() -> list[str]:
    """What slamcmp needs, as its installation says."""
    return [line for line in importlib.metadata.requires("slamcmp") or [] if "extra ==" not in line]


def constraints() -> str:
    """The pinned versions: those slamcmp is tested with, without a checkout those installed here."""
    tested = PACKAGE.parent / "constraints.txt"
    if tested.is_file():
        return tested.read_text()
    found = {each.metadata["Name"]: each.version for each in importlib.metadata.distributions()}
    return "".join(f"{name}=={version}\n" for name, version in sorted(found.items()) if name != "slamcmp")


def _metadata() -> tuple[str, str]:
    """The folder and the text by which Python knows an installed package."""
    try:
        installed = importlib.metadata.distribution("slamcmp")
    except importlib.metadata.PackageNotFoundError as error:
        raise UsageError("slamcmp is not installed: pip install slamcmp, then make the bundle") from error
    text = installed.read_text("METADATA") or installed.read_text("PKG-INFO") or ""
    return f"slamcmp-{installed.version}.dist-info/METADATA", text


def _files(folder: Path) -> Iterator[Path]:
    # An installation holds all shipped assignments inside the package; this bundle is for one.
    others = shipped_folder() if folder == PACKAGE else None
    for path in sorted(folder.rglob("*")):
        if others is not None and path.is_relative_to(others):
            continue
        if path.is_file() and not Collector.is_junk(path.relative_to(folder).as_posix()):
            yield path


def _add(archive: zipfile.ZipFile, name: str, content: bytes, mode: int) -> None:
    entry = zipfile.ZipInfo(name, _EPOCH)
    entry.external_attr = (stat.S_IFREG | mode) << 16
    entry.compress_type = zipfile.ZIP_DEFLATED
    archive.writestr(entry, content)
