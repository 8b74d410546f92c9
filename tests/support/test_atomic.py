"""Every file that results consist of is replaced as a whole, and a failure is one clear error."""

from __future__ import annotations

from pathlib import Path

import pytest

from slamcmp.errors import StorageError
from slamcmp.experiment.runner import run_experiment
from slamcmp.frontend.stream_file import load_stream, save_stream
from slamcmp.report import draw_figures, write_report
from slamcmp.support.files.atomic import write_atomically
from tests.conftest import PLUGINS


def test_old_file_outlives_a_write_that_fails(tmp_path: Path) -> None:
    path = tmp_path / "sub" / "file"
    write_atomically(path, lambda file: file.write(b"old"))

    def full(file) -> None:
        file.write(b"new")
        raise OSError(28, "No space left on device")

    with pytest.raises(StorageError, match=r"cannot write .*/sub/file: No space left on device"):
        write_atomically(path, full)
    assert path.read_bytes() == b"old"
    assert list(path.parent.iterdir()) == [path]


def test_reports_figures_and_streams_are_written_by_it(tmp_path: Path) -> None:
    config = tmp_path / "e.yaml"
    config.write_text(
        f"source: {{name: '{PLUGINS}:straight'}}\nback_ends: [{{name: '{PLUGINS}:DeadReckoning'}}]\n"
    )
    results = run_experiment(config, folder=tmp_path / "r", executor="serial")
    (stream,) = [
        load_stream(each)
        for each in (tmp_path / "r" / "streams").iterdir()
        if not each.name.endswith("truth.npz")
    ]
    (tmp_path / "file").write_text("not a folder")
    below = tmp_path / "file" / "x"
    for write in (
        lambda: write_report(results, below / "report.html"),
        lambda: draw_figures(results, ["map"], below),
        lambda: save_stream(stream, below / "s.npz"),
    ):
        with pytest.raises(StorageError, match=r"cannot write .*/file/x/.*: Not a directory"):
            write()
