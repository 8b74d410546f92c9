"""No input makes a traceback: one clear line, with its place, and exit code 2."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from slamcmp.errors import SlamcmpError, UsageError
from slamcmp.experiment.config.experiment import load_experiment, parse_experiment
from slamcmp.experiment.gathering.manifest import require_same_experiment
from slamcmp.experiment.runner import run_experiment
from slamcmp.support.configuration.code_source import CodeSource
from slamcmp.support.configuration.yaml_source import YamlSource
from slamcmp.support.messages import LIMIT

GOOD = "source: {name: circle, steps: 5}\nback_ends: [{name: ekf_slam}]\n"
COUNTS = ("landmarks", "map_seed", "first_look", "process_substeps")
BOMB = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]\n" for n in range(1, 9)
)
BAD = {
    "an empty source": ("source: {}\nback_ends: [{name: ekf_slam}]\n", r"e\.yaml:1:9: .*'name' is missing"),
    "an empty front end": (GOOD + "front_end: {}\n", r"e\.yaml:3:12: .*'name' is missing"),
    "an empty back end": (
        "source: {name: circle}\nback_ends: [{}, {name: ekf_slam}]\n",
        r"e\.yaml:2:\d+: .*'name' is missing",
    ),
    "a million million seeds": (GOOD + "seeds: 1000000000000\n", r"e\.yaml:3:8: seeds: .*100000"),
    "seeds of 5000 digits": (GOOD + f"seeds: {'9' * 5000}\n", r"e\.yaml"),
    "a seed of 5000 digits": (GOOD + f"seeds: [1, {'9' * 5000}]\n", r"e\.yaml"),
    "seeds of 4000 digits": (GOOD + f"seeds: {'9' * 4000}\n", r"e\.yaml:3:8: an integer beyond 64 bits"),
    "5000 digits in hex": (GOOD + f"seeds: 0x{'f' * 5000}\n", r"e\.yaml:3:8: an integer beyond 64 bits"),
    "a seed beyond 64 bits": (GOOD + "seeds: [3, 9223372036854775808]\n", r"e\.yaml:3:12: an integer beyond"),
    "a parameter beyond 64 bits": (
        "source:\n  name: circle\n  steps: 18446744073709551616\nback_ends: [{name: ekf_slam}]\n",
        r"e\.yaml:3:10: an integer beyond 64 bits",
    ),
    "300 brackets": ("[" * 300 + "]" * 300, r"e\.yaml: nested too deeply"),
    "300 brackets in a sweep": (
        GOOD + f"sweep: {{source.steps: {'[' * 300}{']' * 300}}}\n",
        "nested too deeply",
    ),
    "30000 brackets": (GOOD + f"figures: {'[' * 30000}\n", "nested too deeply|not valid YAML"),
    "60 levels of mappings": (GOOD + "x: " + "{a: " * 60 + "1" + "}" * 60 + "\n", "nested too deeply"),
    "aliases of aliases": (BOMB + GOOD, r"e\.yaml: more than 200000 values"),
    "an alias of itself": (GOOD + "sweep: {source.steps: &a [2, *a]}\n", r"e\.yaml:3:"),
    "the 99th of a month": (GOOD + "description: 2020-99-99\nname: 2020-13-45T99:99:99Z\n", r"e\.yaml"),
    "a key that is a list": (GOOD + "? [1, 2]\n: 3\n", r"e\.yaml:3:"),
    "a lone surrogate": (GOOD + 'question: "\\ud800"\n', r"e\.yaml:3:11: a text that is not valid Unicode"),
    "a zero byte": (GOOD + 'question: "\\0"\n', r"e\.yaml:3:11: a text that is not valid Unicode"),
    "a zero byte in the file itself": (GOOD + "seeds: 1\0\n", r"e\.yaml: not valid YAML: unacceptable"),
    "a merge with itself": (GOOD + "x: &x {<<: *x}\n", r"e\.yaml: not valid YAML"),
    "a name that no folder can have": (GOOD + f"name: {'a' * 300}\n", r"e\.yaml:3:7: name: "),
    "a default that no file can hold": (
        GOOD.replace("name: ekf_slam", "name: 'odd.py:Odd'"),
        r"e\.yaml:2:20: odd\.py:Odd: its parameters must be numbers",
    ),
    "two documents": (GOOD + "---\n" + GOOD, r"e\.yaml:3:1: not valid YAML"),
    "infinite sigma": (
        "source:\n  name: circle\n  range_sigma_m: .inf\nback_ends: [{name: ekf_slam}]\n",
        r"e\.yaml:3:18: range_sigma_m: .*finite",
    ),
    "no number as sigma": (
        "source:\n  name: circle\n  range_sigma_m: .nan\nback_ends: [{name: ekf_slam}]\n",
        r"e\.yaml:3:18: range_sigma_m: ",
    ),
    "infinite sigma in a sweep": (
        GOOD + "sweep:\n  source.noise_scale: [1, .inf]\n",
        r"e\.yaml:4:27: noise_scale: ",
    ),
    "ranges the wrong way": (
        "source:\n  name: circle\n  range_min_m: 9\n  range_max_m: 2\nback_ends: [{name: ekf_slam}]\n",
        r"e\.yaml:3:16: range_min_m is 9 and range_max_m 2",
    ),
    "a range beyond the default's": (
        "source:\n  name: circle\n  range_min_m: 9\nback_ends: [{name: ekf_slam}]\n",
        r"e\.yaml:3:16: range_min_m is 9 and range_max_m 8",
    ),
    "ranges of the front end": (
        GOOD + "front_end: {name: labelled, range_max_m: 2, range_min_m: 3}\n",
        r"e\.yaml:3:\d+: range_min_m is 3 and range_max_m 2",
    ),
    "a range in a sweep": (
        GOOD + "sweep:\n  source.range_max_m: [8, 0.2]\n",
        r"e\.yaml:4:27: range_min_m is 0\.5 and range_max_m 0\.2",
    ),
    "an annulus the wrong way": (
        "source: {name: circle, annulus_min_m: 7}\nback_ends: [{name: ekf_slam}]\n",
        r"e\.yaml:1:39: annulus_min_m is 7 and annulus_max_m 5",
    ),
    "images without a front end for them": (
        "source: {name: rendered}\nback_ends: [{name: isam2}]\nfront_end: {name: labelled}\n",
        r"e\.yaml:3:19: .*gives images; take front_end: \{name: tracked_features\}",
    ),
    "images and the default front end": (
        "source: {name: rendered}\nback_ends: [{name: isam2}]\n",
        r"e\.yaml:1:1: .*gives images; take front_end: \{name: tracked_features\}",
    ),
    "a front end without images": (
        GOOD + "front_end: {name: tracked_features}\n",
        r"e\.yaml:3:19: .*gives detections; take front_end: \{name: labelled\}",
    ),
    "a grid without end": (
        GOOD + "sweep:\n" + "".join(f"  source.{name}: {list(range(1, 60))}\n" for name in COUNTS),
        r"e\.yaml:4:3: sweep: 1\.21e\+07 runs in all",
    ),
    "a user who is not there": (
        "source: {name: circle}\nback_ends: [{name: '~nobody_of_that_name/x.py:A'}]\n",
        r"e\.yaml:2:20: name: '~nobody_of_that_name/x\.py' is no path",
    ),
    "a path that is too long": (
        f"source: {{name: circle}}\nback_ends: [{{name: '{'x' * 5000}.py:A'}}]\n",
        r"e\.yaml:2:20: ",
    ),
    "memory beyond all numbers": (GOOD + "memory_limit_mb: 1.0e+300\n", r"e\.yaml:3:18: memory_limit_mb"),
    "sections of the wrong kind": (
        "source: 3\nfront_end: [1]\nback_ends: {a: 1}\nseeds: x\n",
        r"e\.yaml:1:9: source",
    ),
}


@pytest.mark.parametrize("kind", list(BAD))
def test_bad_input_is_one_clear_message(tmp_path: Path, kind: str) -> None:
    text, told = BAD[kind]
    path = tmp_path / "e.yaml"
    path.write_text(text)
    (tmp_path / "odd.py").write_text(
        "class Odd:\n    def __init__(self, problem, *, of: list = object()): ...\n"
    )
    with pytest.raises(UsageError, match=told) as caught:
        load_experiment(path)
    assert caught.value.exit_code == 2
    message = str(caught.value).replace(str(tmp_path), "")
    assert len(message.encode()) <= LIMIT
    # A line for each mistake.
    assert all("e.yaml" in line for line in str(caught.value).splitlines())


def test_corner_of_a_grid_may_be_impossible(tmp_path: Path) -> None:
    """Two swept together may go together where each alone does not."""
    path = tmp_path / "e.yaml"
    path.write_text(GOOD + "sweep:\n  source.range_min_m: [0.5, 10]\n  source.range_max_m: [8, 20]\n")
    assert len(load_experiment(path).sweep) == 2


def test_no_limit_may_be_written_out(tmp_path: Path) -> None:
    path = tmp_path / "e.yaml"
    path.write_text(GOOD + "front_end: {name: labelled, range_max_m: .inf}\n")
    assert load_experiment(path).front_end.parameters["range_max_m"] in (math.inf, "inf", "Infinity")


def test_many_mistakes_are_told_within_bounds(tmp_path: Path) -> None:
    path = tmp_path / "e.yaml"
    path.write_text(GOOD + "".join(f"unknown_{n}: {n}\n" for n in range(500)))
    with pytest.raises(UsageError) as caught:
        load_experiment(path)
    lines = str(caught.value).splitlines()
    assert len(str(caught.value).encode()) <= LIMIT
    assert len(lines) > 3
    assert lines[-1] == f"… and {501 - len(lines)} more mistakes"


@pytest.mark.parametrize(
    "content",
    [
        *(b"", b"[]", b"3", b"null", b"{}", b"\xff\xfe", b"[" * 100_000, b'{"config_file": null}'),
        *(b'{"config_file": 5, "config": {}}', b'{"config_file": "/", "config": 3}'),
        b'{"config_file": "a\\u0000b", "config": 1}',
    ],
)
def test_damaged_manifest_is_no_reason_to_fail(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "e.yaml").write_text(GOOD)
    (tmp_path / "manifest.json").write_bytes(content)
    require_same_experiment(load_experiment(tmp_path / "e.yaml"), tmp_path)


def test_seeds_given_in_a_program_or_on_the_command_line(tmp_path: Path) -> None:
    (tmp_path / "e.yaml").write_text(GOOD)
    experiment = load_experiment(tmp_path / "e.yaml")
    for seeds in ([2**63], [-1], range(10**12)):
        with pytest.raises(UsageError, match="seeds: at most"):
            experiment.with_seeds(seeds)


def test_mapping_that_holds_itself() -> None:
    data: dict[str, object] = {"source": {"name": "circle"}}
    data["back_ends"] = [data]
    with pytest.raises(UsageError, match="nested too deeply"):
        CodeSource("experiment", data)


KEYS = [
    *("name", "question", "source", "front_end", "back_ends", "reference", "seeds", "until", "sweep"),
    *("time_limit_s", "memory_limit_mb", "record", "figures", "published", "steps", "label", "own_gate"),
    *("metric", "half_width", "range_max_m", "range_min_m", "source.steps", "back_ends.ekf_slam.x", "path"),
]
NAMES = ["circle", "ekf_slam", "labelled", "graph_file", "a.py:B", "online_ate", "~x/y.py:Z", "\ud800"]
ANY_KEY = st.sampled_from(KEYS) | st.text(max_size=4)
SIGNS = st.characters(codec="utf-8") | st.sampled_from(list("[]{}:-&*!|>'\"\n #%@`,?"))
VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**70), 2**70)
    | st.floats()
    | st.text(max_size=8)
    | st.sampled_from(NAMES),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(ANY_KEY, inner, max_size=4),
    max_leaves=12,
)


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@given(st.dictionaries(st.sampled_from(KEYS), VALUES, max_size=6))
def test_any_mapping_is_an_experiment_or_one_clear_message(data: dict) -> None:
    source = {"name": "circle", **(data["source"] if isinstance(data.get("source"), dict) else {})}
    for given_data in (data, {**data, "source": source, "back_ends": [{"name": "ekf_slam"}]}):
        try:
            parse_experiment(CodeSource("experiment", given_data), None)
        except SlamcmpError as error:
            assert 0 < len(str(error).encode()) <= LIMIT  # noqa: PT017


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@given(st.text(SIGNS, max_size=60), st.booleans())
def test_any_text_is_an_experiment_or_one_clear_message(text: str, behind_a_good_one: bool) -> None:
    try:
        parse_experiment(YamlSource("e.yaml", (GOOD if behind_a_good_one else "") + text), Path("e.yaml"))
    except SlamcmpError as error:
        assert 0 < len(str(error).encode()) <= LIMIT  # noqa: PT017


def test_good_experiment_is_one(tmp_path: Path) -> None:
    """What the others are a change of."""
    (tmp_path / "e.yaml").write_text(GOOD)
    assert json.dumps(load_experiment(tmp_path / "e.yaml").as_dict())


def test_what_is_expected_shows_no_traceback_in_this_process(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """The serial executor has no log to put it in."""
    step = "1 0 0 100 0 0 100 0 100"
    chain = [f"EDGE_SE2 {k} {k + 1} {step}" for k in range(3)]
    (tmp_path / "loop.g2o").write_text("\n".join([*chain, f"EDGE_SE2 3 0 {step}"]) + "\n")
    (tmp_path / "t.txt").write_text("900 0 0 0 0 0 0 1\n901 0 0 0 0 0 0 1\n")
    path = tmp_path / "e.yaml"
    for more, message in (
        ("", "takes no loop closures"),
        (", truth: t.txt", "has no pose at any of the log's"),
    ):
        path.write_text(
            f"source: {{name: graph_file, path: loop.g2o{more}}}\nback_ends: [{{name: ekf_slam}}]\n"
        )
        if more:
            with pytest.raises(SlamcmpError, match=message):
                run_experiment(path, folder=tmp_path / "r", executor="serial")
        else:
            (told,) = run_experiment(path, folder=tmp_path / "r", executor="serial").trials["message"]
            assert message in told
    assert "Traceback" not in capfd.readouterr().err
