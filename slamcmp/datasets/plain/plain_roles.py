"""What each of the files of a log is: its columns tell, and where two hold poses, their names."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from slamcmp.datasets.plain.column_files import Table, read_table
from slamcmp.datasets.plain.plain_motion import KINDS
from slamcmp.errors import UsageError

Role = Literal["odometry", "detections", "truth", "landmarks"]

ODOMETRY_NAMES, TRUTH_NAMES = (
    ("odo", "wheel", "dead"),
    ("truth", "ground", "gt", "reference", "vicon", "mocap"),
)
"""Parts of names that tell whether poses drift or are true."""


def roles_of(tables: Sequence[Table], *, truth_is_known: bool = False) -> list[Role]:
    """The role of each table of one log.

    A table of poses is the truth, unless its name says that it is odometry, or a truth is there already
    (``truth_is_known``: in another kind of file) and no odometry.
    """
    roles: list[Role | None] = [_by_columns(table) for table in tables]
    for which, parts in (("odometry", ODOMETRY_NAMES), ("truth", TRUTH_NAMES)):
        for k, table in enumerate(tables):
            name = table.path.stem.lower()
            if roles[k] is None and any(part in name for part in parts):
                roles[k] = "odometry" if which == "odometry" else "truth"
    found: list[Role] = []
    for role in roles:
        known = truth_is_known or "truth" in found or "truth" in roles
        found.append(role if role is not None else "odometry" if known else "truth")
    return found


def files_by_role(paths: Sequence[Path]) -> dict[Role, Path]:
    """The files of one log by what they are.

    Raises:
        UsageError: two of one kind.
        DataError: a file that cannot be read.
    """
    texts = [path for path in paths if path.suffix == ".txt"]
    tables = [read_table(path) for path in paths if path.suffix != ".txt"]
    found: dict[Role, Path] = {}
    pairs: list[tuple[Role, Path]] = [("truth", path) for path in texts]
    pairs += zip(roles_of(tables, truth_is_known=bool(texts)), [table.path for table in tables], strict=True)
    for role, path in pairs:
        if role in found:
            raise UsageError(f"{path}: {role} of this log is {found[role]} already")
        found[role] = path
    return found


def _by_columns(table: Table) -> Role | None:
    """None: poses, true or not."""
    timed = "t" in table.columns
    if timed and (table.ids is not None or _is_seen(table)):
        return "detections"
    if table.ids is not None:
        return "landmarks"
    return None if table.has("t", *KINDS["poses"]) else "odometry"


def _is_seen(table: Table) -> bool:
    """Detections of a sensor that names nothing have no column ``id``."""
    return table.has("range") or table.has("bearing") or (table.has("x", "y") and not table.has("theta"))
