"""What is said of single mistakes that are no known ones: measured whole, in one run, and told in the docs.

``python -m tests.grading.named_causes`` grades every mistake of ``student_slips.yaml`` and
``student_fresh.yaml`` (a quarter of an hour), writes ``named_causes.csv`` and puts its table into
docs/grading.md. With ``--table`` it only writes the table anew.
"""

from __future__ import annotations

import csv
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from slamcmp.support.configuration.yaml_source import load_yaml

HERE = Path(__file__).parent
LISTS = {"first": "student_slips.yaml", "second": "student_fresh.yaml"}
RESULT = HERE / "named_causes.csv"
PAGE = HERE.parents[1] / "docs" / "grading.md"
BEGIN, END = "<!-- named causes: begin -->\n", "<!-- named causes: end -->\n"
COLUMNS = ("list", "number", "assignment", "new", "verdict", "said")
VERDICTS = ("right", "observed", "not named", "wrong")


def mistakes_in(file: str) -> list[dict[str, Any]]:
    """The mistakes of one list."""
    found: list[dict[str, Any]] = load_yaml(HERE / file).data["mistakes"]
    return found


def verdict(mistake: dict[str, Any], causes: list[str]) -> str:
    """What the messages of a submission with this mistake amount to.

    ``right``: every one has one of the words that were fixed with the mistake. ``observed``: what is wrong
    with an output is described, but no cause is named. ``wrong``: a cause is named in other words
    than the fixed ones, so that it has to be read.
    """
    if not causes:
        return "not named"
    if all(any(words in cause for words in mistake["says"]) for cause in causes):
        return "right"
    others = [cause for cause in causes if not any(words in cause for words in mistake["says"])]
    return "wrong" if any(cause.startswith("Your ") for cause in others) else "observed"


def measured() -> Iterator[dict[str, Any]]:
    """Every mistake of both lists with its verdict, one after the other."""
    from tests.grading.test_causes import graded

    for name, file in LISTS.items():
        for number, mistake in enumerate(mistakes_in(file)):
            causes = sorted({cause for test in graded(mistake).tests for cause in test.causes or ()})
            yield {
                "list": name,
                "number": number,
                "assignment": mistake["assignment"],
                "new": mistake["new"],
                "verdict": verdict(mistake, causes),
                "said": " / ".join(causes),
            }


def rows() -> list[dict[str, str]]:
    """The committed result."""
    with RESULT.open(newline="") as file:
        return list(csv.DictReader(file))


def table(result: list[dict[str, str]]) -> str:
    """The result by list and assignment, as Markdown."""
    lines = [
        "| list | assignment | mistakes | named rightly | observed only | not named | in other words |",
        "|---|---|---|---|---|---|---|",
    ]
    for name in LISTS:
        of_list = [row for row in result if row["list"] == name]
        for assignment in [*dict.fromkeys(row["assignment"] for row in of_list), ""]:
            chosen = [row for row in of_list if assignment in ("", row["assignment"])]
            count = Counter(row["verdict"] for row in chosen)
            right, total = count["right"], len(chosen)
            others = " | ".join(str(count[each]) for each in VERDICTS[1:])
            label = f"`{assignment}`" if assignment else "**all**"
            lines.append(f"| {name} | {label} | {total} | {right} ({100 * right / total:.0f} %) | {others} |")
    return "\n".join(lines) + "\n"


def page_with(text: str, page: str) -> str:
    """The page with its table replaced."""
    before, rest = page.split(BEGIN)
    return before + BEGIN + text + END + rest.split(END)[1]


def main() -> None:
    """Measure, keep, and tell."""
    if "--table" not in sys.argv:
        with RESULT.open("w", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            writer.writeheader()
            for row in measured():
                writer.writerow(row)
                file.flush()
                print(row["list"], row["number"], row["verdict"], row["said"], flush=True)
    PAGE.write_text(page_with(table(rows()), PAGE.read_text()))


if __name__ == "__main__":
    main()
