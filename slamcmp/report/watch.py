"""An experiment while it runs, as a local page that refreshes: what is done, what failed, what it says.

The page needs no script; it asks the browser to load it again. Nothing is written into the results folder,
and a run is read once, when its file is there. When the experiment has ended, the page is its report.
"""

from __future__ import annotations

import fcntl
import json
import math
import os
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from statistics import median
from typing import Any

from markupsafe import escape

from slamcmp.report.live import LIGHT
from slamcmp.results.numbers import number_text
from slamcmp.results.runs.run_file import load_run
from slamcmp.support.files.packed_files import names_in

PLANNED = ".progress.json"
"""In a results folder: what the run that writes there has planned (experiment/runner.py)."""
HOSTS = ("127.0.0.1", "localhost")
_STYLE = """
:root { color-scheme: light dark; --back: #fff; --text: #1c1e21; --faint: #5b616a; --line: #d5d9de;
  --bad: #b3261e; }
@media (prefers-color-scheme: dark) { :root { --back: #16181c; --text: #e7e9ec; --faint: #a5abb4;
  --line: #3a3f47; --bad: #ff8a80; } svg circle { filter: brightness(1.5); } }
body { font: 16px/1.5 system-ui, sans-serif; margin: 0 auto; max-width: 60rem; padding: 1.2rem;
  background: var(--back); color: var(--text); }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; width: 100%; }
th, td { text-align: right; padding: .3rem .5rem; border-bottom: 1px solid var(--line); }
th:first-child, td:first-child { text-align: left; overflow-wrap: anywhere; }
progress { width: 100%; height: 1.2rem; } .faint { color: var(--faint); } .bad { color: var(--bad); }
.scroll { overflow-x: auto; } svg { width: 100%; height: auto; }
svg text { fill: var(--faint); font-size: 11px; } svg line { stroke: var(--line); }
"""
_POLICY = "default-src 'none'; style-src 'unsafe-inline'"


@dataclass
class Seen:
    """What has been read of one run."""

    label: str
    status: str
    message: str
    online: float
    final: float


@dataclass
class Watched:
    """A results folder that is looked at again and again.

    Args:
        folder: of the experiment.
    """

    folder: Path
    _seen: dict[str, Seen] = field(default_factory=dict)

    def is_running(self) -> bool:
        """Whether a process holds the folder's lock."""
        try:
            descriptor = os.open(self.folder / ".lock", os.O_RDONLY | os.O_CLOEXEC)
        except OSError:
            return False
        try:
            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except OSError:
            return True
        finally:
            os.close(descriptor)
        return False

    def planned(self) -> Mapping[str, Any]:
        """What the run said it would do; empty where it said nothing."""
        try:
            found = json.loads((self.folder / PLANNED).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return {}
        return found if isinstance(found, dict) else {}

    def runs(self) -> list[Seen]:
        """Every run that has ended; new ones are read, the others remembered."""
        # A result of another experiment may be known by another label.
        wanted = dict(self.planned().get("runs", {}))
        for name in names_in(self.folder / "runs") - self._seen.keys():
            key = name.removesuffix(".npz")
            if name.endswith(".posteriors.npz") or (wanted and key not in wanted):
                continue
            stored = load_run(self.folder / "runs" / name)
            if stored is not None:
                run, scores = stored.run, stored.scores
                errors = (float(scores.get(f"{which}_ate", math.nan)) for which in ("online", "final"))
                label = str(wanted.get(key, run.back_end))
                self._seen[name] = Seen(label, run.status, run.message, *errors)
        return list(self._seen.values())

    def page(self, every_s: float) -> str:
        """The page: the report when the experiment has ended, its progress before."""
        report = self.folder / "report.html"
        if not self.is_running() and report.is_file():
            return report.read_text(encoding="utf-8", errors="replace")
        return progress_page(self, every_s)


def progress_page(watched: Watched, every_s: float) -> str:
    """What is known so far, as HTML without scripts."""
    planned, runs, running = watched.planned(), watched.runs(), watched.is_running()
    total = len(planned.get("runs", ())) or None
    name = str(planned.get("name") or watched.folder.name)
    state = "running" if running else "not running: nobody writes here"
    count = f"{len(runs)} of {total} runs" if total else f"{len(runs)} runs"
    parts = [
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">',
        f'<meta http-equiv="refresh" content="{every_s:g}">',
        f"<title>{escape(name)}: {escape(count)}</title><style>{_STYLE}</style></head><body>",
        f"<h1>{escape(name)}</h1>",
    ]
    if planned.get("question"):
        parts.append(f"<p>{escape(str(planned['question']))}</p>")
    parts.append(f"<p><strong>{escape(count)}</strong> have ended; {escape(state)}.</p>")
    if total:
        parts.append(f'<progress max="{total}" value="{min(len(runs), total)}"></progress>')
    parts += [_table(planned, runs), _dots(planned, runs)]
    bad = [each for each in runs if each.status != "ok"]
    if bad:
        lines = "".join(
            f'<li><span class="bad">{escape(each.status)}</span> {escape(each.label)}: '
            f"{escape(each.message)}</li>"
            for each in bad[-10:]
        )
        parts.append(f"<h2>Failed</h2><ul>{lines}</ul>")
    parts.append(
        '<p class="faint">Medians of what has ended, over all that was swept; who is ahead now need not be '
        f"in the end. The page loads itself again every {every_s:g} s and becomes the report.</p>"
        "</body></html>"
    )
    return "\n".join(parts)


def _labels(planned: Mapping[str, Any], runs: list[Seen]) -> list[str]:
    return list(dict.fromkeys([*map(str, planned.get("labels", ())), *(each.label for each in runs)]))


def _table(planned: Mapping[str, Any], runs: list[Seen]) -> str:
    rows = []
    for label in _labels(planned, runs):
        own = [each for each in runs if each.label == label]
        counts = Counter(each.status == "ok" for each in own)
        cells = [str(escape(label)), str(len(own)), str(counts[True]), str(counts[False])]
        for which in ("online", "final"):
            values = [getattr(each, which) for each in own if each.status == "ok"]
            known = [value for value in values if math.isfinite(value)]
            cells.append(number_text(median(known)) if known else "–")
        rows.append("".join(f"<td>{cell}</td>" for cell in cells))
    heads = ("back end", "ended", "ok", "failed", "online ATE [m]", "final ATE [m]")
    head = "".join(f"<th>{each}</th>" for each in heads)
    body = "".join(f"<tr>{row}</tr>" for row in rows)
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def _dots(planned: Mapping[str, Any], runs: list[Seen]) -> str:
    """Each run's online error on a logarithmic line for its back end."""
    shown = [each for each in runs if each.status == "ok" and math.isfinite(each.online) and each.online > 0]
    if len(shown) < 2:
        return ""
    names = _labels(planned, runs)
    low, high = (f(math.log10(each.online) for each in shown) for f in (min, max))
    low, high = math.floor(low * 2) / 2, math.ceil(high * 2) / 2
    width, left, step = 600.0, 150.0, 26.0
    scale = (width - left - 10.0) / max(high - low, 0.5)
    parts = []
    for place, name in enumerate(names):
        y = 14.0 + step * place
        parts.append(f'<text x="0" y="{y + 4:g}">{escape(name[:22])}</text>')
        parts.append(f'<line x1="{left:g}" x2="{width:g}" y1="{y:g}" y2="{y:g}"/>')
        for each in shown:
            if each.label == name:
                x = left + scale * (math.log10(each.online) - low)
                colour = LIGHT[place % len(LIGHT)]
                parts.append(f'<circle cx="{x:.1f}" cy="{y:g}" r="4" fill="{colour}" fill-opacity="0.6"/>')
    bottom = 14.0 + step * len(names)
    for half in range(round(low * 2), round(high * 2) + 1):
        x = left + scale * (half / 2 - low)
        parts.append(
            f'<text x="{x:.1f}" y="{bottom + 6:g}" text-anchor="middle">{10 ** (half / 2):.2g}</text>'
        )
    height = bottom + 14.0
    return (
        f"<h2>Online ATE of each run [m]</h2>"
        f'<svg viewBox="0 0 {width + 20:g} {height:g}" role="img" aria-label="online error of each run">'
        f"{''.join(parts)}</svg>"
    )


def watch_server(folder: Path, port: int, every_s: float) -> ThreadingHTTPServer:
    """A server of the page on this machine alone; ``serve_forever`` runs it.

    Raises:
        OSError: the port is taken.
    """
    watched = Watched(folder)

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            # Another site's page must not read it through a name that it has pointed here.
            host = (self.headers.get("Host") or "").rpartition(":")[0] or self.headers.get("Host") or ""
            if host not in HOSTS:
                self.send_error(403)
                return
            if self.path.partition("?")[0] not in ("/", "/index.html"):
                self.send_error(404)
                return
            content = watched.page(every_s).encode("utf-8", "replace")
            self.send_response(200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(content)))
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, format: str, *args: Any) -> None:
            """Nobody reads it."""

    return ThreadingHTTPServer(("127.0.0.1", port), Handler)
