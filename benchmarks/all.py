"""Every benchmark, one after the other, as one table of ratios with the machine and the versions.

A benchmark that fails or misses a limit is a row that says so, and the others go on. Written to
``benchmarks/results/latest.json`` and ``latest.md``. With ``--check`` the ratios are compared with those that
are committed (``results/reference.json``): one that is more than 15 % larger fails. ``--keep`` makes what was
just measured the reference. Ratios are taken within one run, so machines may differ; a reference from another
machine is told as such.

Run ``python benchmarks/all.py`` (a quarter of an hour; ``--only ekf postponed`` for some); exit code 1: a
limit or a comparison was missed, or a benchmark failed.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import json
import os
import platform
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
RESULTS = HERE / "results"
SLACK = 0.15
"""How much larger than the committed one a ratio may be."""
LIBRARIES = ("slamcmp", "numpy", "scipy", "gtsam", "numba", "opencv-python-headless")


@dataclass(frozen=True)
class Row:
    """One ratio, the smaller the better."""

    benchmark: str
    what: str
    ratio: float | None
    limit: float | None = None
    fault: str = ""

    @property
    def name(self) -> str:
        return f"{self.benchmark}: {self.what}"

    @property
    def missed(self) -> bool:
        return self.ratio is not None and self.limit is not None and self.ratio > self.limit


def of_ekf(found: Any) -> list[tuple[str, float, float | None]]:
    return [
        (f"N={row['landmarks']} against {row['against']}", row["ratio"], row["target"])
        for row in found
        if row["ratio"] == row["ratio"] and (row["against"], row["landmarks"]) != ("dsyrk", 50)
    ]


def of_postponed(found: Any) -> list[tuple[str, float, float | None]]:
    return [(f"{row['active_landmarks']} active", row["ratio"], row["target"]) for row in found]


def of_endurance(found: Any) -> list[tuple[str, float, float | None]]:
    """What a frame costs when the run is twice as long, of those that promise a bound."""
    return [
        (f"{name}: a run twice as long", 2.0 ** each["exponent"], found["limit"])
        for name, each in found["back_ends"].items()
        if each["bounded"]
    ]


def of_monte_carlo(found: Any) -> list[tuple[str, float, float | None]]:
    plain, *others = found
    return [(row["way"], 1.0 / row["times_faster"], 0.2) for row in others if row is not plain]


def of_isam2(found: Any) -> list[tuple[str, float, float | None]]:
    limit = found["target"]
    return [
        (f"{stream}, {work}", numbers[f"{work}_ratio_total"], limit)
        for stream, numbers in found["results"].items()
        for work in ("update", "with_covariance")
    ]


def of_front_end(found: Any) -> list[tuple[str, float, float | None]]:
    limits = {"ratio_same_job": 1.4, "tracking_ratio_same_job": 1.4, "suppression_ratio": 0.1}
    return [(name, found[name], limit) for name, limit in limits.items()]


def of_runner(found: Any) -> list[tuple[str, float, float | None]]:
    return [
        ("loop over the bare calls", 1.0 + found["overhead"], 1.05),
        ("two workers over serial", found["two_workers"], 0.6),
    ]


def of_trials(found: Any) -> list[tuple[str, float, float | None]]:
    p1 = found["p1"]
    return [
        ("P1 over its bare filters", p1["ratio"], 2.5),
        ("a run beside its filter, of 0.1 s", p1["beside_s_a_run"] / 0.1, 1.0),
        ("a stream, of 0.1 s", p1["stream_s"] / 0.1, 1.0),
    ]


def of_ensemble(found: Any) -> list[tuple[str, float, float | None]]:
    # On two cores a run may cost 1 / 1.8 of what it costs on one; with others there is no limit stated.
    limit = 1 / 1.8 if found["cores"] == 2 else None
    return [
        (f"{label}, all cores over one", row["all_cores_over_one"], limit)
        for label, row in found["filters"].items()
    ]


def of_levels(found: Any) -> list[tuple[str, float, float | None]]:
    return [
        (f"{drive}, {levels.removeprefix('levels_')} levels over one", row["time_ratio"], None)
        for drive, each in found.items()
        for levels, row in each.items()
    ]


def of_large_report(found: Any) -> list[tuple[str, float, float | None]]:
    return [(f"{name}, of {most:g}", found[name] / most, 1.0) for name, most in found["limits"].items()]


def of_peers(found: Any) -> list[tuple[str, float, float | None]]:
    return [
        (f"N={row['landmarks']} against {row['peer']}", row["ratio"], None) for row in found if row["ratio"]
    ]


Reader = Callable[[Any], Sequence[tuple[str, float, float | None]]]
BENCHMARKS: dict[str, tuple[tuple[str, ...], Reader | None]] = {
    "ekf": (("ekf.py", "--json"), of_ekf),
    "ekf without numba": (("ekf.py", "--plain", "--json"), of_ekf),
    "postponed": (("postponed.py", "--json"), of_postponed),
    "endurance": (("endurance.py", "--frames", "20000", "--landmarks", "1000", "--json"), of_endurance),
    "monte_carlo": (("monte_carlo.py", "--runs", "10", "--json"), of_monte_carlo),
    "isam2": (("isam2.py", "--json"), of_isam2),
    "front_end": (("front_end.py", "--json"), of_front_end),
    "levels": (("levels.py",), of_levels),
    "runner": (("runner.py", "--json"), of_runner),
    "trials": (("trials.py", "--json"), of_trials),
    "ensemble": (("ensemble.py", "--runs", "100", "--json"), of_ensemble),
    "large_report": (("large_report.py", "--json"), of_large_report),
    "sandbox": (("sandbox.py",), None),
    "peers": (("peers.py", "--json"), of_peers),
}
NOT_EVERYWHERE = {"peers"}
"""Measure what happens to be installed: a row that is gone is no fault."""


def run(name: str, words: Sequence[str], reader: Reader | None) -> list[Row]:
    """The rows of one benchmark; whatever goes wrong in it is one of them."""
    done = subprocess.run([sys.executable, str(HERE / words[0]), *words[1:]], capture_output=True, text=True)
    if reader is None:
        return [Row(name, "its own limits", None, fault="" if done.returncode == 0 else last_line(done))]
    try:
        return [
            Row(name, what, float(ratio), limit) for what, ratio, limit in reader(json.loads(done.stdout))
        ]
    except (ValueError, KeyError, TypeError) as error:
        return [Row(name, "", None, fault=f"exit code {done.returncode}, {last_line(done) or repr(error)}")]


def last_line(done: subprocess.CompletedProcess[str]) -> str:
    lines = (done.stderr.strip() or done.stdout.strip()).splitlines()
    return lines[-1] if lines else ""


def machine() -> dict[str, Any]:
    """What the numbers come from."""
    model = platform.processor() or platform.machine()
    cpu = Path("/proc/cpuinfo")
    if cpu.exists():
        names = [
            line.split(":", 1)[1].strip() for line in cpu.read_text().splitlines() if "model name" in line
        ]
        model = names[0] if names else model
    versions = {"python": platform.python_version()}
    for name in LIBRARIES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = "absent"
    load = os.getloadavg() if hasattr(os, "getloadavg") else (float("nan"),) * 3
    return {
        "processor": model,
        "cores": os.cpu_count(),
        "system": platform.platform(),
        "load": load,
        **versions,
    }


def compared(rows: Sequence[Row], reference: dict[str, float]) -> list[str]:
    """What is more than ``SLACK`` worse than the reference, or gone from it."""
    worse = [
        f"{row.name}: {row.ratio:.3f}, committed {reference[row.name]:.3f} (at most +{SLACK:.0%})"
        for row in rows
        if row.ratio is not None and row.name in reference and row.ratio > (1 + SLACK) * reference[row.name]
    ]
    measured = {row.name for row in rows}
    ran = {row.benchmark for row in rows} - NOT_EVERYWHERE
    gone = [name for name in reference if name.split(": ")[0] in ran and name not in measured]
    return worse + [f"{name}: committed, and not measured now" for name in gone]


def table(rows: Sequence[Row], about: dict[str, Any]) -> str:
    """Markdown."""
    lines = [f"* {key}: {value}" for key, value in about.items()]
    lines += ["", "| benchmark | what | ratio | at most | |", "|---|---|---|---|---|"]
    for row in rows:
        ratio = "–" if row.ratio is None else f"{row.ratio:.3f}"
        limit = "" if row.limit is None else f"{row.limit:g}"
        said = row.fault or ("missed" if row.missed else "")
        lines.append(f"| {row.benchmark} | {row.what} | {ratio} | {limit} | {said.replace('|', '/')} |")
    return "\n".join(lines) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=list(BENCHMARKS), default=list(BENCHMARKS))
    parser.add_argument("--check", action="store_true", help="compare with the committed ratios")
    parser.add_argument("--keep", action="store_true", help="make what is measured the reference")
    parser.add_argument("--results", type=Path, default=RESULTS, help="where the table goes")
    options = parser.parse_args()
    rows: list[Row] = []
    about = machine()
    for name in options.only:
        print(f"{name} …", file=sys.stderr, flush=True)
        rows += run(name, *BENCHMARKS[name])
    options.results.mkdir(exist_ok=True, parents=True)
    content = {"machine": about, "rows": [asdict(row) for row in rows]}
    (options.results / "latest.json").write_text(json.dumps(content, indent=1) + "\n")
    (options.results / "latest.md").write_text(table(rows, about))
    print(table(rows, about))
    wrong = [f"{row.name}: {row.fault}" for row in rows if row.fault]
    wrong += [f"{row.name}: {row.ratio:.3f}, over its limit of {row.limit:g}" for row in rows if row.missed]
    kept = options.results / "reference.json"
    if options.check:
        if not kept.exists():
            wrong.append(f"there is no {kept} to compare with: --keep makes one")
        else:
            reference = json.loads(kept.read_text())
            if reference["machine"]["processor"] != about["processor"]:
                print(f"the reference is from another machine: {reference['machine']['processor']}")
            ratios = {Row(**row).name: row["ratio"] for row in reference["rows"] if row["ratio"] is not None}
            wrong = [f"{row.name}: {row.fault}" for row in rows if row.fault] + compared(rows, ratios)
    if options.keep:
        kept.write_text(json.dumps(content, indent=1) + "\n")
    for line in wrong:
        print(line, file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
