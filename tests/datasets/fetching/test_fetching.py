"""Downloads against servers on this machine: what is kept, what is refused, and what is said."""

from __future__ import annotations

import errno
import os
import stat
import tarfile
import zipfile
from pathlib import Path

import pytest

from slamcmp.datasets.fetching import download as downloading
from slamcmp.datasets.fetching.data_set import Archive
from slamcmp.datasets.fetching.download import Limits, UnreachableError, download
from slamcmp.datasets.fetching.fetch import fetch
from slamcmp.datasets.fetching.unpack import unpack
from slamcmp.datasets.fetching.verify import verify
from slamcmp.errors import DataError, MissingDataError, StorageError, UsageError
from tests.datasets.fetching.servers import Mirror, ftp_server, http_mirror
from tests.datasets.fetching.toys import BYTES, CONTENT, SHA256, everything, toy, zipped

CHUNK = downloading._CHUNK


def test_a_set_is_fetched_whole_and_once(tmp_path):
    with http_mirror(Mirror({"toy.zip": BYTES})) as mirror:
        done = fetch(toy(mirror.url), tmp_path)
        assert done.new
        assert done.folder == tmp_path / "toys/Toy_Set"
        assert not fetch(toy(mirror.url), tmp_path).new
        assert len(mirror.asked) == 1
    # The set, and what it was; nothing of the way.
    assert everything(tmp_path) == [".receipts/toy.json", "toys/Toy_Set/a.txt", "toys/Toy_Set/deep/b.txt"]
    assert (done.folder / "a.txt").read_bytes() == CONTENT["Toy_Set/a.txt"]


@pytest.mark.parametrize("tag", ['"one"', None])
def test_a_cut_connection_is_gone_on_from(tmp_path, tag):
    with http_mirror(Mirror({"toy.zip": BYTES}, tag=tag, cut_after=[100_000, 50_000])) as mirror:
        path = download(f"{mirror.url}/toy.zip", tmp_path, "toy.zip", sha256=SHA256)
        assert [wanted for _, wanted in mirror.asked] == [None, f"bytes={6 * CHUNK}-", f"bytes={9 * CHUNK}-"]
    assert path.read_bytes() == BYTES
    assert everything(tmp_path) == ["toy.zip"]


def test_what_came_stays_for_the_next_call(tmp_path):
    with http_mirror(Mirror({"toy.zip": BYTES}, cut_after=[100_000, 0])) as mirror:
        with pytest.raises(
            UnreachableError, match=r"cut off after 0\.0983 MB, which are kept: the same command"
        ):
            download(f"{mirror.url}/toy.zip", tmp_path, "toy.zip")
        assert (tmp_path / "toy.zip.part").read_bytes() == BYTES[: 6 * CHUNK]
        download(f"{mirror.url}/toy.zip", tmp_path, "toy.zip", sha256=SHA256)
        assert mirror.asked[-1][1] == f"bytes={6 * CHUNK}-"


@pytest.mark.parametrize("kind", ["no parts", "another file", "shorter file", "all there"])
def test_a_part_that_does_not_go_on_is_begun_anew(tmp_path, kind):
    old = zipped({"Toy_Set/other.txt": b"x" * 5000})
    (tmp_path / "toy.zip.part").write_bytes(
        {"shorter file": b"x" * (len(BYTES) + 7), "all there": BYTES}.get(kind, old[:1000])
    )
    if kind == "another file":
        (tmp_path / "toy.zip.part.tag").write_text('"yesterday"')
    with http_mirror(Mirror({"toy.zip": BYTES}, parts=kind != "no parts")) as mirror:
        path = download(
            f"{mirror.url}/toy.zip", tmp_path, "toy.zip", sha256=None if kind == "no parts" else SHA256
        )
    assert path.read_bytes() == BYTES
    assert everything(tmp_path) == ["toy.zip"]


def test_a_wrong_checksum_is_refused_and_nothing_of_it_is_kept(tmp_path):
    wrong = zipped({**CONTENT, "Toy_Set/a.txt": b"1\n"})
    with http_mirror(Mirror({"toy.zip": wrong})) as mirror:
        with pytest.raises(DataError, match=rf"toy\.zip: what came does not have the checksum {SHA256}"):
            fetch(toy(mirror.url), tmp_path / "root")
        assert everything(tmp_path / "root") == []
        # A mirror's folder neither.
        (tmp_path / "toy.zip").write_bytes(wrong)
        with pytest.raises(DataError, match="does not have the checksum"):
            fetch(toy(mirror.url), tmp_path / "root", origin=str(tmp_path))
        assert everything(tmp_path / "root") == []
        # And what is right afterwards comes.
        mirror.files["toy.zip"] = BYTES
        assert fetch(toy(mirror.url), tmp_path / "root").new


def test_a_login_page_and_another_sets_archive_are_told(tmp_path):
    without = (Archive("http://x/toy.zip"),)
    with http_mirror(Mirror({"toy.zip": b"<html>please log in</html>"})) as mirror:
        with pytest.raises(
            DataError, match=r"no archive that can be read .* a web page that asks for a login\?"
        ):
            fetch(toy("", archives=without), tmp_path, origin=mirror.url)
        mirror.files["toy.zip"] = zipped({"Other/c.txt": b"3"})
        with pytest.raises(
            DataError, match=r"toy\.zip unpacks to no folder with all of a\.txt, deep/\*\.txt"
        ):
            fetch(toy("", archives=without), tmp_path, origin=f"{mirror.url}/")
    assert everything(tmp_path) == []


def test_a_mirrors_folder_with_the_archive_or_the_set(tmp_path):
    (tmp_path / "archives").mkdir()
    (tmp_path / "archives" / "toy.zip").write_bytes(BYTES)
    assert fetch(toy("http://nowhere.invalid"), tmp_path / "one", origin=str(tmp_path / "archives")).new
    unpack(tmp_path / "archives" / "toy.zip", tmp_path / "unpacked")
    for number, origin in enumerate(("unpacked", "unpacked/Toy_Set")):
        root = tmp_path / f"root{number}"
        done = fetch(toy("http://nowhere.invalid"), root, origin=str(tmp_path / origin))
        assert (done.folder / "deep/b.txt").read_bytes() == b"two\n"
    # As an archive unpacks at the root, it is taken as it is.
    assert fetch(toy("http://nowhere.invalid"), tmp_path / "unpacked").folder == tmp_path / "unpacked/Toy_Set"
    with pytest.raises(MissingDataError, match=r"holds neither toy\.zip nor a folder with a\.txt"):
        fetch(
            toy("http://nowhere.invalid"),
            tmp_path / "two",
            origin=str(tmp_path / "unpacked" / "Toy_Set" / "deep"),
        )
    with pytest.raises(MissingDataError, match="there is no such folder"):
        fetch(toy("http://nowhere.invalid"), tmp_path / "two", origin=str(tmp_path / "none"))
    with pytest.raises(UsageError, match="an address of http, https, ftp"):
        fetch(toy("http://nowhere.invalid"), tmp_path / "two", origin="s3://bucket")


def test_what_cannot_be_reached_is_one_line_with_what_to_do(tmp_path, monkeypatch):
    todo = r"download http://\S+/toy\.zip .*into a folder, then: slamcmp data fetch toy --from FOLDER"
    with http_mirror(Mirror({}, silent=True)) as mirror:
        for url, limits, why in (
            ("http://127.0.0.1:1", None, "no connection"),
            (mirror.url, Limits(1, 0.1), r"nothing came for 0\.1 s"),
        ):
            with pytest.raises(MissingDataError, match=f"{why}.*{todo}") as told:
                fetch(toy(url), tmp_path, limits=limits)
            assert "\n" not in str(told.value)
            assert told.value.exit_code == 3
        mirror.silent = False
        with pytest.raises(MissingDataError, match=f"the server says 404 Not Found.*{todo}"):
            fetch(toy(mirror.url), tmp_path)
        monkeypatch.setenv("http_proxy", "http://127.0.0.1:1")
        monkeypatch.setenv("no_proxy", "")
        with pytest.raises(MissingDataError, match=f"the proxy .* does not answer.*{todo}"):
            fetch(toy("http://toys.example"), tmp_path)
    by_hand = toy("", archives=(), how="register at https://toys.example and download toy.zip")
    with pytest.raises(
        MissingDataError, match=r"register at .* into a folder, then: slamcmp data fetch toy --from"
    ):
        fetch(by_hand, tmp_path)


def test_ftp_goes_on_too(tmp_path):
    rests: list[int] = []
    with ftp_server({"toy.zip": BYTES}, [700, 300], rests) as url:
        assert download(f"{url}/toy.zip", tmp_path, "toy.zip", sha256=SHA256).read_bytes() == BYTES
        assert rests == [0, 700, 1000]
        with pytest.raises(UnreachableError, match="the server says 550 no such file"):
            download(f"{url}/none.zip", tmp_path, "none.zip")
    with pytest.raises(UnreachableError, match="no connection"):
        download("ftp://127.0.0.1:1/toy.zip", tmp_path, "other.zip")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_full_disk_leaves_a_part_and_says_so(tmp_path, monkeypatch):
    with http_mirror(Mirror({"toy.zip": BYTES}, cut_after=[100_000, 0])) as mirror:
        with pytest.raises(UnreachableError):
            download(f"{mirror.url}/toy.zip", tmp_path, "toy.zip")
        usage = downloading.shutil.disk_usage(tmp_path)
        monkeypatch.setattr(downloading.shutil, "disk_usage", lambda path: usage._replace(free=10))
        with pytest.raises(
            StorageError, match=r"are still to come, and 1e-05 MB are free; toy\.zip\.part is kept"
        ):
            download(f"{mirror.url}/toy.zip", tmp_path, "toy.zip")
        monkeypatch.undo()
        assert download(f"{mirror.url}/toy.zip", tmp_path, "toy.zip", sha256=SHA256).read_bytes() == BYTES
        # One that fills up on the way, which no question foresees.
        (tmp_path / "more.zip.part").symlink_to("/dev/full")
        mirror.files["more.zip"] = BYTES
        with pytest.raises(StorageError, match=f"cannot write to .*{os.strerror(errno.ENOSPC)}"):
            download(f"{mirror.url}/more.zip", tmp_path, "more.zip")

        # And while unpacking: nothing half stands under the set's name.
        def full(*arguments, **named):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        monkeypatch.setattr("slamcmp.datasets.fetching.unpack.shutil.copyfileobj", full)
        with pytest.raises(StorageError, match=f"toy: cannot write below .*{os.strerror(errno.ENOSPC)}"):
            fetch(toy(mirror.url), tmp_path / "root")
        assert not (tmp_path / "root/toys").exists()


@pytest.mark.parametrize(
    "name", ["../out.txt", "/tmp/out.txt", "a/../../out.txt", "..\\out.txt", "C:\\out.txt"]
)
@pytest.mark.parametrize("kind", ["zip", "tar"])
def test_archives_that_lead_out_are_refused_before_anything_is_written(tmp_path, kind, name):
    archive = tmp_path / f"toy.{kind}"
    if kind == "zip":
        archive.write_bytes(zipped({"Toy_Set/a.txt": b"1", name: b"2"}))
    else:
        with tarfile.open(archive, "w") as opened:
            for member in ("Toy_Set/a.txt", name):
                opened.addfile(tarfile.TarInfo(member))
    with pytest.raises(DataError, match=r"refused, its member .* would lie outside of the folder"):
        unpack(archive, tmp_path / "inside" / "here")
    assert everything(tmp_path) == [archive.name]


def test_links_and_devices_in_archives_are_refused(tmp_path):
    for kind in (tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.CHRTYPE, tarfile.FIFOTYPE):
        with tarfile.open(tmp_path / "toy.tgz", "w:gz") as opened:
            member = tarfile.TarInfo("Toy_Set/link")
            member.type, member.linkname = kind, "/etc/passwd"
            opened.addfile(member)
        with pytest.raises(DataError, match="is a link or a device"):
            unpack(tmp_path / "toy.tgz", tmp_path / "inside")
    with zipfile.ZipFile(tmp_path / "toy.zip", "w") as archive:
        link = zipfile.ZipInfo("Toy_Set/link")
        link.external_attr = (stat.S_IFLNK | 0o777) << 16
        archive.writestr(link, "/etc/passwd")
    with pytest.raises(DataError, match="is a link"):
        unpack(tmp_path / "toy.zip", tmp_path / "inside")
    (tmp_path / "cut.zip").write_bytes(BYTES[:-200])
    (tmp_path / "cut.tgz").write_bytes(b"\x1f\x8b\x08\x00cut")
    for name in ("cut.zip", "cut.tgz"):
        with pytest.raises(DataError, match="no archive that can be read"):
            unpack(tmp_path / name, tmp_path / "inside")


def test_verify_sees_what_changed_since(tmp_path):
    with http_mirror(Mirror({"toy.zip": BYTES})) as mirror:
        data_set = toy(mirror.url)
        with pytest.raises(MissingDataError, match=r"toy: not found below .*; slamcmp data fetch toy"):
            verify(data_set, tmp_path)
        folder = fetch(data_set, tmp_path).folder
    assert verify(data_set, tmp_path).findings == []
    (folder / "a.txt").write_bytes(b"1\n")
    assert [f"{folder / 'a.txt'} has changed" in each for each in verify(data_set, tmp_path).findings] == [
        True
    ]
    (folder / "deep/b.txt").unlink()
    assert f"{folder / 'deep/b.txt'} is missing" in verify(data_set, tmp_path).findings
    # Not fetched by slamcmp: no more is claimed than was seen.
    (tmp_path / "own/toys").mkdir(parents=True)
    (tmp_path / "toy.zip").write_bytes(BYTES)
    unpack(tmp_path / "toy.zip", tmp_path / "own/toys")
    assert verify(data_set, tmp_path / "own").basis.startswith("its layout only")


# ---- the command ----
