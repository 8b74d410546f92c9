"""The page of an experiment that runs: it counts what is there, and becomes the report."""

from __future__ import annotations

import contextlib
import http.client
import re
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

import slamcmp
from slamcmp.experiment.runner import PLANNED as WRITTEN
from slamcmp.report import write_report
from slamcmp.report.watch import PLANNED, Watched, progress_page, watch_server
from slamcmp.support.files.lock import locked
from tests.command import Command


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    experiment = {
        "name": "e",
        "question": "Is <b>this</b> a question?",
        "source": {"name": "circle", "landmarks": 6, "steps": 12},
        "back_ends": [{"name": "ekf_slam", "label": "<EKF>"}, {"name": "isam2"}],
        "seeds": 3,
    }
    folder = tmp_path_factory.mktemp("watch") / "e"
    return slamcmp.run(experiment, folder=folder, executor="serial", progress=False)


@contextlib.contextmanager
def served(folder: Path) -> Iterator[tuple[str, int]]:
    server = watch_server(folder, 0, 2.0)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield "127.0.0.1", server.server_address[1]
    finally:
        server.shutdown()
        server.server_close()


def get(address: tuple[str, int], path: str = "/", **headers: str) -> tuple[int, str]:
    connection = http.client.HTTPConnection(*address, timeout=10)
    connection.request("GET", path, headers=headers)
    response = connection.getresponse()
    return response.status, response.read().decode()


def cells(page: str) -> list[list[str]]:
    body = page.partition("<tbody>")[2].partition("</tbody>")[0]
    return [re.findall(r"<td>(.*?)</td>", row) for row in re.findall(r"<tr>(.*?)</tr>", body)]


def test_it_counts_what_has_ended_with_its_medians(results, tmp_path):
    assert PLANNED == WRITTEN
    page = progress_page(Watched(results.folder), 2.0)
    assert "<strong>6 of 6 runs</strong> have ended; not running" in page
    medians = results.trials.groupby("label", sort=False)["online_ate"].median()
    rows = cells(page)
    assert [row[:4] for row in rows] == [["&lt;EKF&gt;", "3", "3", "0"], ["isam2", "3", "3", "0"]]
    assert [float(row[4]) for row in rows] == pytest.approx(medians.to_list(), rel=6e-3)
    assert rows[0][5] == "–"
    assert page.count("<circle") == 6
    assert 'http-equiv="refresh" content="2"' in page
    assert "Is &lt;b&gt;this&lt;/b&gt; a question?" in page
    assert "<script" not in page


def test_it_grows_and_says_that_somebody_writes(results, tmp_path):
    folder = tmp_path / "e"
    (folder / "runs").mkdir(parents=True)
    (folder / PLANNED).write_bytes((results.folder / PLANNED).read_bytes())
    files = sorted((results.folder / "runs").glob("*.npz"))
    watched = Watched(folder)
    with locked(folder):
        for count, file in enumerate(files[:4], start=1):
            (folder / "runs" / file.name).write_bytes(file.read_bytes())
            assert f"<strong>{count} of 6 runs</strong> have ended; running" in watched.page(2.0)
            assert f'value="{count}"' in watched.page(2.0)
        # Half a file, and one that is not of this experiment.
        (folder / "runs" / files[4].name).write_bytes(files[4].read_bytes()[:100])
        (folder / "runs" / "other.npz").write_bytes(files[5].read_bytes())
        assert "4 of 6 runs" in watched.page(2.0)
    assert "not running" in watched.page(2.0)


def test_in_the_end_it_is_the_report(results):
    report = write_report(results, results.folder / "report.html").read_text()
    try:
        with served(results.folder) as address:
            assert get(address) == (200, report)
            with locked(results.folder):
                assert "have ended; running" in get(address)[1]
            assert get(address, "/../secret")[0] == 404
            assert get(address, "/manifest.json")[0] == 404
            # A name of somebody else's that leads here.
            assert get(address, Host="evil.example")[0] == 403
            assert get(address, Host=f"localhost:{address[1]}")[0] == 200
    finally:
        (results.folder / "report.html").unlink()


class TestTheCommand:
    """``slamcmp watch``."""

    @pytest.fixture
    def call(self, results, monkeypatch, capsys) -> Command:
        return Command(results.folder.parent, monkeypatch, capsys)

    def test_it_prints_the_address_and_ends_with_ctrl_c(self, call, results, monkeypatch):
        import http.server

        def interrupted(_server) -> None:
            raise KeyboardInterrupt

        monkeypatch.setattr(http.server.ThreadingHTTPServer, "serve_forever", interrupted)
        code, out, said = call("watch", str(results.folder), "--no-open")
        assert (code, said) == (130, "")
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/\n", out)

    def test_wrong_inputs_are_one_line(self, call, results):
        code, _, said = call("watch", "nowhere", "--no-open")
        assert (code, said) == (
            3,
            "slamcmp: nowhere: no experiment has begun there; slamcmp run starts one\n",
        )
        with served(results.folder) as (_, port):
            code, _, said = call("watch", str(results.folder), "--port", str(port), "--no-open")
        assert code == 2
        assert said.startswith(f"slamcmp: --port {port}: ")
