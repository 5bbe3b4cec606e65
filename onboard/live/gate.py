"""The listening socket of the live server: who may connect, how much they may send, how slowly they may read.

The SDK that speaks to viewers checks none of this. It listens on a port of the loopback interface that only this gate
can reach, and the gate hands bytes on in both directions. It refuses, by HTTP status: a web page of another host, told
by its Origin (403), which a browser would let read the flight; a Host that is a foreign name (403), which DNS can have
point here; a request that is too long or too slow (400); more than ``MOST_CLIENTS`` (503). It disconnects a viewer that
sends a long message or many, and one that takes nothing for ``stall_s``.

Viewers offer the subprotocol by its new name, ``foxglove.sdk.v1``, or by its old one, ``foxglove.websocket.v1``: their
messages are the same (github.com/orgs/foxglove/discussions/1131), and the SDK knows the new name only. The gate asks it
by that, and answers a viewer by the name that this one offered. Without either it refuses (400).
"""

import asyncio
import contextlib
import ctypes
import ipaddress
import re
import secrets
import socket
import struct
import threading

from onboard.live.heads import LOCAL, fields, host_of, is_ours

MOST_CLIENTS = 8
LONGEST_REQUEST = 8192  # bytes
REQUEST_S = 5.0
LONGEST_MESSAGE = 1 << 16  # bytes, of what a viewer sends: a list of subscriptions
MOST_BYTES_S, MOST_MESSAGES_S = 1 << 18, 200.0
WEB_VIEWERS = ("app.foxglove.dev", "lichtblick-suite.github.io")  # pages that a viewer on this computer may come from
_BLOCK = 1 << 16
_SO_ATTACH_FILTER = 26  # asm-generic/socket.h
NEW, OLD = b"foxglove.sdk.v1", b"foxglove.websocket.v1"  # names of the subprotocol


class Gate:
    """Accepts viewers for a server behind it, in a thread of its own.

    Args:
        host: to bind to.
        port: to listen on; 0 takes any.
        behind: the server's port on 127.0.0.1.
        address: of the loopback interface, that connections to the server are made from.
        stall_s: time in which a viewer must take something.

    Raises:
        OSError: the address is not available.
    """

    def __init__(self, host: str, port: int, behind: int, address: str, stall_s: float) -> None:
        self._behind, self._address, self._stall_s = behind, address, stall_s
        self._serving: set[asyncio.Task[None] | None] = set()  # else one that waits can be collected
        self._loop = asyncio.new_event_loop()
        try:
            self._server = self._loop.run_until_complete(
                asyncio.start_server(self._serve, host, port, limit=LONGEST_REQUEST, backlog=2 * MOST_CLIENTS)
            )
        except OSError:
            self._loop.close()
            raise
        self.port: int = self._server.sockets[0].getsockname()[1]
        self._thread = threading.Thread(target=self._loop.run_forever, name="gate", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop listening and end all connections."""
        asyncio.run_coroutine_threadsafe(self._end(), self._loop).result(10.0)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    async def _end(self) -> None:
        self._server.close()
        while tasks := asyncio.all_tasks() - {asyncio.current_task()}:  # also those that begin or swallow it meanwhile
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks, timeout=0.1)
        for _ in range(3):
            await asyncio.sleep(0)  # what was aborted is closed in the loop's next turns

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._serving.add(task := asyncio.current_task())
        try:
            refused, request = await _request(reader, len(self._serving))
            if refused:
                writer.write(f"HTTP/1.1 {refused}\r\nConnection: close\r\nContent-Length: 0\r\n\r\n".encode())
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(writer.drain(), REQUEST_S)
                return
            await self._pass_on(request, reader, writer)
        except (OSError, asyncio.IncompleteReadError):
            return  # it went, or the server behind did
        except asyncio.CancelledError:
            writer.transport.abort()
            raise
        finally:
            self._serving.discard(task)
            writer.close()

    async def _pass_on(self, request: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.transport.set_write_buffer_limits(high=_BLOCK)
        inward, outward = await asyncio.open_connection(
            "127.0.0.1", self._behind, local_addr=(self._address, 0), limit=_BLOCK
        )
        older = NEW not in request
        outward.write(request.replace(OLD, NEW) if older else request)
        if older:
            writer.write((await inward.readuntil(b"\r\n\r\n")).replace(NEW, OLD))
        tasks = [
            asyncio.ensure_future(_to_server(reader, outward)),
            asyncio.ensure_future(_to_viewer(inward, writer, self._stall_s)),
        ]
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        finally:
            for task in tasks:
                task.cancel()
            outward.transport.abort()  # a close would wait for a server that takes nothing more
            await asyncio.gather(*tasks, return_exceptions=True)


async def _request(reader: asyncio.StreamReader, clients: int) -> tuple[str, bytes]:
    """Why a viewer is refused (empty: it is not), and its request."""
    try:
        request = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), REQUEST_S)
    except (TimeoutError, asyncio.LimitOverrunError):
        return "400 Bad Request", b""
    if clients > MOST_CLIENTS:
        return "503 Too Many Viewers", b""
    lines = request.decode("latin-1").split("\r\n")
    headers = fields(lines[1:])
    hosts, origins = headers.get("host", []), headers.get("origin", [])
    if not re.fullmatch(r"GET \S+ HTTP/1\.1", lines[0]) or len(hosts) != 1 or len(origins) > 1:
        return "400 Bad Request", b""
    host = host_of(f"//{hosts[0]}")
    if host is None or not is_ours(host):
        return "403 Forbidden Host", b""
    if origins and not allowed(origins[0], host):
        return "403 Forbidden Origin", b""
    offered = {name.strip() for line in headers.get("sec-websocket-protocol", []) for name in line.split(",")}
    known = (NEW.decode(), OLD.decode())
    return "" if offered.intersection(known) else f"400 Offer Subprotocol {known[0]} Or {known[1]}", request


def allowed(origin: str, host: str) -> bool:
    """Whether pages of ``origin`` may watch: of this computer, of the host they reach it by, or of a viewer's maker."""
    scheme, separator, _ = origin.partition("://")
    named = host_of(origin)
    if scheme == "file" and separator:
        return True  # a desktop application; a page in a browser says null
    if named is None or scheme not in ("http", "https"):
        return False
    return named in LOCAL or named == host or (scheme == "https" and named in WEB_VIEWERS)


async def _to_viewer(inward: asyncio.StreamReader, writer: asyncio.StreamWriter, stall_s: float) -> None:
    while block := await inward.read(_BLOCK):
        writer.write(block)
        try:
            await asyncio.wait_for(writer.drain(), stall_s)
        except TimeoutError:
            writer.transport.abort()
            return


async def _to_server(reader: asyncio.StreamReader, outward: asyncio.StreamWriter) -> None:
    """Frames (RFC 6455, section 5.2) one by one, so that none is long; too many end the connection."""
    clock = asyncio.get_running_loop().time
    allowance = Allowance(clock())
    length = 0  # of the message whose frames are coming
    while True:
        head = await reader.readexactly(2)
        size = head[1] & 0x7F
        if size >= 126:
            more = await reader.readexactly(2 if size == 126 else 8)
            head, size = head + more, int.from_bytes(more, "big")
        length = size if head[0] & 0x0F else length + size  # opcode 0: it goes on
        if length > LONGEST_MESSAGE or not allowance.take(clock(), size):
            return
        mask = 4 if head[1] & 0x80 else 0
        outward.write(head + await reader.readexactly(mask + size))
        await outward.drain()


class Allowance:
    """Messages and bytes that may come: so many a second, and those of two seconds at once."""

    def __init__(self, now_s: float) -> None:
        self._at_s = now_s
        self._messages, self._bytes = 2 * MOST_MESSAGES_S, 2.0 * MOST_BYTES_S

    def take(self, now_s: float, size: int) -> bool:
        """Whether a frame of ``size`` bytes may come."""
        since_s, self._at_s = now_s - self._at_s, now_s
        self._messages = min(self._messages + since_s * MOST_MESSAGES_S, 2 * MOST_MESSAGES_S) - 1.0
        self._bytes = min(self._bytes + since_s * MOST_BYTES_S, 2.0 * MOST_BYTES_S) - size
        return self._messages >= 0.0 and self._bytes >= 0.0


def any_loopback() -> str:
    """An address of this computer that nobody guesses and no browser connects from."""
    return str(ipaddress.IPv4Address("127.1.0.0") + secrets.randbelow(250 << 16) + 1)


def only_from(listening: socket.socket, address: str) -> None:
    """Have the kernel drop what comes to a listening TCP socket, and to connections of it, from another address.

    A socket filter of four instructions (linux/filter.h): load the IPv4 source address, compare, take all or nothing.
    """
    source_address = 0xFFF00000 + 12  # SKF_NET_OFF, and the offset in the header of RFC 791
    program = struct.pack(
        "=" + 4 * "HBBI",
        *(0x20, 0, 0, source_address),
        *(0x15, 0, 1, int(ipaddress.IPv4Address(address))),
        *(0x06, 0, 0, 0xFFFFFFFF),
        *(0x06, 0, 0, 0),
    )
    memory = ctypes.create_string_buffer(program, len(program))
    listening.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, struct.pack("HL", 4, ctypes.addressof(memory)))
