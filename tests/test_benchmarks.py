"""``make bench`` never stops at a miss, and ``make bench-check`` sees a ratio that grew."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path
from typing import Any

import pytest

SCRIPT = Path(__file__).parents[1] / "benchmarks" / "all.py"


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    """The driver with three benchmarks of its own: one is well, one misses its limit, one falls over."""
    specification = importlib.util.spec_from_file_location("all_benchmarks", SCRIPT)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    monkeypatch.setitem(sys.modules, "all_benchmarks", module)
    specification.loader.exec_module(module)
    scripts = {
        "broken": "raise SystemExit('no such library')",
        "slow": "import sys; print('[[\"step\", 0.9, 0.5]]'); sys.exit(1)",
        "well": 'print(\'[["step", 0.2, 0.5], ["other", 0.1, null]]\')',
    }
    for name, text in scripts.items():
        (tmp_path / f"{name}.py").write_text(text)
    monkeypatch.setattr(module, "HERE", tmp_path)
    monkeypatch.setattr(
        module, "BENCHMARKS", {name: ((f"{name}.py",), lambda rows: rows) for name in scripts}
    )
    return module


def call(bench: Any, monkeypatch: pytest.MonkeyPatch, folder: Path, *words: str) -> int:
    monkeypatch.setattr(sys, "argv", ["all.py", "--results", str(folder), *words])
    return int(bench.main())


def test_every_benchmark_has_its_rows(
    bench: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(bench, monkeypatch, tmp_path / "r") == 1
    content = json.loads((tmp_path / "r" / "latest.json").read_text())
    rows = {(row["benchmark"], row["what"]): row for row in content["rows"]}
    assert set(rows) == {("broken", ""), ("slow", "step"), ("well", "step"), ("well", "other")}
    assert "no such library" in rows["broken", ""]["fault"]
    assert content["machine"]["cores"] >= 1
    assert content["machine"]["numpy"][0].isdigit()
    table = (tmp_path / "r" / "latest.md").read_text()
    assert "| slow | step | 0.900 | 0.5 | missed |" in table
    said = capsys.readouterr().err
    assert "slow: step: 0.900, over its limit of 0.5" in said
    assert call(bench, monkeypatch, tmp_path / "r", "--only", "well") == 0


@pytest.mark.parametrize(("committed", "code"), [(0.2, 0), (0.175, 0), (0.173, 1), (0.5, 0)])
def test_a_ratio_may_grow_by_fifteen_per_cent(
    bench: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, committed: float, code: int
) -> None:
    folder = tmp_path / "r"
    assert call(bench, monkeypatch, folder, "--only", "well", "--check") == 1  # nothing to compare with
    assert call(bench, monkeypatch, folder, "--only", "well", "--keep") == 0
    reference = json.loads((folder / "reference.json").read_text())
    reference["rows"][0]["ratio"] = committed
    (folder / "reference.json").write_text(json.dumps(reference))
    assert call(bench, monkeypatch, folder, "--only", "well", "--check") == code


def test_what_is_no_longer_measured_is_told(
    bench: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "r"
    call(bench, monkeypatch, folder, "--only", "well", "--keep")
    (tmp_path / "well.py").write_text("print('[[\"step\", 0.2, 0.5]]')")
    assert call(bench, monkeypatch, folder, "--only", "well", "--check") == 1
    assert "well: other: committed, and not measured now" in capsys.readouterr().err


def peers() -> Any:
    sys.path.insert(0, str(SCRIPT.parent))
    try:
        return importlib.import_module("peers")
    finally:
        sys.path.remove(str(SCRIPT.parent))


def test_a_peer_that_is_not_there_is_told_with_the_reason(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, bench: Any
) -> None:
    module = peers()
    monkeypatch.setattr(module, "STEPS", {20: 2})
    monkeypatch.setattr(module.shutil, "which", lambda program: None)
    monkeypatch.setitem(sys.modules, "filterpy.kalman", None)
    rows = {row["peer"]: row for row in module.rows_of(tmp_path)}
    assert rows["filterpy"]["skipped"] == "filterpy is not installed: pip install 'slamcmp[peers]'"
    assert rows["PythonRobotics"]["skipped"] == f"{tmp_path} holds no SLAM/EKFSLAM/ekf_slam.py"
    assert "simul-landmarks is not on the PATH" in rows["MRPT"]["skipped"]
    assert bench.of_peers(list(rows.values())) == []


def test_a_checkout_of_pythonrobotics_gets_each_frame(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    module = peers()
    folder = tmp_path / "SLAM" / "EKFSLAM"
    folder.mkdir(parents=True)
    (folder / "ekf_slam.py").write_text(
        "DT = 0.1\n"
        "def ekf_slam(x, P, u, z):\n"
        "    assert x.shape == (43, 1) and P.shape == (43, 43) and z.shape == (10, 3)\n"
        "    assert abs(DT * u[0, 0] - 0.5) < 1e-9 and abs(DT * u[1, 0] - 0.02) < 1e-9\n"
        "    print('New LM')\n"
        "    return x, P\n"
    )
    monkeypatch.setattr(module, "STEPS", {20: 2})
    monkeypatch.setattr(module.shutil, "which", lambda program: None)
    (row,) = (row for row in module.rows_of(tmp_path) if row["peer"] == "PythonRobotics")
    assert row["skipped"] is None
    assert row["ratio"] == pytest.approx(row["ours_us"] / row["peer_us"])


def test_a_report_of_mrpt_is_read_whatever_its_units() -> None:
    total = peers().profiled_total
    assert total("KF:complete_step       399  28.6us 119.4us   8.2ms  47.7ms\n") == (
        399,
        pytest.approx(0.0476406),
    )
    assert total("x\nKF:complete_step   7  64.0us   9.5ms  1.3 s   3.8 s\n") == (7, pytest.approx(0.0665))
    with pytest.raises(peers().Absent, match="no line for KF:complete_step"):
        total("KF:other 3 1us 2us 3us 4us\n")


def test_every_script_is_among_them() -> None:
    """A benchmark that the table leaves out is one that nobody runs."""
    text = SCRIPT.read_text()
    for path in SCRIPT.parent.glob("*.py"):
        if path.name not in ("all.py", "naive_ekf.py"):
            assert f'"{path.name}"' in text, path.name
