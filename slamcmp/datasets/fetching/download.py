"""One file from its address, going on where an earlier attempt ended.

pooch keeps what has the right checksum and throws away what has not; how the bytes come is ours: what has
arrived stays beside the file, under its name and ``.part``, and the next attempt asks for the rest. A server
that does not serve parts, or whose file has changed since (its ETag or date is kept too), is asked for the
whole.
"""

from __future__ import annotations

import contextlib
import errno
import ftplib
import logging
import shutil
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from slamcmp.errors import DataError, SlamcmpError, StorageError, UsageError

SCHEMES = ("http", "https", "ftp")
CONNECT_S, SILENT_S = 15.0, 60.0
"""Until a server must have answered, and how long it may then send nothing."""
ATTEMPTS = 3
"""In one call, while bytes still come in between."""
_CHUNK = 1 << 14
"""Bytes; what is begun of one when the connection is cut is lost."""

Progress = Callable[[int, int | None], None]
"""Bytes that are there, and of how many (None where the server does not say)."""


class UnreachableError(SlamcmpError):
    """The file did not come: no connection, a refusal, a cut; what came is kept."""

    exit_code = 3


@dataclass(frozen=True)
class Limits:
    """How long to wait for a server [s]."""

    connect: float = CONNECT_S
    silent: float = SILENT_S


def download(
    url: str,
    folder: Path,
    file_name: str,
    *,
    sha256: str | None = None,
    progress: Progress | None = None,
    limits: Limits | None = None,
) -> Path:
    """The file in ``folder``, checked where its checksum is known; one that is there already is taken.

    Raises:
        UnreachableError: it did not come, or not whole; what came stays and is gone on from.
        DataError: it has another checksum; nothing of it is kept.
        StorageError: the disk is full or the folder cannot be written; what came stays.
        UsageError: an address of another kind than http, https and ftp.
    """
    import pooch

    if urlsplit(url).scheme not in SCHEMES:
        raise UsageError(f"{url}: an address begins with one of {', '.join(SCHEMES)}")
    # It announces each file on its own.
    pooch.get_logger().setLevel(logging.WARNING)
    transfer = _Transfer(folder / f"{file_name}.part", progress, limits or Limits())
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return Path(
            pooch.retrieve(
                url,
                known_hash=None if sha256 is None else f"sha256:{sha256}",
                fname=file_name,
                path=folder,
                downloader=transfer,
            )
        )
    except ValueError as error:
        if "hash" not in str(error).lower():
            raise
        raise DataError(
            f"{url}: what came does not have the checksum {sha256} (sha256); it was thrown away: a damaged "
            "or another file"
        ) from error
    except OSError as error:
        raise _no_room(folder, transfer.part, error) from error


class _Transfer:
    """What pooch calls for the bytes of an address."""

    def __init__(self, part: Path, progress: Progress | None, limits: Limits) -> None:
        self.part = part
        self.tag = part.with_name(f"{part.name}.tag")
        self._progress = progress
        self._limits = limits

    def __call__(self, url: str, output_file: Any, pooch: Any, check_only: bool = False) -> None:  # noqa: ARG002
        get = self._ftp if urlsplit(url).scheme == "ftp" else self._http
        for attempt in range(1, ATTEMPTS + 1):
            before = self._size()
            try:
                get(url)
                break
            except UnreachableError:
                # A server that sends nothing more will not next time either.
                if attempt == ATTEMPTS or self._size() == before:
                    raise
        self.part.replace(output_file)
        self.tag.unlink(missing_ok=True)

    def _size(self) -> int:
        return self.part.stat().st_size if self.part.is_file() else 0

    def _write(self, chunks: Iterable[bytes], start: int, total: int | None) -> None:
        """Append to (``start`` 0: write anew) the part."""
        if total is not None and self.part.parent.is_dir():
            free = shutil.disk_usage(self.part.parent).free
            if total - start > free:
                raise OSError(
                    errno.ENOSPC, f"{_mb(total - start)} are still to come, and {_mb(free)} are free"
                )
        done = start
        with self.part.open("ab" if start else "wb") as file:
            for chunk in chunks:
                file.write(chunk)
                done += len(chunk)
                if self._progress is not None:
                    self._progress(done, total)

    def _http(self, url: str) -> None:
        import requests

        start = self._size()
        # Compressed on the way, a part would not be a part of the file.
        headers = {"Accept-Encoding": "identity", "User-Agent": "slamcmp"}
        if start:
            headers["Range"] = f"bytes={start}-"
            with contextlib.suppress(OSError):
                headers["If-Range"] = self.tag.read_text(encoding="utf-8")
        try:
            with requests.get(
                url, headers=headers, stream=True, timeout=(self._limits.connect, self._limits.silent)
            ) as answer:
                if answer.status_code == requests.codes.requested_range_not_satisfiable and start:
                    if answer.headers.get("Content-Range") == f"bytes */{start}":
                        return
                    # The part is no part of the file as it is now.
                    self.part.unlink()
                    raise UnreachableError(f"{url}: another file than the one begun; it is begun anew")
                answer.raise_for_status()
                if answer.status_code != requests.codes.partial_content or not _begins_at(answer, start):
                    start = 0
                total = _total(answer, start)
                tag = answer.headers.get("ETag") or answer.headers.get("Last-Modified")
                # A weak tag does not promise equal bytes.
                if tag and not tag.startswith("W/"):
                    self.tag.write_text(tag, encoding="utf-8")
                else:
                    self.tag.unlink(missing_ok=True)
                self._write(answer.iter_content(_CHUNK), start, total)
        except requests.RequestException as error:
            raise UnreachableError(f"{url}: {_why(error, self._limits)}{self._so_far()}") from error
        if total is not None and self._size() != total:
            raise UnreachableError(f"{url}: cut off{self._so_far()}")

    def _ftp(self, url: str) -> None:
        address = urlsplit(url)
        start = self._size()
        path = unquote(address.path)
        total: int | None = None
        try:
            with ftplib.FTP(timeout=self._limits.connect) as server:
                server.connect(address.hostname or "", address.port or ftplib.FTP_PORT)
                server.login(address.username or "", address.password or "")
                server.voidcmd("TYPE I")
                with contextlib.suppress(ftplib.error_perm):
                    total = server.size(path)
                if total is not None and start > total:
                    start = 0
                if total is None or start < total or start == 0:
                    with server.transfercmd(f"RETR {path}", rest=start or None) as connection:
                        connection.settimeout(self._limits.silent)
                        self._write(iter(lambda: connection.recv(_CHUNK), b""), start, total)
                    server.voidresp()
        except (ftplib.Error, EOFError, TimeoutError, ConnectionError) as error:
            raise UnreachableError(f"{url}: {_why(error, self._limits)}{self._so_far()}") from error
        except OSError as error:
            # What has no number of the disk's is the network's: an unknown host, no route.
            if error.errno in _OF_THE_DISK:
                raise
            raise UnreachableError(f"{url}: {_why(error, self._limits)}{self._so_far()}") from error
        if total is not None and self._size() != total:
            raise UnreachableError(f"{url}: cut off{self._so_far()}")

    def _so_far(self) -> str:
        size = self._size()
        return f" after {_mb(size)}, which are kept: the same command goes on from there" if size else ""


_OF_THE_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EACCES, errno.EROFS, errno.EIO, errno.EFBIG, errno.EISDIR)


def _begins_at(answer: Any, start: int) -> bool:
    """Whether a partial answer begins where it was asked to."""
    return str(answer.headers.get("Content-Range", "")).startswith(f"bytes {start}-")


def _total(answer: Any, start: int) -> int | None:
    length = answer.headers.get("Content-Length", "")
    return start + int(length) if length.isdigit() else None


def _why(error: Exception, limits: Limits) -> str:
    """The reason in words; what libraries say of it are whole objects."""
    import requests

    if isinstance(error, requests.HTTPError) and error.response is not None:
        return f"the server says {error.response.status_code} {error.response.reason}".rstrip()
    if isinstance(error, requests.exceptions.ProxyError):
        return "the proxy (HTTP_PROXY, HTTPS_PROXY) does not answer or refuses"
    if isinstance(error, requests.ConnectTimeout):
        return f"no answer within {limits.connect:g} s"
    if isinstance(error, requests.Timeout | TimeoutError):
        return f"nothing came for {limits.silent:g} s"
    if isinstance(error, requests.exceptions.SSLError):
        return "its certificate could not be checked"
    if isinstance(error, requests.exceptions.ChunkedEncodingError):
        return "cut off"
    if isinstance(error, requests.ConnectionError):
        return "nothing came for too long" if "Read timed out" in str(error) else "no connection"
    if isinstance(error, ftplib.Error):
        return f"the server says {error}"
    if isinstance(error, EOFError):
        return "cut off"
    if isinstance(error, OSError):
        return f"no connection ({error.strerror or error})"
    return f"no address that can be asked ({type(error).__name__})"


def _no_room(folder: Path, part: Path, error: OSError) -> StorageError:
    kept = f"; {part.name} is kept, and the same command goes on from there" if part.is_file() else ""
    return StorageError(f"cannot write to {folder}: {error.strerror or error}{kept}")


def _mb(size: int) -> str:
    return f"{size / 1e6:.3g} MB"
