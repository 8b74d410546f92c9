"""What pages of the site cannot hold by hand: shipped experiments, plug-ins, commands.

Each directive writes Markdown and has it parsed as the page itself is, so that headings get into contents.
"""

from __future__ import annotations

import inspect
import re
from pathlib import Path
from typing import Any

import drawn_from_results
from make_figures import IMAGES, MATCHES, STUDY
from sphinx.util.docutils import SphinxDirective

from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.experiment.config.shipped import shipped_experiments
from slamcmp.registry import Plugin, back_ends, figures, front_ends, metrics, sensors, sources

DOCS = Path(__file__).resolve().parent

REGISTRIES = {
    "back-ends": back_ends,
    "sources": sources,
    "front-ends": front_ends,
    "sensors": sensors,
    "metrics": metrics,
    "figures": figures,
}
SHOWN_IN = {
    "association": "association.md",
    "association_shared": "association.md",
    "bearing_only": "real-robots.md",
    "dial": "from-filter-to-smoother.md",
    "filter_vs_smoother": "consistency.md",
    "kitti00_stereo": "vision.md",
    "kitti06": "recorded-images.md",
    "kitti06_defaults": "vision.md",
    "mrclam": "real-robots.md",
    "mrclam_unknown": "without-labels.md",
    "observability": "consistency.md",
    "outliers": "robust.md",
    "plaza": "real-robots.md",
    "quickstart": "tutorials/reading-the-report.md",
    "range_only": "real-robots.md",
    "rendered_room": "vision.md",
    "rendered_room_mono": "vision.md",
    "unknown_association": "without-labels.md",
    "victoria_park_gps": "real-robots.md",
}
"""Shipped experiment: the page that discusses it."""
NOT_RUN = "*Committed results:* none yet; its command is below.\n"
GROUPS = {
    "": "Studies",
    "answer": "Filter or smooth? The whole study",
    "lecture": "The lecture",
    "anchors": "Published tables, beside what is measured here",
}


class _Written(SphinxDirective):
    """A directive whose content is Markdown that it writes."""

    required_arguments = 0
    optional_arguments = 1

    def run(self) -> list[Any]:
        return self.parse_text_to_nodes(self.text(), allow_section_headings=True)

    def text(self) -> str:
        raise NotImplementedError


class Experiments(_Written):
    """Every shipped experiment: its question, what it does, its figures."""

    def text(self) -> str:
        parts = []
        for group, heading in GROUPS.items():
            parts.append(f"## {heading}\n")
            for name, path in shipped_experiments().items():
                if ("/" in name and name.split("/")[0]) == group or (not group and "/" not in name):
                    parts.append(experiment_text(name, path))
        return "\n".join(parts)


def experiment_text(name: str, path: Path) -> str:
    """One experiment as the page has it."""
    experiment = load_experiment(path)
    comment = re.match(r"(?:#.*\n)+", path.read_text(encoding="utf-8"))
    about = " ".join(line.lstrip("# ") for line in comment[0].splitlines()) if comment else ""
    parts = [f"### `{name}`\n", f"**{plain(experiment.question)}**\n", f"{plain(experiment.description)}\n"]
    images = {image: figure for image, (of, figure) in (IMAGES | STUDY).items() if of == name}
    for image, figure in images.items():
        parts.append(f"![{title(figure)}](images/{image})\n")
        parts.append(f"*{title(figure)}.* {plain(figures.get(figure).traits.get('caption', ''))}\n")
    for image, (of, _) in MATCHES.items():
        if of == name:
            parts.append(f"![Matches of two images](images/{image})\n")
    result = drawn_from_results.shown(name)
    if result is not None:
        if not images:
            parts.append(f"{result.html()}\n")
        parts.append(f"*Committed results:* {plain(result.sentence)}\n")
    elif not images and not name.startswith("lecture/problem_"):
        parts.append(NOT_RUN)
    others = [each for each in experiment.figures or () if each not in images.values()]
    if others:
        parts.append("Draws " + ", ".join(f"{title(each).lower()} (`{each}`)" for each in others) + ".\n")
    parts.append(f"{plain(about)}\n")
    parts.append(f"```sh\nslamcmp run {name}\n```\n")
    if name.startswith("lecture/problem_"):
        number = name.split("_")[1]
        (worked,) = (DOCS / "lecture").glob(f"problem-{number}-*.md")
        parts.append(f"![Problem {number}, worked](images/lecture_problem_{number}.png)\n")
        parts.append(f"Worked by hand: [](./lecture/{worked.name}).\n")
    if name in SHOWN_IN:
        parts.append(f"What it shows: [](./{SHOWN_IN[name]}).\n")
    return "\n".join(parts)


class Plugins(_Written):
    """Every plug-in of one kind: ``back-ends``, ``sources``, …"""

    required_arguments = 1

    def text(self) -> str:
        return "\n".join(plugin_text(plugin) for plugin in REGISTRIES[self.arguments[0]])


def plugin_text(plugin: Plugin) -> str:
    """One plug-in with its docstring and parameters."""
    target = plugin.target
    kind = "autoclass" if inspect.isclass(target) else "autofunction"
    return (
        f"## `{plugin.name}`\n\n```{{eval-rst}}\n"
        f".. {kind}:: {target.__module__}.{target.__qualname__}\n   :noindex:\n```\n"
    )


class Commands(_Written):
    """Every command of the command line, from its own help."""

    def text(self) -> str:
        from typer.main import get_command

        from slamcmp.cli import app

        return "\n".join(command_texts(get_command(app), ""))


def command_texts(command: Any, prefix: str) -> list[str]:
    """One command's help, or of a group that of its commands."""
    texts = []
    for name, each in sorted(command.commands.items()):
        full = f"{prefix}{name}"
        if hasattr(each, "commands"):
            texts += command_texts(each, f"{full} ")
            continue
        if each.hidden:
            continue
        texts.append(f"## `slamcmp {full}`\n\n{plain(inspect.cleandoc(each.help or ''))}\n")
        rows = []
        for parameter in each.params:
            help_text = plain(getattr(parameter, "help", None) or "").replace("|", "\\|")
            names = ", ".join(f"`{option}`" for option in parameter.opts)
            if parameter.param_type_name == "argument":
                names = f"`{parameter.metavar or parameter.name.upper()}`"
            rows.append(f"| {names} | {' '.join(help_text.split())} |")
        if rows:
            texts.append("| | |\n|---|---|\n" + "\n".join(rows) + "\n")
        if each.epilog:
            examples = re.sub(r"^Examples?: ", "", each.epilog).replace(" | slamcmp", "\nslamcmp")
            texts.append(f"```sh\n{examples}\n```\n")
    return texts


def title(figure: str) -> str:
    """A figure's own title."""
    return str(figures.get(figure).traits.get("title", figure))


def plain(text: str | None) -> str:
    """Text that Markdown does not read anything into."""
    text = re.sub(r"``?([^`]+)``?", r"`\1`", (text or "").strip())
    pieces = re.split(r"(`[^`]*`)", text)
    return "".join(p if p.startswith("`") else re.sub(r"([*_<>\[\]])", r"\\\1", p) for p in pieces)


def add_to(app: Any) -> None:
    """Make the directives known."""
    app.add_directive("shipped-experiments", Experiments)
    app.add_directive("plug-ins", Plugins)
    app.add_directive("commands", Commands)
