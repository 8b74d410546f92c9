"""A damaged file in a results folder is a result to compute again, whichever byte was changed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from slamcmp.experiment.runner import run_experiment
from slamcmp.results.runs.run_file import load_run, load_truth

Write = Callable[..., Path]


def test_every_changed_byte_reads_as_no_result_or_as_the_result(
    write_experiment: Write, tmp_path: Path
) -> None:
    folder = tmp_path / "r"
    first = run_experiment(write_experiment(back_ends=["Hindsight"]), folder=folder, executor="serial")
    (run,) = (folder / "runs").iterdir()
    (truth,) = (folder / "streams").glob("*.truth.npz")
    rng = np.random.default_rng(0)
    for path, load in ((run, load_run), (truth, load_truth)):
        content = path.read_bytes()
        # All of the central directory (flags and compression types), a sample of the rest.
        places = {*range(len(content) - 600, len(content)), *rng.integers(0, len(content), 200).tolist()}
        lost = 0
        for place in places:
            spoilt = bytearray(content)
            spoilt[place] ^= 0xFF
            path.write_bytes(spoilt)
            lost += load(path) is None
            if path is run:
                assert load(path) is None or load(path).run.status == "ok"
        assert lost > 100
        path.write_bytes(content)
    # A payload whose checksum is wrong: the header still says ok.
    content = run.read_bytes()
    place = content.index(b"online_T.npy") + 400
    run.write_bytes(content[:place] + bytes([content[place] ^ 0xFF]) + content[place + 1 :])
    again = run_experiment(write_experiment(back_ends=["Hindsight"]), folder=folder, executor="serial")
    assert again.manifest["jobs_run"] == 1
    assert again.trials["online_ate"][0] == first.trials["online_ate"][0]
