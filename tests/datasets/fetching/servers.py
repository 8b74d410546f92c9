"""Servers on this machine that behave as badly as those of the world: HTTP with parts and cuts, and FTP."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


@dataclass
class Mirror:
    """What the HTTP server has, and how it misbehaves."""

    files: dict[str, bytes]
    parts: bool = True
    """Whether it serves parts."""
    tag: str | None = '"one"'
    cut_after: list[int] = field(default_factory=list)
    """Bytes after which the next answers are cut off."""
    silent: bool = False
    asked: list[tuple[str, str | None]] = field(default_factory=list)
    """Paths and ranges."""
    url: str = ""


@contextmanager
def http_mirror(mirror: Mirror) -> Iterator[Mirror]:
    over = threading.Event()

    class Handler(BaseHTTPRequestHandler):
        def log_message(self, *arguments: object) -> None:
            pass

        def do_GET(self) -> None:
            wanted = self.headers.get("Range")
            mirror.asked.append((self.path, wanted))
            if mirror.silent:
                over.wait(5)
                return
            whole = mirror.files.get(self.path.strip("/"))
            if whole is None:
                self.send_error(404)
                return
            first = 0
            same = self.headers.get("If-Range") in (None, mirror.tag)
            if wanted and mirror.parts and same:
                first = int(wanted.removeprefix("bytes=").rstrip("-"))
                if first >= len(whole):
                    self.send_response(416)
                    self.send_header("Content-Range", f"bytes */{len(whole)}")
                    self.send_header("Content-Length", "0")
                    self.end_headers()
                    return
                self.send_response(206)
                self.send_header("Content-Range", f"bytes {first}-{len(whole) - 1}/{len(whole)}")
            else:
                self.send_response(200)
            if mirror.tag:
                self.send_header("ETag", mirror.tag)
            self.send_header("Content-Length", str(len(whole) - first))
            self.end_headers()
            body = whole[first:]
            self.wfile.write(body[: mirror.cut_after.pop(0)] if mirror.cut_after else body)

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    mirror.url = f"http://127.0.0.1:{server.server_address[1]}"
    try:
        yield mirror
    finally:
        over.set()
        server.shutdown()
        thread.join()
        server.server_close()


@contextmanager
def ftp_server(files: dict[str, bytes], cut_after: list[int], rests: list[int]) -> Iterator[str]:
    """As much of FTP as a download needs; appends to ``rests`` where each one began."""
    control = socket.create_server(("127.0.0.1", 0))

    def serve(client: socket.socket) -> None:
        data, rest = None, 0
        with client, client.makefile("rwb", buffering=0) as lines:
            lines.write(b"220 ready\r\n")
            for line in lines:
                verb, _, argument = line.decode().strip().partition(" ")
                name = argument.strip("/")
                if verb == "PASV":
                    data = socket.create_server(("127.0.0.1", 0))
                    port = data.getsockname()[1]
                    lines.write(f"227 at (127,0,0,1,{port // 256},{port % 256})\r\n".encode())
                elif verb == "EPSV":
                    lines.write(b"500 only PASV\r\n")
                elif verb == "SIZE" and name in files:
                    lines.write(f"213 {len(files[name])}\r\n".encode())
                elif verb == "REST":
                    rest = int(argument)
                    lines.write(b"350 go on\r\n")
                elif verb == "RETR" and name in files and data is not None:
                    rests.append(rest)
                    lines.write(b"150 it comes\r\n")
                    connection, _ = data.accept()
                    body = files[name][rest:]
                    with connection:
                        connection.sendall(body[: cut_after.pop(0)] if cut_after else body)
                    data.close()
                    rest = 0
                    lines.write(b"226 sent\r\n")
                elif verb in ("SIZE", "RETR"):
                    lines.write(b"550 no such file\r\n")
                elif verb == "QUIT":
                    lines.write(b"221 bye\r\n")
                    return
                else:
                    lines.write(b"230 well\r\n" if verb == "USER" else b"200 well\r\n")

    def accept() -> None:
        while True:
            try:
                client, _ = control.accept()
            except OSError:
                return
            threading.Thread(target=serve, args=(client,), daemon=True).start()

    thread = threading.Thread(target=accept, daemon=True)
    thread.start()
    try:
        yield f"ftp://127.0.0.1:{control.getsockname()[1]}"
    finally:
        control.shutdown(socket.SHUT_RDWR)
        control.close()
