"""Serves the rings over Foxglove's WebSocket protocol, by the Foxglove SDK.

Messages are those of the log: CDR behind ``ros2msg`` schemas, ``log_time`` the host's stamp. A viewer receives messages
written while it is connected. Each client has a queue of ``BACKLOG`` messages, which drops the oldest when full.
Viewers connect to a gate before the SDK (``onboard.live.gate``), which says who may, and disconnects who takes nothing
for ``STALL_S``.
"""

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import foxglove
import numpy as np

from drivers.records import Rows
from onboard.live.gate import Gate, any_loopback, only_from
from onboard.recording.format.schema import CDR_HEADER, message_bytes, message_name, ros2msg
from onboard.ring import RingReader

DEFAULT_ADDRESS = "127.0.0.1:8765"
BACKLOG = 2048  # messages for one client: nearly half a second of everything at 5 kHz
STALL_S = 5.0
_MOST_ROWS = 1024  # per ring and pass, so that every ring is served


def parse_address(text: str) -> tuple[str, int]:
    """Parse ``HOST:PORT``, ``HOST`` or ``:PORT``; missing parts come from :data:`DEFAULT_ADDRESS`.

    Raises:
        ValueError: not an address.
    """
    host, separator, port = text.rpartition(":") if ":" in text else (text, "", "")
    default_host, _, default_port = DEFAULT_ADDRESS.rpartition(":")
    if separator and not (port.isdigit() and int(port) < 65536):
        raise ValueError(f"--live {text}: write HOST:PORT, e.g. {DEFAULT_ADDRESS}")
    return host or default_host, int(port or default_port)


class LiveServer:
    """Serves the rings in a directory.

    Args:
        name: shown to clients.
        host: to bind to.
        port: to listen on; 0 takes any.
        stall_s: time without acknowledgement after which a client is disconnected.

    Raises:
        OSError: the address is not available.
        RuntimeError: the SDK's socket is not found.
    """

    def __init__(self, name: str, host: str, port: int, stall_s: float = STALL_S) -> None:
        self._context = foxglove.Context()
        self._server = foxglove.start_server(
            name=name, host="127.0.0.1", port=0, message_backlog_size=BACKLOG, context=self._context
        )
        address = any_loopback()
        try:
            _close_to_all_but(self._server.port, address)
            self._gate = Gate(host, port, self._server.port, address, stall_s)
        except (OSError, RuntimeError):
            self._server.stop()
            raise
        self._rings: dict[Path, tuple[RingReader, foxglove.Channel]] = {}
        self.sent = self.lost = 0

    @property
    def port(self) -> int:
        """Port it listens on."""
        return self._gate.port

    def pump(self, directory: Path) -> int:
        """Send the rows written to the rings in ``directory`` since the last call; returns the number of messages.

        Raises:
            OSError: a ring cannot be read.
        """
        self._discover(directory)
        count = 0
        for reader, channel in self._rings.values():
            rows, lost = reader.read(_MOST_ROWS)
            self.lost += lost
            for at_ns, message in messages(rows):
                channel.log(message, log_time=at_ns)
            count += len(rows)
        self.sent += count
        return count

    def close(self) -> None:
        """Stop listening and close the rings."""
        self._gate.close()
        self._server.stop()
        for reader, _ in self._rings.values():
            reader.close()
        self._rings = {}

    def _discover(self, directory: Path) -> None:
        for path in sorted(directory.glob("*.ring")):
            if path in self._rings:
                continue
            try:
                reader = RingReader(path)
            except (OSError, ValueError):
                continue  # ring under construction: retried in the next pass
            reader.position = reader.published
            text = ros2msg(reader.dtype)
            schema = foxglove.Schema(
                name=message_name(reader.name, reader.dtype), encoding="ros2msg", data=text.encode()
            )
            channel = foxglove.Channel(f"/{reader.name}", schema=schema, message_encoding="cdr", context=self._context)
            self._rings[path] = reader, channel


def _close_to_all_but(port: int, address: str) -> None:
    """Have the SDK's socket, which it does not show but which is among this process's files, take nobody but the gate.

    Raises:
        RuntimeError: it is not found.
    """
    for entry in Path("/proc/self/fd").iterdir():
        if not entry.is_socket():
            continue
        try:
            listening = socket.socket(fileno=os.dup(int(entry.name)))
        except OSError:
            continue  # closed by now
        with listening:
            if listening.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN) and listening.getsockname()[1] == port:
                only_from(listening, address)
                return
    raise RuntimeError(f"no listening socket seen on port {port}, so viewers cannot be checked")


def messages(rows: Rows) -> Iterator[tuple[int, bytes]]:
    """Stamp (ns) and CDR message of each row (n,), as in the log."""
    size, used = rows.dtype.itemsize, message_bytes(rows.dtype)
    data = np.ascontiguousarray(rows).tobytes()
    for number, at_ns in enumerate(rows["host_ns"].tolist()):
        yield at_ns, CDR_HEADER + data[number * size : number * size + used]
