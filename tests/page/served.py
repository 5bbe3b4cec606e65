"""A page server in a thread, and a client that speaks HTTP by the byte."""

import asyncio
import contextlib
import json
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from onboard.page import address as addresses
from onboard.page.web import Source, Web


class Reply(NamedTuple):
    status: int
    headers: dict[str, str]
    body: bytes


class Served:
    """A server that runs; ``call`` runs a function of it in its thread."""

    def __init__(self, web: Web, loop: asyncio.AbstractEventLoop, token: str) -> None:
        self.web, self.loop, self.port, self.token = web, loop, web.port, token

    def send(self, frame: dict[str, Any]) -> None:
        done = threading.Event()

        def offer() -> None:
            self.web.send(json.dumps(frame))
            done.set()

        self.loop.call_soon_threadsafe(offer)
        assert done.wait(20)


@contextlib.contextmanager
def served(
    source: Source, address: str = "127.0.0.1:0", token: str | None = None, plan: Any = None, urdf: Path | None = None
) -> Iterator[Served]:
    """The server while the context lasts."""
    loop, place = asyncio.new_event_loop(), addresses.parse(address)
    given = addresses.token_for(place) if token is None else token
    web = Web(source, place, given, plan or {}, urdf=urdf)
    loop.run_until_complete(web.start())
    thread = threading.Thread(target=loop.run_forever, daemon=True)
    thread.start()
    try:
        yield Served(web, loop, given)
    finally:
        asyncio.run_coroutine_threadsafe(web.close(), loop).result(20)
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()


def ask(port: int, path: str = "/", *lines: str, host: str = "", method: str = "GET", host_lines: int = 1) -> Reply:
    """One request with header ``lines``."""
    named = [f"Host: {host or f'127.0.0.1:{port}'}"] * host_lines
    head = "\r\n".join([f"{method} {path} HTTP/1.1", *named, *lines, "", ""])
    return raw(port, head.encode("latin-1"))


def raw(port: int, sent: bytes) -> Reply:
    """What comes back for ``sent``; status 0 where nothing does."""
    with socket.create_connection(("127.0.0.1", port), 20) as connection:
        connection.sendall(sent)
        got = b""
        with contextlib.suppress(ConnectionResetError):
            while block := connection.recv(1 << 16):
                got += block
    head, _, body = got.partition(b"\r\n\r\n")
    first, *rest = head.decode().split("\r\n")
    headers = dict(line.split(": ", 1) for line in rest)
    return Reply(int(first.split()[1]) if first else 0, headers, body)


class Stream:
    """Frames of a flight, as a viewer gets them."""

    def __init__(self, port: int, path: str = "/live", *, buffer: int | None = None) -> None:
        self.connection = socket.socket()
        if buffer is not None:
            self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer)
        self.connection.settimeout(20)
        self.connection.connect(("127.0.0.1", port))
        self.connection.sendall(f"GET {path} HTTP/1.1\r\nHost: localhost:{port}\r\n\r\n".encode())
        self._got = b""

    def head(self) -> bytes:
        """Until the empty line."""
        return self._until(b"\r\n\r\n")

    def frame(self) -> dict[str, Any]:
        """The next one.

        Raises:
            EOFError: the server closed.
        """
        while True:
            said = self._until(b"\n\n")
            if said.startswith(b"data: "):
                found: dict[str, Any] = json.loads(said.removeprefix(b"data: "))
                return found

    def _until(self, end: bytes) -> bytes:
        while end not in self._got:
            block = self.connection.recv(1 << 16)
            if not block:
                raise EOFError
            self._got += block
        said, _, self._got = self._got.partition(end)
        return said

    def close(self) -> None:
        self.connection.close()
