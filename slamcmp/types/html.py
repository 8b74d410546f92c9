"""Small tables for notebooks, of text only: whatever runs say in messages is escaped."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape


def facts_html(title: str, facts: Iterable[tuple[str, str]]) -> str:
    """A heading with one fact a line: name and value."""
    rows = "".join(
        f'<tr><th style="text-align:left">{escape(name)}</th>'
        f'<td style="text-align:left">{escape(value)}</td></tr>'
        for name, value in facts
    )
    return f"<div><strong>{escape(title)}</strong><table><tbody>{rows}</tbody></table></div>"


def rows_html(headers: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table with one line of headers."""
    head = "".join(f"<th>{escape(header)}</th>" for header in headers)
    body = "".join(
        "<tr>" + "".join(f'<td style="text-align:left">{escape(cell)}</td>' for cell in row) + "</tr>"
        for row in rows
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
