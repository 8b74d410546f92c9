"""What the attack files say about themselves, and the table of them in docs/grading-security.md.

``python -m tests.grading.catalogue`` writes the table anew.
"""

from __future__ import annotations

import ast
import re
from dataclasses import dataclass
from pathlib import Path

FOLDER = Path(__file__).parent / "attacks"
DOCUMENT = Path(__file__).parents[2] / "docs" / "grading-security.md"
BEGIN, END = "<!-- attacks: begin -->", "<!-- attacks: end -->"


@dataclass(frozen=True)
class Attack:
    """One file of the suite."""

    name: str
    kind: str
    wins_if: str
    defence: str
    control: bool
    """Whether it must win when every layer is switched off."""
    deadline_s: float | None

    @property
    def path(self) -> Path:
        return FOLDER / f"{self.name}.py"


def attacks() -> list[Attack]:
    """Every attack, sorted by kind and name."""
    found = [_read(path) for path in FOLDER.glob("*.py")]
    return sorted(found, key=lambda attack: (attack.kind, attack.name))


def table() -> str:
    """The attacks as a Markdown table."""
    rows = ["| kind | attack | wins if | defence |", "|---|---|---|---|"]
    rows += [f"| {a.kind} | `{a.name}` | {a.wins_if} | {a.defence} |" for a in attacks()]
    return "\n".join(rows)


def documented() -> str:
    """The table that stands in the document."""
    return DOCUMENT.read_text().split(BEGIN)[1].split(END)[0].strip()


def _read(path: Path) -> Attack:
    text = ast.get_docstring(ast.parse(path.read_text())) or ""
    fields = dict(re.findall(r"^(Kind|Wins if|Defence|Control|Deadline):? (.*?)\.?$", text, flags=re.M))
    return Attack(
        name=path.stem,
        kind=fields["Kind"],
        wins_if=fields["Wins if"],
        defence=fields["Defence"],
        control="Control" in fields,
        deadline_s=float(fields["Deadline"].split()[0]) if "Deadline" in fields else None,
    )


if __name__ == "__main__":
    document = DOCUMENT.read_text()
    head, rest = document.split(BEGIN)
    DOCUMENT.write_text(f"{head}{BEGIN}\n{table()}\n{END}{rest.split(END)[1]}")
