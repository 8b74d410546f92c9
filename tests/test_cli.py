"""The command line as a user meets it: exit codes, output, interruption."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import slamcmp
from slamcmp.cli.run import _blocks, print_table
from slamcmp.datasets.graphs.graph_file import graph_file
from slamcmp.frontend.labelled import labelled
from slamcmp.frontend.stream_file import load_stream
from slamcmp.results.store import load_results

PLUGINS = Path(__file__).parent / "user_plugins.py"
ROOT = Path(__file__).parents[1]


def slamcmp_command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "slamcmp", *arguments]


def call(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "200", "NO_COLOR": "1"}
    return subprocess.run(
        slamcmp_command(*arguments), cwd=folder, capture_output=True, text=True, timeout=120, env=environment
    )


def write(folder: Path, back_ends: str, extra: str = "", source: str = "straight") -> Path:
    path = folder / "mine.yaml"
    listed = "".join(f"  - {{name: '{PLUGINS}:{each}'}}\n" for each in back_ends.split())
    path.write_text(f"source: {{name: '{PLUGINS}:{source}'}}\nback_ends:\n{listed}{extra}")
    return path


def test_importing_the_command_line_loads_nothing_heavy() -> None:
    heavy = "{'numpy', 'scipy', 'pandas', 'pyarrow', 'gtsam', 'cv2', 'matplotlib', 'pydantic', 'ruamel'}"
    script = f"import sys, slamcmp.cli; print(sorted({heavy} & set(sys.modules)))"
    answer = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert answer.stdout == "[]\n"


def test_help_is_fast_and_every_command_has_an_example(tmp_path: Path) -> None:
    # Processor time: what the wall clock shows on an idle machine, whatever else runs on this one.
    seconds = []
    for _ in range(3):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        answer = call(tmp_path, "--help")
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        seconds.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
        assert answer.returncode == 0
    assert min(seconds) < 0.3
    import typer.main

    from slamcmp.cli import app

    group = typer.main.get_command(app)
    commands = {**group.commands, **group.commands["stream"].commands}
    assert {"run", "plot", "report", "list", "doctor", "schema", "save", "info"} <= commands.keys()
    for name, command in commands.items():
        assert (command.epilog or "").startswith(("Example: slamcmp ", "Examples: slamcmp ")), name
        assert command.help, name


def test_version_and_usage_errors(tmp_path: Path) -> None:
    answer = call(tmp_path, "--version")
    assert (answer.returncode, answer.stdout) == (0, f"slamcmp {slamcmp.__version__}\n")
    answer = call(tmp_path, "run", "--job", "2", "x.yaml")
    assert answer.returncode == 2
    assert "--job" in answer.stderr


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("run", "/"), 3, "'/' is a folder; the experiment file in it is needed"),
        (("run", "quickstrat"), 3, "there is no experiment file 'quickstrat'; did you mean 'quickstart'?"),
        (("run", "bad.yaml"), 2, "bad.yaml:1:1: unknown key 'sorce'; did you mean 'source'?"),
        (("report", "nothing"), 3, "nothing: no results here (manifest.json is missing)"),
        (("plot", "nothing", "--format", "gif"), 2, "'gif' is not one of png, svg, pdf"),
        (("list", "backends"), 2, "unknown kind 'backends'; did you mean 'back-ends'?"),
        (("list", "back-ends", "isam"), 2, "unknown back end 'isam'; did you mean 'isam2'?"),
        (("stream", "info", "no.npz"), 3, "no.npz: there is no such stream file"),
        (("run", "quickstart", "--executor", "procces"), 2, "did you mean 'processes'?"),
    ],
)
def test_errors_are_one_message_with_an_exit_code(
    tmp_path: Path, arguments: tuple[str, ...], code: int, message: str
) -> None:
    (tmp_path / "bad.yaml").write_text("sorce: 1\nsource: {name: circle}\nback_ends: [{name: ekf_slam}]\n")
    answer = call(tmp_path, *arguments)
    assert answer.returncode == code, answer.stderr
    assert message in answer.stderr
    assert "Traceback" not in answer.stderr
    assert answer.stdout == ""


def test_debug_shows_the_traceback(tmp_path: Path) -> None:
    answer = call(tmp_path, "--debug", "report", "nothing")
    assert "Traceback" in answer.stderr
    assert answer.returncode != 0


def test_run_prints_table_and_paths_and_plain_progress(tmp_path: Path) -> None:
    write(tmp_path, "DeadReckoning Hindsight", "seeds: 2\n")
    answer = call(tmp_path, "run", "mine.yaml", "--jobs", "1")
    assert answer.returncode == 0, answer.stderr
    lines = answer.stderr.splitlines()
    assert len(lines) == 7
    assert lines[6] == (
        "warning: the front end kept no detection in 2 of 2 streams: there, every back end had nothing but "
        "odometry"
    )
    assert lines[0].startswith("[1/6] stream (seed 0): ok (")
    assert f"results: {tmp_path / 'results' / 'mine'}\n" in answer.stdout
    assert "report: results/mine/report.html\n" in answer.stdout
    assert (tmp_path / "results" / "mine" / "report.html").stat().st_size > 1000
    assert [line.split()[-2:] for line in answer.stdout.splitlines() if line.startswith("runs ")] == [
        ["2", "2"]
    ]
    assert call(tmp_path, "plot", "mine", "--figure", "map", "--format", "svg").stdout == (
        "results/mine/figures/map.svg\n"
    )


def test_failed_runs_exit_1_and_json_is_all_there_is(tmp_path: Path) -> None:
    write(tmp_path, "DeadReckoning Raises", "seeds: 2\n")
    answer = call(tmp_path, "run", "mine.yaml", "--json", "--no-report", "--seed", "5", "--results", "out")
    assert answer.returncode == 1
    assert answer.stderr == ""
    told = json.loads(answer.stdout)
    assert told["report"] is None
    assert told["folder"] == str(tmp_path / "out")
    assert [row["status"] for row in told["trials"]] == ["ok", "crashed"]
    assert [row["seed"] for row in told["trials"]] == [5, 5]
    assert told["trials"][0]["final_ate"] is None
    assert told["manifest"]["seeds"] == [5]
    # The same in words, without running anything again.
    answer = call(tmp_path, "run", "mine.yaml", "--no-report", "--seed", "5", "--results", "out")
    assert answer.returncode == 1
    assert "crashed: Raises (trial 0, seed 5): frame 20: ValueError: no such landmark" in answer.stderr


def test_missing_data_exits_3(tmp_path: Path) -> None:
    write(tmp_path, "DeadReckoning", source="sourceless")
    answer = call(tmp_path, "run", "mine.yaml", "--json")
    assert answer.returncode == 3
    assert answer.stderr == "slamcmp: park.txt: there is no such file\n"


def test_dry_run_writes_nothing(tmp_path: Path) -> None:
    write(tmp_path, "DeadReckoning Hindsight", "seeds: 3\n")
    answer = call(tmp_path, "run", "mine.yaml", "--dry-run")
    assert answer.stdout.splitlines()[-1] == (
        "3 trials; to do: 3 streams, 6 runs; reused: 0 runs; results: results/mine"
    )
    assert answer.stdout.splitlines()[0] == "trial 0: seed=0: DeadReckoning, Hindsight"
    write(tmp_path, "DeadReckoning", "seeds: 1\nsweep: {source.sigma_m: [0.5, 1.0]}\n")
    swept = call(tmp_path, "run", "mine.yaml", "--dry-run").stdout.splitlines()
    assert swept[:2] == [
        "trial 0: sigma = 0.5 m, seed=0: DeadReckoning",
        "trial 1: sigma = 1 m, seed=0: DeadReckoning",
    ]
    write(tmp_path, "DeadReckoning Hindsight", "seeds: 3\n")
    told = json.loads(call(tmp_path, "run", "mine.yaml", "--dry-run", "--json").stdout)
    assert (told["trials"], len(told["runs_to_do"])) == (3, 6)
    assert not (tmp_path / "results").exists()


def test_ctrl_c_keeps_what_is_done_and_the_next_run_completes_it(tmp_path: Path) -> None:
    path = write(tmp_path, "DeadReckoning", "seeds: 5\n")
    path.write_text(path.read_text().replace("DeadReckoning'}", "DeadReckoning', pause_s: 0.004}"))
    arguments = slamcmp_command("run", "mine.yaml", "--jobs", "1", "--no-report")
    process = subprocess.Popen(
        arguments,
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        start_new_session=True,
    )
    runs = tmp_path / "results" / "mine" / "runs"
    for _ in range(3000):
        if len(list(runs.glob("*.npz"))) >= 2:
            break
        time.sleep(0.02)
    # As a terminal does it: to the whole process group, workers included.
    os.killpg(process.pid, signal.SIGINT)
    output, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    assert "interrupted: " in errors
    assert "Traceback" not in errors
    interrupted = load_results(tmp_path / "results" / "mine")
    assert 2 <= len(interrupted.trials) < 5
    assert interrupted.manifest["jobs_missing"] > 0
    # What there is, and what is not, in the terminal too.
    assert "DeadReckoning" in output
    missing = 5 - len(interrupted.trials)
    assert f"not complete: {missing} of 5 runs are missing (" in output
    answer = call(tmp_path, "run", "mine.yaml", "--no-report")
    assert answer.returncode == 0
    resumed = load_results(tmp_path / "results" / "mine")
    assert resumed.manifest["jobs_reused"] == len(interrupted.trials)
    call(tmp_path, "run", "mine.yaml", "--no-report", "--results", "fresh")
    fresh = load_results(tmp_path / "fresh")
    for name in ("trials", "frames", "landmarks"):
        tables = [getattr(each, name) for each in (resumed, fresh)]
        measured = ("update", "estimate", "final_s", "peak_memory")
        kept = [column for column in tables[0].columns if not column.startswith(measured)]
        pd.testing.assert_frame_equal(tables[0][kept], tables[1][kept], check_exact=True)


def test_stream_is_saved_with_the_digest_of_the_run(tmp_path: Path) -> None:
    write(tmp_path, "DeadReckoning", "seeds: 2\n")
    saved = call(tmp_path, "stream", "save", "mine.yaml", "s.npz", "--trial", "1")
    assert saved.returncode == 0, saved.stderr
    digest = load_stream(tmp_path / "s.npz").digest
    assert saved.stdout == f"s.npz: 40 frames, digest {digest}\n"
    told = json.loads(call(tmp_path, "run", "mine.yaml", "--json", "--no-report").stdout)
    assert told["trials"][1]["digest"] == digest
    shown = call(tmp_path, "stream", "info", "s.npz").stdout.splitlines()
    assert shown[0] == f"digest       {digest}"
    assert shown[2] == "frames       40, 0 s to 39 s"
    assert shown[3] == "observations 0 of 0 landmarks"
    answer = call(tmp_path, "stream", "save", "mine.yaml", "s.npz", "--trial", "2")
    assert (answer.returncode, answer.stderr) == (
        2,
        "slamcmp: --trial 2: the experiment has trials 0 to 1\n",
    )


def test_a_stream_is_exported_and_read_back(tmp_path: Path) -> None:
    """A stored one and one of an experiment give the same file; from it comes the same stream."""
    (tmp_path / "mine.yaml").write_text(
        "source: {name: victoria_park, steps: 60}\nback_ends: [{name: dead_reckoning}]\n"
    )
    told = call(tmp_path, "stream", "export", "mine.yaml", "one.g2o")
    assert (told.returncode, told.stdout) == (0, "one.g2o: 60 poses, 43 observations (g2o)\n"), told.stderr
    assert call(tmp_path, "stream", "save", "mine.yaml", "s.npz").returncode == 0
    assert call(tmp_path, "stream", "export", "s.npz", "two.g2o", "--format", "g2o").returncode == 0
    assert (tmp_path / "one.g2o").read_text() == (tmp_path / "two.g2o").read_text()
    back = labelled(graph_file(path=str(tmp_path / "one.g2o")), 0, gate_probability=None)
    for ours, theirs in zip(load_stream(tmp_path / "s.npz").frames, back.frames, strict=True):
        order = np.argsort(ours.ids)
        np.testing.assert_array_equal(theirs.ids, ours.ids[order])
        np.testing.assert_allclose(theirs.z, ours.z[order], rtol=1e-12)
        np.testing.assert_allclose(theirs.T_prev_body, ours.T_prev_body, rtol=1e-12, atol=1e-12)
        assert theirs.t == ours.t
    answer = call(tmp_path, "stream", "export", "s.npz", "no/where.g2o")
    assert (answer.returncode, answer.stderr) == (
        1,
        "slamcmp: cannot write no/where.g2o: No such file or directory\n",
    )
    answer = call(tmp_path, "stream", "export", "rendered_room_mono", "room.g2o", "--trial", "999")
    assert answer.returncode == 2


def test_list_names_everything_and_shows_parameters(tmp_path: Path) -> None:
    answer = call(tmp_path, "list")
    assert answer.returncode == 0
    for name in ("sources:", "circle", "ekf_slam", "labelled", "processes", "quickstart", "ate"):
        assert name in answer.stdout
    shown = call(tmp_path, "list", "sources", "circle").stdout
    (line,) = [line for line in shown.splitlines() if line.strip().startswith("range_max_m")]
    assert line.split(maxsplit=1)[1] == "number > 0, default 8.0"
    (line,) = [line for line in shown.splitlines() if line.strip().startswith("turn_deg_s")]
    assert line.split(maxsplit=1)[1] == (
        "number > 0, default 6.0. Turn rate in bends: with the speed it sets their radius."
    )
    shown = call(tmp_path, "list", "experiments", "quickstart").stdout
    assert shown.startswith(f"# {ROOT / 'experiments' / 'quickstart.yaml'}\n")
    assert (ROOT / "experiments" / "quickstart.yaml").read_text() in shown
    unknown = call(tmp_path, "list", "experiments", "foo")
    assert (unknown.returncode, unknown.stdout) == (3, "")
    assert "there is no experiment file 'foo'" in unknown.stderr


def test_doctor_finds_this_machine_well(tmp_path: Path) -> None:
    answer = call(tmp_path, "doctor")
    assert answer.returncode == 0, answer.stdout
    assert all(line.startswith("ok ") for line in answer.stdout.splitlines())
    assert "solves a 3-pose graph" in answer.stdout


def test_schema_is_json(tmp_path: Path) -> None:
    schema = json.loads(call(tmp_path, "schema").stdout)
    # What a file leaves out, the one that it extends may have.
    assert schema["anyOf"] == [{"required": ["source", "back_ends"]}, {"required": ["extends"]}]
    assert schema["additionalProperties"] is False


def test_wide_tables_are_cut_into_blocks_that_fit() -> None:
    keys = [["label", "ekf"]]
    columns = [[name * 8, "1"] for name in "abcd"]
    blocks = _blocks(keys, columns, width=30)
    assert [[column[0][0] for column in block] for block in blocks] == [["l", "a", "b"], ["l", "c", "d"]]


def test_upright_tables_keep_their_headings_in_every_block(capsys: pytest.CaptureFixture[str]) -> None:
    table = pd.DataFrame({"back end": ["a" * 60, "b" * 60, "c" * 60], "runs": [1, 2, 3]})
    print_table(table)
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert lines == [
        ["back", "end", "a" * 60, "b" * 60], ["runs", "1", "2"], ["back", "end", "c" * 60], ["runs", "3"],
    ]  # fmt: skip


def test_lines_left_out_are_told_everywhere(tmp_path: Path) -> None:
    (tmp_path / "my.g2o").write_text("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nWEIRD 1 2\n")
    (tmp_path / "mine.yaml").write_text(
        "source: {name: graph_file, path: my.g2o}\nback_ends: [{name: ekf_slam}]\n"
    )
    told = "my.g2o: left out lines of kinds this reader does not know: 1 x WEIRD (first at line 2)"
    answer = call(tmp_path, "run", "mine.yaml", "--executor", "serial")
    assert f"warning: {told}\n" in answer.stderr
    manifest = json.loads((tmp_path / "results" / "mine" / "manifest.json").read_text())
    assert manifest["warnings"][0] == told
    assert told in (tmp_path / "results" / "mine" / "report.html").read_text()


def test_report_that_cannot_be_written_costs_no_table(tmp_path: Path) -> None:
    write(tmp_path, "DeadReckoning")
    (tmp_path / "out" / "report.html").mkdir(parents=True)
    answer = call(tmp_path, "run", "mine.yaml", "--executor", "serial", "--results", "out")
    assert answer.returncode == 1
    assert "DeadReckoning" in answer.stdout
    assert answer.stderr.splitlines()[-1].startswith("slamcmp: cannot write out/report.html: ")
    told = json.loads(call(tmp_path, "run", "mine.yaml", "--json", "--results", "out").stdout)
    assert (told["report"], len(told["trials"])) == (None, 1)
