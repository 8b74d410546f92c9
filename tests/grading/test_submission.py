"""Submissions in every form, and everything that is misused as one."""

from __future__ import annotations

import json
import os
import socket
import stat
import struct
import zipfile
from pathlib import Path

import pytest

from slamcmp.grading.hand_in.hand_in import FILE_BYTES, FILES_MAX
from slamcmp.grading.hand_in.submission import SubmissionError, load_submission

GOOD = "def double(x):\n    return 2 * x\n"


def make_zip(path: Path, entries: dict[str, str | bytes], **attributes: int) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in entries.items():
            info = zipfile.ZipInfo(name)
            info.compress_type = zipfile.ZIP_DEFLATED
            info.external_attr = attributes.get("mode", stat.S_IFREG | 0o644) << 16
            archive.writestr(info, content)
    return path


def make_notebook(path: Path, *cells: tuple[str, str | list[str], list[str]]) -> Path:
    made = [
        {"cell_type": kind, "source": source, "metadata": {"tags": tags}, "outputs": []}
        for kind, source, tags in cells
    ]
    path.write_text(json.dumps({"nbformat": 4, "cells": made}))
    return path


def refused(path: Path, *, entry: str | None = None) -> str:
    with pytest.raises(SubmissionError) as caught:
        load_submission(path, entry=entry)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_a_file_is_taken_under_the_assignment_s_name(tmp_path: Path) -> None:
    (tmp_path / "ekf (3).py").write_text(GOOD)
    submission = load_submission(tmp_path / "ekf (3).py", entry="ekf.py")
    assert submission.files == {"ekf.py": GOOD.encode()}
    assert (submission.kind, submission.entry, submission.name) == ("file", "ekf.py", "ekf (3).py")


def test_a_folder_is_taken_whole_but_for_junk(tmp_path: Path) -> None:
    root = tmp_path / "mine"
    junk = (".DS_Store", "__pycache__/ekf.pyc", ".git/config", ".git/HEAD", ".ekf.py", "helpers/._maths.py")
    for name in ("ekf.py", "helpers/maths.py", *junk):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(GOOD)
    submission = load_submission(root, entry="ekf.py")
    assert sorted(submission.files) == ["ekf.py", "helpers/maths.py"]
    assert submission.entry == "ekf.py"
    hidden = (".DS_Store", ".ekf.py", ".git", "__pycache__", "helpers/._maths.py")
    assert submission.left_out == hidden
    zipped = make_zip(tmp_path / "m.zip", {"ekf.py": GOOD, "__MACOSX/._ekf.py": b"\0", "__MACOSX/._a": b"x"})
    assert load_submission(zipped).left_out == ("__MACOSX",)
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / ".ekf.py").write_text(GOOD)
    assert refused(tmp_path / "empty") == "empty: is empty but for what is hidden (.ekf.py)"


def test_folder_file_and_zip_of_the_same_content_have_the_same_digest(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "ekf.py").write_text(GOOD)
    plain = make_zip(tmp_path / "plain.zip", {"ekf.py": GOOD})
    nested = make_zip(tmp_path / "nested.zip", {"mine/ekf.py": GOOD, "__MACOSX/mine/._ekf.py": b"\0"})
    digests = {load_submission(path).digest for path in (tmp_path / "mine", plain, nested)}
    assert digests == {load_submission(tmp_path / "mine" / "ekf.py").digest}
    (tmp_path / "mine" / "ekf.py").write_text(GOOD + "\n")
    assert load_submission(tmp_path / "mine").digest not in digests


def test_the_entry_must_be_clear(tmp_path: Path) -> None:
    root = tmp_path / "mine"
    root.mkdir()
    (root / "notes.txt").write_text("x")
    assert refused(root, entry="ekf.py") == "mine: holds no Python file at its top; ekf.py is expected there"
    (root / "a.py").write_text(GOOD)
    assert load_submission(root, entry="ekf.py").entry == "a.py"
    (root / "b.py").write_text(GOOD)
    assert "which file is to be graded? Name it ekf.py (found a.py, b.py)" in refused(root, entry="ekf.py")
    (root / "submission.py").write_text(GOOD)
    assert load_submission(root, entry="ekf.py").entry == "submission.py"


@pytest.mark.parametrize(
    "name", ["../evil.py", "a/../../evil.py", "/etc/evil.py", "..\\evil.py", "C:evil.py"]
)
def test_zip_slip_is_refused(tmp_path: Path, name: str) -> None:
    archive = make_zip(tmp_path / "slip.zip", {"ekf.py": GOOD, name: GOOD})
    assert "names a place outside of the submission" in refused(archive)
    assert not (tmp_path.parent / "evil.py").exists()


@pytest.mark.parametrize("kind", [stat.S_IFLNK, stat.S_IFIFO, stat.S_IFCHR, stat.S_IFBLK, stat.S_IFSOCK])
def test_links_and_devices_in_a_zip_are_refused(tmp_path: Path, kind: int) -> None:
    archive = make_zip(tmp_path / "link.zip", {"ekf.py": "/etc/passwd"}, mode=kind | 0o777)
    assert "is a link or a device" in refused(archive)


def test_a_bomb_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    archive = make_zip(tmp_path / "bomb.zip", {"ekf.py": b"#" * (64 << 20)})
    assert archive.stat().st_size < 100_000
    assert "is larger than 10 MB when unpacked" in refused(archive)


def test_a_bomb_that_lies_about_its_size_is_refused(tmp_path: Path) -> None:
    archive = make_zip(tmp_path / "liar.zip", {"ekf.py": b"#" * (4 << 20)})
    content = bytearray(archive.read_bytes())
    # The uncompressed size stands at byte 22 of the local header and 24 of the central one.
    for signature, offset in ((b"PK\x03\x04", 22), (b"PK\x01\x02", 24)):
        at = content.index(signature) + offset
        assert struct.unpack_from("<I", content, at) == (4 << 20,)
        struct.pack_into("<I", content, at, 100)
    archive.write_bytes(content)
    assert "liar.zip" in refused(archive)


def test_too_many_files_are_refused(tmp_path: Path) -> None:
    archive = make_zip(tmp_path / "many.zip", {f"f{i}.py": "" for i in range(FILES_MAX + 1)})
    assert f"more than {FILES_MAX} files" in refused(archive)
    archive = make_zip(tmp_path / "crowd.zip", {f"__pycache__/{i}": "" for i in range(20 * FILES_MAX + 1)})
    assert "entries" in refused(archive)


def test_a_file_that_stands_twice_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "twice.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("ekf.py", GOOD)
        with pytest.warns(UserWarning, match="Duplicate"):
            archive.writestr("ekf.py", "evil = 1")
    assert "stands twice" in refused(path)


def test_an_encrypted_zip_is_refused(tmp_path: Path) -> None:
    archive = make_zip(tmp_path / "locked.zip", {"ekf.py": GOOD})
    content = bytearray(archive.read_bytes())
    for signature, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        content[content.index(signature) + offset] |= 1
    archive.write_bytes(content)
    assert "is encrypted" in refused(archive)


def test_damaged_and_foreign_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.zip").write_bytes(b"PK\x03\x04 not really")
    assert "is no readable zip" in refused(tmp_path / "a.zip")
    cut = make_zip(tmp_path / "cut.zip", {"ekf.py": os.urandom(5000).hex()})
    content = bytearray(cut.read_bytes())
    content[60:500] = bytes(440)
    cut.write_bytes(content)
    assert "is no readable zip" in refused(cut)
    (tmp_path / "a.tar").write_bytes(b"x")
    assert "hand in a .py file, a folder, a .zip or a notebook" in refused(tmp_path / "a.tar")
    assert "cannot be read" in refused(tmp_path / "missing.py")


def test_an_empty_submission_is_refused(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    assert refused(tmp_path / "mine") == "mine: is empty"
    assert refused(make_zip(tmp_path / "a.zip", {})) == "a.zip: is empty"


def test_binary_junk_is_refused_with_its_place(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_bytes(b"\x7fELF\0\0")
    assert refused(tmp_path / "a.py") == "a.py: is no Python source, it holds binary data"
    (tmp_path / "a.py").write_bytes(b"x = 1\n# gr\xfc\xdfe\n")
    assert refused(tmp_path / "a.py") == "a.py, line 2: is not UTF-8 text; save the file as UTF-8"
    (tmp_path / "a.py").write_bytes(b"#" * (FILE_BYTES + 1))
    assert "is larger than 2 MB" in refused(tmp_path / "a.py")


def test_links_pipes_and_sockets_in_a_folder_are_refused(tmp_path: Path) -> None:
    root = tmp_path / "mine"
    root.mkdir()
    (root / "ekf.py").symlink_to("/etc/passwd")
    assert refused(root) == "ekf.py: is a link; hand in the file itself"
    (root / "ekf.py").unlink()
    os.mkfifo(root / "ekf.py")
    assert "is no regular file" in refused(root)
    assert "is no regular file" in refused(root / "ekf.py")
    (root / "ekf.py").unlink()
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(root / "ekf.py"))
        assert "is no regular file" in refused(root)
    (root / "ekf.py").unlink()
    (root / "deep").symlink_to("/")
    assert "is a link" in refused(root)
    (tmp_path / "link.py").symlink_to("/etc/passwd")
    assert "is a link" in refused(tmp_path / "link.py")


def test_marked_cells_are_taken_and_lines_are_known_by_cell(tmp_path: Path) -> None:
    notebook = make_notebook(
        tmp_path / "ekf.ipynb",
        ("markdown", "# Title", []),
        ("code", "print('exploring')", []),
        ("code", ["import numpy as np\n", "%matplotlib inline\n", "x = 1"], ["submit"]),
        ("code", "# %% submit\ndef f():\n    !ls\n    return 1", []),
    )
    submission = load_submission(notebook, entry="ekf.py")
    assert submission.files["ekf.py"].decode() == (
        "import numpy as np\npass  # %matplotlib inline\nx = 1\n"
        "# %% submit\ndef f():\n    pass  # !ls\n    return 1\n"
    )
    assert not submission.definitions_only
    assert submission.place("ekf.py", 2) == "cell 3, line 2"
    assert submission.place("ekf.py", 7) == "cell 4, line 4"
    assert submission.place("other.py", 7) == "other.py, line 7"


def test_without_marks_all_code_is_taken_as_definitions(tmp_path: Path) -> None:
    notebook = make_notebook(
        tmp_path / "ekf.ipynb",
        ("code", "GATE = 5.99\nraise SystemExit", []),
        ("code", "%%time\nslow()", []),
        ("code", "%%bash\nrm -rf .", []),
        ("code", GOOD, []),
    )
    submission = load_submission(notebook)
    assert submission.definitions_only
    assert submission.files["notebook.py"].decode() == (
        f"GATE = 5.99\nraise SystemExit\n# %%time\nslow()\n# %%bash\n# rm -rf .\n{GOOD}\n"
    )


@pytest.mark.parametrize(
    "content",
    ["", "[]", "{}", '{"cells": 3}', '{"cells": [{"cell_type": "code"}]}', "[" * 100_000, '{"cells": [[]]}'],
)
def test_what_is_no_notebook_is_refused(tmp_path: Path, content: str) -> None:
    (tmp_path / "a.ipynb").write_text(content)
    assert "is no notebook of format 4" in refused(tmp_path / "a.ipynb")


def test_a_notebook_without_code_is_refused(tmp_path: Path) -> None:
    notebook = make_notebook(tmp_path / "a.ipynb", ("markdown", "text", []), ("code", "", []))
    assert "has no code" in refused(notebook)
