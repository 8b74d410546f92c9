"""``slamcmp data fetch`` and its catalogue on the command line."""

from __future__ import annotations

import contextlib
import io
import json
import signal
import subprocess
import sys
import time

import pytest

from slamcmp.cli import app
from slamcmp.errors import UsageError
from slamcmp.registry import Plugin, data_sets, in_session
from tests.datasets.fetching.servers import Mirror, http_mirror
from tests.datasets.fetching.toys import BYTES, everything, toy


def said(capsys, *words: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as ended:
        app(["data", *words])
    told = capsys.readouterr()
    return ended.value.code, told.out, told.err


def test_the_licence_is_shown_and_accepted_first(tmp_path, capsys, monkeypatch):
    with http_mirror(Mirror({"toy.zip": BYTES})) as mirror:
        data_set = toy(mirror.url)
        with in_session({"toy": Plugin("toy", lambda: data_set)}):
            with pytest.raises(
                UsageError, match="toy: its licence is not accepted, so nothing was downloaded"
            ):
                app(["data", "fetch", "toy", "--to", str(tmp_path)], standalone_mode=False)
            assert "licence:  for toys only" in capsys.readouterr().out
            monkeypatch.setattr(
                "sys.stdin", type("Terminal", (io.StringIO,), {"isatty": lambda self: True})("n\n")
            )
            with pytest.raises(UsageError, match="not accepted"):
                app(["data", "fetch", "toy", "--to", str(tmp_path)], standalone_mode=False)
            assert mirror.asked == []
            assert everything(tmp_path) == []
            code, out, _ = said(capsys, "fetch", "toy", "--to", str(tmp_path), "--accept-licence")
            assert code == 0
            assert out.endswith(f"toy: in {tmp_path / 'toys/Toy_Set'}\n")
            assert said(capsys, "verify", "toy", "--to", str(tmp_path))[0] == 0
            (tmp_path / "toys/Toy_Set/a.txt").write_bytes(b"")
            code, out, _ = said(capsys, "verify", "toy", "--to", str(tmp_path), "--json")
            assert code == 1
            assert "has changed" in json.loads(out)[0]["wrong"][0]
    monkeypatch.delenv("SLAMCMP_DATA", raising=False)
    with pytest.raises(
        UsageError, match="set SLAMCMP_DATA to the folder of all data sets, or give --to FOLDER"
    ):
        app(["data", "fetch", "mrclam6"], standalone_mode=False)
    with pytest.raises(UsageError, match="unknown data set 'mrclam'; did you mean 'mrclam"):
        app(["data", "info", "mrclam"], standalone_mode=False)


def test_ctrl_c_leaves_a_part_to_go_on_from(tmp_path):
    slow = (
        "import sys, time\n"
        "from slamcmp.datasets.fetching import download\n"
        "write = download._Transfer._write\n"
        "def slowly(self, chunks, start, total):\n"
        "    def each():\n"
        "        for chunk in chunks:\n"
        "            for k in range(0, len(chunk), 1000):\n"
        "                yield chunk[k:k + 1000]\n"
        "                time.sleep(0.02)\n"
        "    write(self, each(), start, total)\n"
        "download._Transfer._write = slowly\n"
        "from slamcmp.cli import main\n"
        "main()\n"
    )
    with http_mirror(Mirror({"MRCLAM6.zip": BYTES})) as mirror:
        command = [sys.executable, "-c", slow, "data", "fetch", "mrclam6", "--accept-licence"]
        process = subprocess.Popen(
            [*command, "--to", str(tmp_path), "--from", mirror.url],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        part = tmp_path / ".downloads/mrclam6/MRCLAM6.zip.part"
        deadline = time.monotonic() + 30
        while not (part.is_file() and part.stat().st_size) and time.monotonic() < deadline:
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        _, told = process.communicate(timeout=30)
    assert process.returncode == 130
    assert told == "slamcmp: interrupted; what came is kept, the same command goes on from there\n"
    assert BYTES.startswith(part.read_bytes())
    assert 0 < part.stat().st_size < len(BYTES)
    assert not list(tmp_path.glob(".unpacking-*"))


def test_the_catalogue_says_what_is_known_and_no_more(capsys):
    code, out, _ = said(capsys, "list", "--json")
    listed = {each["name"]: each for each in json.loads(out)}
    assert code == 0
    assert {f"mrclam{k}" for k in range(1, 10)} | {
        "victoria_park",
        "victoria_park_wheel",
        "plaza1",
        "plaza2",
    } <= set(listed)
    assert {"dlr", "mrpt_kf_slam", "slsjf_8240", "g2o_m3500", "kitti_odometry"} <= set(listed)
    for name, each in listed.items():
        assert all(each[key] for key in ("title", "licence", "citation", "size", "page")), name
        assert each["page"].startswith("http")
    for plugin in data_sets:
        entry = plugin.target()
        assert entry.name == plugin.name
        assert entry.archives or entry.how or entry.in_wheel
        # Every name can be typed in every shell without quotes.
        assert entry.name.isidentifier()
    code, out, _ = said(capsys, "info", "mrclam6")
    assert "sha256 not known to slamcmp" in out
    assert "ftp://asrl3.utias.utoronto.ca/MRCLAM/MRCLAM6.zip" in out


def test_what_the_wheel_carries_has_the_checksums_that_are_stated(capsys):
    code, out, _ = said(capsys, "verify", "plaza1", "plaza2", "victoria_park_wheel")
    assert code == 0
    assert out.count("by the checksums slamcmp knows") == 3


def test_the_sources_that_entries_name_take_what_they_say():
    from ruamel.yaml import YAML

    from slamcmp.registry import sources

    for plugin in data_sets:
        entry = plugin.target()
        if entry.use:
            told = YAML(typ="safe").load(entry.use)
            assert set(told) - {"name"} <= set(sources.get(told["name"]).parameters()), entry.name


def test_names_are_completed():
    from slamcmp.cli.data.data_sets import _names

    assert _names("plaza") == ["plaza1", "plaza2"]
    with contextlib.suppress(SystemExit):
        app(["data", "--help"])
