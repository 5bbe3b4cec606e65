"""The page's server: files, frames of a log, and a flight's frames as server-sent events.

All in one thread. A viewer of a flight has a small buffer: while it holds something, frames are left out and counted,
and one that takes nothing for ``stall_s`` is disconnected.
"""

import asyncio
import contextlib
import socket
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol
from urllib.parse import parse_qs

from onboard.page.acts import Acts
from onboard.page.address import ACT, LONGEST_REQUEST, NOT_FOUND, PageAddress, Request, judge
from onboard.page.follow import packed
from onboard.page.meshes import meshes_of
from onboard.page.state import PageState

MOST_VIEWERS = 40  # of a flight's frames at once
MOST_CONNECTIONS = 700
REQUEST_S, STALL_S = 5.0, 15.0
_QUIET_TURNS = 20
_SEND_BUFFER = 1 << 15  # bytes: what a slow viewer may be behind
_TYPES = {"html": "text/html", "css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}
HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class Source(Protocol):
    """What is shown."""

    state: PageState
    live: bool
    urdf: bytes

    def about(self) -> dict[str, Any]:
        """What the page needs once."""


class _Viewer:
    """Of a flight: what it was sent and what it was not."""

    def __init__(self, writer: asyncio.StreamWriter, now_s: float, since: int) -> None:
        self.writer, self.taken_s, self.since = writer, now_s, since
        self.skipped = 0
        self._waiting = 0

    def offer(self, frame: str, state: PageState, now_s: float) -> bool:
        """Send ``frame`` and the events since the last, if the viewer has taken what was sent; False: it stalls."""
        waiting = self.writer.transport.get_write_buffer_size()
        if waiting == 0 or waiting < self._waiting:
            self.taken_s = now_s
        self._waiting = waiting
        if waiting:
            self.skipped += 1
            return now_s - self.taken_s < STALL_S
        events = packed(state.events(self.since))
        self.writer.write(f'data: {frame[:-1]},"skipped":{self.skipped},"events":{events}}}\n\n'.encode())
        self.since = state.event_count
        self._waiting = self.writer.transport.get_write_buffer_size()
        return True


class Web:
    """Serves ``source`` until it is closed.

    Args:
        source: a flight or a log.
        address: to bind to.
        token: that paths begin with; empty: none.
        plan: expected intervals by quantity, see :func:`onboard.page.process.read`.
        acts: what can be done through the page; None: nothing.
        urdf: file of the vehicle, beside which its meshes lie; that of the source, without files, where not given.
    """

    def __init__(
        self,
        source: Source,
        address: PageAddress,
        token: str,
        plan: Mapping[str, dict[str, Any]] = MappingProxyType({}),
        acts: Acts | None = None,
        urdf: Path | None = None,
    ) -> None:
        self.source, self._plan, self._acts, self._urdf = source, plan, acts, urdf
        self._meshes: asyncio.Task[bytes] | None = None
        self.port = 0
        self._address, self._token = address, token
        self._viewers: set[_Viewer] = set()
        self._tasks: set[asyncio.Task[None]] = set()
        self._server: asyncio.Server | None = None
        self._files = _static()

    async def start(self) -> None:
        """Listen.

        Raises:
            OSError: the address is not available.
        """
        listening = _bound(self._address)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)  # connections have it from here
        self._server = await asyncio.start_server(self._serve, sock=listening, limit=LONGEST_REQUEST, backlog=512)
        self.port = listening.getsockname()[1]

    @property
    def viewers(self) -> int:
        """Number of viewers of a flight."""
        return len(self._viewers)

    def send(self, frame: str) -> None:
        """Offer a frame (a JSON object) to all viewers; never waits."""
        now_s = asyncio.get_running_loop().time()
        for viewer in list(self._viewers):
            if viewer.writer.is_closing() or not viewer.offer(frame, self.source.state, now_s):
                self._viewers.discard(viewer)
                viewer.writer.transport.abort()

    async def close(self) -> None:
        """Stop listening; viewers have a moment to take their last frame."""
        loop = asyncio.get_running_loop()
        if self._server is not None:
            loop.remove_reader(self._server.sockets[0].fileno())  # a connection that asyncio is taking as its server
            for _ in range(_QUIET_TURNS):  # closes is leaked, so none is taken from here on
                await asyncio.sleep(0)
            self._server.close()
        until_s = loop.time() + 1.0
        while loop.time() < until_s and any(one.writer.transport.get_write_buffer_size() for one in self._viewers):
            await asyncio.sleep(0.02)
        turns = 0  # without a task: connections that are being taken have theirs some turns later
        while turns < _QUIET_TURNS:
            turns += 1
            await asyncio.sleep(0)
            if self._tasks:
                turns = 0
                for task in self._tasks:
                    task.cancel()
                await asyncio.wait(self._tasks, timeout=0.1)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        try:
            if len(self._tasks) > MOST_CONNECTIONS:
                writer.transport.abort()
                return
            request = await self._request(reader)
            if request is not None:
                await self._answer(request, reader, writer)
        except (OSError, asyncio.CancelledError, asyncio.IncompleteReadError):
            pass  # it went, or takes nothing, or the server closes
        finally:
            self._tasks.discard(task)
            if writer.transport.get_write_buffer_size():
                writer.transport.abort()  # a close would wait for who takes nothing
            writer.close()

    async def _request(self, reader: asyncio.StreamReader) -> Request | None:
        try:
            head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), REQUEST_S)
        except (TimeoutError, asyncio.IncompleteReadError):
            return None
        except asyncio.LimitOverrunError:
            return Request("", refused="431 Request Header Fields Too Large")
        return judge(head.removesuffix(b"\r\n\r\n"), self._address, self._token, acts=self._acts is not None)

    async def _answer(self, request: Request, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        name = request.path.removeprefix("/") or "index.html"
        if request.refused:
            await _reply(writer, request.refused, "text/plain", request.refused.encode())
        elif name in self._files:
            await _reply(writer, "200 OK", _TYPES[name.rpartition(".")[2]], self._files[name])
        elif name == "flight":
            acts = [] if self._acts is None else self._acts.armed
            more = {"plan": dict(self._plan), "acts": acts, "meshes": self._has_meshes}
            await _reply(writer, "200 OK", "application/json", packed(self.source.about() | more).encode())
        elif name == ACT and self._acts is not None and request.body is not None:
            body = await asyncio.wait_for(reader.readexactly(request.body), REQUEST_S)
            status, said = await self._acts.do(body)
            await _reply(writer, status, "application/json", packed({"said": said}).encode())
        elif name == "meshes" and self._has_meshes:
            if self._meshes is None:  # read once, in a thread: the others do not wait
                self._meshes = asyncio.create_task(asyncio.to_thread(_meshes, self._urdf, self.source.urdf))
            await _reply(writer, "200 OK", "application/json", await asyncio.shield(self._meshes))
        elif name == "signals":
            await _reply(writer, "200 OK", "application/json", self._signals(request.query))
        elif name == "live" and self.source.live:
            await self._stream(request, reader, writer)
        elif (frame := self._frame(name)) is not None:
            await _reply(writer, "200 OK", "application/json", frame)
        else:
            await _reply(writer, NOT_FOUND, "text/plain", NOT_FOUND.encode())

    @property
    def _has_meshes(self) -> bool:
        return self._urdf is not None or bool(self.source.urdf)

    def _signals(self, query: str) -> bytes:
        """Names of all signals, and the steps of one from a time on: ``signals?name=imu_0+rate&since=12.5`` (s)."""
        state, asked = self.source.state, parse_qs(query)
        name, since = asked.get("name", [""])[0], asked.get("since", [""])[0]
        found: dict[str, Any] = {"names": state.signals.names(), "signal": None}
        with contextlib.suppress(KeyError, ValueError):
            found["signal"] = state.signals.of(name, state.start_ns or 0, float(since or "-inf"))
        return packed(found).encode()

    def _frame(self, name: str) -> bytes | None:
        """Of a log, by ``frame/NUMBER``."""
        room, _, number = name.partition("/")
        find = getattr(self.source, "frame", None)
        if room != "frame" or find is None or not (number.isascii() and number.isdigit() and len(number) < 9):
            return None
        try:
            found: bytes = find(int(number))
        except IndexError:
            return None
        return found

    async def _stream(self, request: Request, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if len(self._viewers) >= MOST_VIEWERS:
            await _reply(writer, "503 Too Many Viewers", "text/plain", b"503 Too Many Viewers")
            return
        since = request.query.removeprefix("since=")
        number = int(since) if since.isascii() and since.isdigit() and len(since) < 15 else 0
        viewer = _Viewer(writer, asyncio.get_running_loop().time(), number)
        writer.write(_head("200 OK", "text/event-stream", None) + b"retry: 2000\n\n")
        self._viewers.add(viewer)
        try:
            await reader.read(1)  # until it goes; a viewer has nothing to say
        finally:
            self._viewers.discard(viewer)


def _meshes(given: Path | None, urdf: bytes) -> bytes:
    """Of the file that is given, or of the source's own."""
    with contextlib.suppress(OSError):  # the source's is drawn
        if given is not None:
            return packed(meshes_of(given.read_bytes(), given.parent)._asdict()).encode()
    return packed(meshes_of(urdf, None)._asdict()).encode()


def _static() -> dict[str, bytes]:
    """The page's files by name; colours and type are those of the reports."""
    room = files("onboard.page").joinpath("static")
    found = {one.name: one.read_bytes() for one in room.iterdir() if one.name.rpartition(".")[2] in _TYPES}
    found["theme.css"] = files("onboard.ground.drawing").joinpath("page.css").read_bytes()
    return found


def _bound(address: PageAddress) -> socket.socket:
    """A socket on ``address``; on any port where that was not asked for and is taken."""
    found = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    family, kind, protocol, _, place = found[0]
    listening = socket.socket(family, kind, protocol)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind(place)
        except OSError:
            if address.fixed:
                raise
            listening.bind((place[0], 0, *place[2:]))
    except OSError:
        listening.close()
        raise
    return listening


def _head(status: str, kind: str, length: int | None) -> bytes:
    told = {"Content-Type": f"{kind}; charset=utf-8", "Connection": "close", **HEADERS}
    if length is not None:
        told["Content-Length"] = str(length)
    return (
        f"HTTP/1.1 {status}\r\n" + "".join(f"{name}: {value}\r\n" for name, value in told.items()) + "\r\n"
    ).encode()


async def _reply(writer: asyncio.StreamWriter, status: str, kind: str, body: bytes) -> None:
    writer.transport.set_write_buffer_limits(high=0)  # else a small rest would be waited for by nobody
    writer.write(_head(status, kind, len(body)) + body)
    await asyncio.wait_for(writer.drain(), STALL_S)
