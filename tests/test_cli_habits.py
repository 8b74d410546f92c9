"""What holds for every command: --quiet, --json, NO_COLOR; and what the shell completes."""

from __future__ import annotations

import json
import os
import pty
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import typer.main

import slamcmp
from slamcmp.cli import app, completion
from slamcmp.cli.output import TELLING
from tests.command import Command

EXPERIMENT: dict[str, Any] = {
    "name": "e",
    "source": {"name": "circle", "landmarks": 6, "steps": 10},
    "back_ends": ["ekf_slam", "dead_reckoning"],
    "seeds": 2,
}


def commands(group: Any = None, path: str = "") -> Iterator[tuple[str, Any]]:
    """Every command with its whole name."""
    for name, command in (group or typer.main.get_command(app)).commands.items():
        whole = f"{path} {name}".strip()
        if hasattr(command, "commands"):
            yield from commands(command, whole)
        else:
            yield whole, command


ALL = dict(commands())


@pytest.mark.parametrize("name", ALL)
def test_every_command_is_quiet_and_tells_json_on_request(name: str) -> None:
    options = [option for parameter in ALL[name].params for option in parameter.opts]
    assert options.count("--quiet") == 1
    assert options.count("--json") == 1


def test_what_is_asked_for_is_a_command() -> None:
    assert ALL.keys() >= TELLING


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("habits")
    slamcmp.run(EXPERIMENT, folder=place / "results" / "e", executor="serial", progress=False)
    entries = [{"name": name} for name in EXPERIMENT["back_ends"]]
    (place / "e.yaml").write_text(json.dumps({**EXPERIMENT, "back_ends": entries}))
    (place / "t.txt").write_text("0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n2 1 1 0 0 0 0 1\n")
    return place


@pytest.fixture
def call(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    return Command(folder, monkeypatch, capsys)


CALLS = {
    "run": (("e.yaml", "--no-report", "--executor", "serial"), {"folder", "summary", "trials"}),
    "plot": (("e", "--figure", "time", "--format", "svg"), {"files", "skipped"}),
    "table": (("e",), {"output"}),
    "compare": (("e", "e"), {"comparisons", "fails"}),
    "repro": (("e",), {"same", "checked"}),
    "list": (("metrics",), {"metrics"}),
    "schema": ((), {"schema"}),
    "doctor": ((), {"findings"}),
    "stream save": (("e.yaml", "s.npz"), {"file", "digest", "frames"}),
    "stream info": (("s.npz",), {"digest", "sensor", "observations"}),
    "import trajectory": (
        ("t.txt", "--truth", "t.txt", "--as", "A", "--online", "--max-gap", "2", "--replace"), {"imports"}
    ),
    "export": (("e", "--format", "tum", "--output", "all"), {"files", "format"}),
    "assignment reference": ((), {"output"}),
}  # fmt: skip


def test_json_has_stable_keys_and_quiet_says_nothing_beside_the_answer(call: Command) -> None:
    for name, (arguments, keys) in CALLS.items():
        code, out, error = call(*name.split(), *arguments, "--json")
        assert (code, error) == (0, ""), name
        found = json.loads(out)
        assert found.keys() >= keys, name
        assert all(key.replace("-", "_").isidentifier() for key in found), name
        quiet = call(*name.split(), *arguments, "--quiet")
        assert (quiet[0], quiet[2]) == (0, ""), name
        assert bool(quiet[1]) == (name in TELLING), name
    for row in json.loads(call("run", *CALLS["run"][0], "--json", "--quiet")[1])["summary"]:
        assert {"back_end", "runs", "ok", "online_ate"} <= row.keys()
        assert all(key.isidentifier() for key in row)


def test_errors_are_told_however_quiet(call: Command) -> None:
    for option in ("--quiet", "--json"):
        code, out, error = call("report", "nowhere", option)
        assert (code, out) == (3, "")
        assert error.startswith("slamcmp: nowhere: no results here")


@pytest.mark.parametrize("arguments", [["compare", "e", "e"], ["run", "--help"], ["list", "--nothing"]])
def test_no_colour_means_no_escape_codes_even_on_a_terminal(folder: Path, arguments: list[str]) -> None:
    ours, theirs = pty.openpty()
    environment = {**os.environ, "NO_COLOR": "1", "TERM": "xterm-256color"}
    environment.pop("FORCE_COLOR", None)
    program = subprocess.Popen(
        [sys.executable, "-m", "slamcmp", *arguments],
        cwd=folder,
        stdout=theirs,
        stderr=theirs,
        env=environment,
    )
    os.close(theirs)
    text = b""
    # At the end of a terminal Linux says that its other side is gone.
    try:
        while part := os.read(ours, 65536):
            text += part
    except OSError:
        pass
    os.close(ours)
    program.wait(timeout=60)
    assert len(text) > 40
    assert b"\x1b" not in text


def test_the_shell_completes_names(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    assert completion.results_folders("e") == ["e"]
    assert "results/e" in completion.results_folders("results/")
    assert completion.experiments("quick") == ["quickstart"]
    assert completion.experiments("./e") == []
    assert "e.yaml" in completion.experiments("e")
    assert completion.figures("attr") == ["attribution"]
    assert completion.kinds("back") == ["back-ends"]
    assert "online_ate" in completion.metrics("online_a")
    asked = SimpleNamespace(params={"kind": "back-ends"})
    assert completion.plugins(asked, "isa") == ["isam2"]  # type: ignore[arg-type]


def test_the_shell_asks_the_program(folder: Path) -> None:
    """As bash does, through the script that ``--install-completion`` leaves."""
    for words, expected in (
        ("slamcmp compare ", "e"),
        ("slamcmp list back-ends isa", "isam2"),
    ):
        environment = {**os.environ, "_SLAMCMP_COMPLETE": "complete_bash", "COMP_WORDS": words}
        environment["COMP_CWORD"] = str(len(words.split(" ")) - 1)
        program = "import sys; sys.argv = ['slamcmp']; from slamcmp.cli import main; main()"
        done = subprocess.run(
            [sys.executable, "-c", program], cwd=folder, capture_output=True, text=True, env=environment
        )
        assert expected in done.stdout.split(), (words, done.stdout, done.stderr)
