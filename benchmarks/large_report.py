"""The page of an experiment with very many runs: seconds, memory and size against their limits.

Two seeds of P1 are run and their rows repeated under new seeds until the frames' table has ten million rows;
then ``slamcmp report`` is timed as a user calls it. Limits: 60 s, 4 GiB, 8 MB.

Run ``python benchmarks/large_report.py`` (two minutes, 1 GB of disk; ``--rows 1000000`` for a tenth,
``--json`` for numbers only); exit code 1: a limit is missed.
"""

from __future__ import annotations

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from slamcmp.results.store import Results, load_results, save_results

LIMITS = {"seconds": 60.0, "GiB": 4.0, "page_MB": 8.0}
EXPERIMENT = Path(__file__).parents[1] / "experiments" / "anchors" / "p1.yaml"


def slamcmp(*words: str) -> None:
    subprocess.run([sys.executable, "-m", "slamcmp", *words], check=True, capture_output=True)


def repeated(results: Results, times: int, folder: Path) -> Results:
    """The runs of two seeds as if they had been those of so many more."""

    def under_new_seeds(table: pd.DataFrame) -> pd.DataFrame:
        moved = [
            table.assign(**{name: table[name] + 2 * k for name in ("trial", "seed") if name in table})
            for k in range(times)
        ]
        return pd.concat(moved, ignore_index=True)

    tables = {name: under_new_seeds(getattr(results, name)) for name in ("trials", "frames", "landmarks")}
    return replace(results, folder=folder, **tables)


def measure(rows: int) -> dict[str, Any]:
    """Seconds and peak memory of ``slamcmp report``, and the size of its page."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        two = folder / "two.yaml"
        two.write_text(f"extends: {EXPERIMENT}\nseeds: 2\n")
        slamcmp("run", str(two), "--no-report", "--no-cache", "--results", str(folder / "two"))
        small = load_results(folder / "two")
        (folder / "many").mkdir()
        many = repeated(small, -(-rows // len(small.frames)), folder / "many")
        save_results(many)
        count = len(many.frames)
        del many, small
        start = time.perf_counter()
        slamcmp("report", str(folder / "many"))
        seconds = time.perf_counter() - start
        # Of all children the largest: making the two seeds' runs takes a tenth of it. Kilobytes on Linux.
        peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
        page = (folder / "many" / "report.html").stat().st_size
    return {"rows": count, "seconds": seconds, "GiB": peak / 2**20, "page_MB": page / 1e6, "limits": LIMITS}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--rows", type=int, default=10_000_000)
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    arguments = parser.parse_args()
    found = measure(arguments.rows)
    missed = [name for name, limit in LIMITS.items() if found[name] > limit]
    if arguments.json:
        print(json.dumps(found))
    else:
        print(f"{found['rows']:.0f} rows of frames")
        for name, limit in LIMITS.items():
            print(f"{name:8} {found[name]:8.2f}, at most {limit:g}")
    if missed:
        sys.exit(f"missed: {', '.join(missed)}")


if __name__ == "__main__":
    main()
