"""Pages with code run as they stand, in their order, and print what they say."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"
sys.path.insert(0, str(DOCS))

from run_page import PageError, blocks, run_page, same_output  # noqa: E402

FOLDERS = ("tutorials", "lecture", "conventions", "start")
PAGES = [path.relative_to(DOCS).as_posix() for each in FOLDERS for path in sorted((DOCS / each).glob("*.md"))]
WITH_CODE = [page for page in PAGES if page != "lecture/index.md"]
TUTORIALS = {
    "first-comparison",
    "own-back-end",
    "own-log",
    "grading-a-class",
    "reading-the-report",
    "paper-figures",
}


@pytest.mark.parametrize("page", WITH_CODE)
def test_a_page_runs_as_it_stands(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    if page == "tutorials/grading-a-class.md" and sys.platform != "linux":
        pytest.skip("submissions are run on Linux only")
    for name in ("COLUMNS", "NO_COLOR"):
        monkeypatch.setenv(name, "")  # given back afterwards
    monkeypatch.syspath_prepend(str(tmp_path))
    run_page(DOCS / page, tmp_path)
    monkeypatch.delitem(sys.modules, "my_backend", raising=False)


def test_there_is_a_page_for_everything_that_was_asked_for() -> None:
    assert {Path(page).stem for page in PAGES if page.startswith("tutorials/")} == TUTORIALS
    assert {Path(page).stem for page in PAGES if page.startswith("start/")} == {
        "student",
        "teacher",
        "researcher",
    }
    problems = [page for page in PAGES if page.startswith("lecture/problem-")]
    assert [Path(page).stem.split("-")[1] for page in problems] == list("123456")
    for page in WITH_CODE:
        kinds = {block.kind for block in blocks((DOCS / page).read_text(encoding="utf-8"))}
        assert kinds & {"python", "sh"}, page


def test_the_own_back_end_takes_as_many_lines_as_its_title_says() -> None:
    """Of code, without imports and blank lines; and it is the README's."""
    page = (DOCS / "tutorials" / "own-back-end.md").read_text(encoding="utf-8")
    (own,) = [block.text for block in blocks(page) if block.file == "my_backend.py"]
    lines = [line for line in own.partition("class MyEkf")[2].splitlines()[1:] if line.strip()]
    assert len(lines) <= 30
    readme = (DOCS.parent / "README.md").read_text(encoding="utf-8")
    assert own.strip() in readme


class TestTheRunner:
    """What it says of a page that is wrong."""

    @pytest.mark.parametrize(
        ("page", "told"),
        [
            ("```python\nx = 1\n1 / 0\n```\n", "page.md:2: ZeroDivisionError"),
            ("# T\n\n```python\nprint(1.00)\n```\n\n```text\n1.1\n```\n", "the page says"),
            ("```sh\nfalse\n```\n", "page.md:2: false: exit code 1"),
            ("```sh\nslamcmp run no_such_experiment\n```\n", "exit code 3"),
        ],
    )
    def test_a_fault_is_told_with_its_place(self, page: str, told: str, tmp_path: Path) -> None:
        (tmp_path / "page.md").write_text(page)
        before = Path.cwd()
        with pytest.raises(PageError) as error:
            run_page(tmp_path / "page.md", tmp_path)
        assert told in str(error.value)
        assert Path.cwd() == before

    @pytest.mark.parametrize(
        ("said", "printed", "same"),
        [
            ("a 1.00 m", "a 1.02 m", True),
            ("a 1.00 m", "a 1.05 m", False),
            ("a 1.00 m", "a 1.00 s", False),
            ("−0.5", "-0.5", True),
            ("first\n...\nlast", "first\n2\n3\nlast\n", True),
            ("first\n...\nlast", "first\n2\n3\nlast\nmore", False),
            ("first\n...", "first\n2\n3", True),
            ("first", "first second", False),
            ("", "something", False),
        ],
    )
    def test_output_is_compared_by_words_and_numbers(self, said: str, printed: str, same: bool) -> None:
        assert same_output(said, printed) == same

    def test_a_file_named_above_its_block_is_written_and_not_run(self, tmp_path: Path) -> None:
        page = tmp_path / "page.md"
        page.write_text("`sub/one.py`\n\n```python\nraise SystemExit\n```\n\n```sh\ncat sub/one.py\n```\n")
        run_page(page, tmp_path)
        assert (tmp_path / "sub" / "one.py").read_text() == "raise SystemExit\n"
