"""The live server against clients that speak the protocol: who reads gets everything, who does not is dropped."""

import asyncio
import contextlib
import json
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap_ros2._dynamic import generate_dynamic
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed

from drivers import records
from onboard.flight.store import directories, manifest
from onboard.live import process
from onboard.live.server import LiveServer, parse_address
from onboard.recording.segmented import Preamble
from onboard.ring import RingReader, RingWriter

PROTOCOL = "foxglove.sdk.v1"
MESSAGE = struct.Struct("<BIQ")  # opcode 1, subscription, log time


def rows(first: int, count: int, dtype: np.dtype[np.void] = records.SCALAR) -> np.ndarray:
    made = np.zeros(count, dtype)
    made["sequence"] = np.arange(first, first + count)
    made["host_ns"] = 1_000_000_000 + made["sequence"].astype(np.int64) * 1000
    if dtype == records.SCALAR:
        made["value_raw"] = made["sequence"].astype(np.int64) * 7
        made["unit"] = b"rad"
    return made


@contextlib.asynccontextmanager
async def subscribed(port: int, **options: Any) -> AsyncIterator[tuple[ClientConnection, dict[str, Any]]]:
    """A client that has asked for the first channel that was announced, and that channel."""
    async with connect(f"ws://127.0.0.1:{port}", subprotocols=[PROTOCOL], max_size=None, **options) as client:
        channel: dict[str, Any] | None = None
        while channel is None:
            said = json.loads(await asyncio.wait_for(client.recv(), 20))
            if said["op"] == "advertise":
                [channel] = said["channels"]
        await client.send(request(channel))
        yield client, channel


def request(channel: dict[str, Any]) -> str:
    return json.dumps({"op": "subscribe", "subscriptions": [{"id": 1, "channelId": channel["id"]}]})


async def everything(connection: ClientConnection) -> None:
    until = time.monotonic() + 10
    while time.monotonic() < until:
        await asyncio.wait_for(connection.recv(), 20)


class Pump(threading.Thread):
    """Writes rows into a ring and has the server send them, as the flight and its viewer do."""

    def __init__(self, server: LiveServer, directory: Path, dtype: np.dtype[np.void], count: int) -> None:
        super().__init__(daemon=True)
        self._server, self._directory, self._dtype, self._count = server, directory, dtype, count
        self._writer = RingWriter(directory / "joint.ring", dtype, 16 * count)
        self.over = threading.Event()
        self.pushed, self.slowest_s = 0, 0.0
        server.pump(directory)

    def run(self) -> None:
        while not self.over.is_set():
            self._writer.push(rows(self.pushed, self._count, self._dtype))
            self.pushed += self._count
            started = time.monotonic()
            self._server.pump(self._directory)
            self.slowest_s = max(self.slowest_s, time.monotonic() - started)
            time.sleep(0.01)


@pytest.mark.realtime
def test_a_client_gets_every_row_as_the_log_would_have_it(tmp_path: Path) -> None:
    server = LiveServer("test", "127.0.0.1", 0)
    pump = Pump(server, tmp_path, records.SCALAR, 10)

    async def client() -> None:
        async with subscribed(server.port) as (connection, channel):
            decode = generate_dynamic(channel["schemaName"], channel["schema"])[channel["schemaName"]]
            for _ in range(200):
                message = await asyncio.wait_for(connection.recv(), 20)
                assert isinstance(message, bytes)
                opcode, subscription, log_time = MESSAGE.unpack_from(message)
                assert (opcode, subscription) == (1, 1)
                decoded = decode(message[MESSAGE.size :])
                assert decoded.value_raw == 7 * decoded.sequence
                assert log_time == decoded.host_ns
                numbers.append(decoded.sequence)

    numbers: list[int] = []
    pump.start()
    try:
        asyncio.run(client())
    finally:
        pump.over.set()
        pump.join()
        server.close()
    assert numbers == list(range(numbers[0], numbers[0] + 200))


@pytest.mark.realtime
def test_a_stalled_client_is_dropped_and_nobody_waits_for_it(tmp_path: Path) -> None:
    server = LiveServer("test", "127.0.0.1", 0, stall_s=1.0)
    pump = Pump(server, tmp_path, records.EVENT, 500)  # 240 bytes each, 10 MB/s: more than a socket can hold

    async def stalled() -> None:
        narrow = socket.socket()
        narrow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 8192)
        narrow.connect(("127.0.0.1", server.port))
        narrow.setblocking(False)
        async with subscribed(server.port, sock=narrow, max_queue=1, ping_interval=None) as (connection, _):
            connection.transport.pause_reading()
            await asyncio.sleep(6)
            connection.transport.resume_reading()
            with pytest.raises(ConnectionClosed):
                await everything(connection)

    async def reader() -> int:
        got = 0
        until = time.monotonic() + 5
        async with subscribed(server.port) as (connection, _):
            while time.monotonic() < until:
                await asyncio.wait_for(connection.recv(), 10)  # it is never kept waiting
                got += 1
        return got

    async def both() -> int:
        _, got = await asyncio.gather(stalled(), reader())
        return got

    pump.start()
    try:
        got = asyncio.run(both())
    finally:
        pump.over.set()
        pump.join()
        server.close()
    assert got > 1000
    assert pump.pushed > 20_000
    assert server.lost == 0  # the rings were read as fast as they were written
    assert pump.slowest_s < 5.0


def test_it_only_reads_and_starts_with_what_is_new(tmp_path: Path) -> None:
    writer = RingWriter(tmp_path / "joint.ring", records.SCALAR, 100)
    writer.push(rows(0, 50))
    server = LiveServer("test", "127.0.0.1", 0)
    try:
        assert server.pump(tmp_path) == 0
        before = (tmp_path / "joint.ring").read_bytes()
        assert server.pump(tmp_path) == 0
        assert (tmp_path / "joint.ring").read_bytes() == before
        writer.push(rows(50, 7))
        assert server.pump(tmp_path) == 7
        writer.push(rows(57, 150))
        server.pump(tmp_path)
        assert server.lost == 50  # reported, and only the viewer's loss: another reader has what the ring has
        assert len(RingReader(tmp_path / "joint.ring").read()[0]) == 100
    finally:
        server.close()


def test_a_ring_that_is_just_being_made_is_waited_for(tmp_path: Path) -> None:
    (tmp_path / "half.ring").write_bytes(b"")
    server = LiveServer("test", "127.0.0.1", 0)
    try:
        assert server.pump(tmp_path) == 0
    finally:
        server.close()


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("127.0.0.1:8765", ("127.0.0.1", 8765)),
        ("0.0.0.0:9000", ("0.0.0.0", 9000)),
        (":9000", ("127.0.0.1", 9000)),
        ("groundstation", ("groundstation", 8765)),
    ],
)
def test_addresses(text: str, address: tuple[str, int]) -> None:
    assert parse_address(text) == address


@pytest.mark.parametrize("text", ["host:port", "host:70000", "host:"])
def test_what_is_no_address(text: str) -> None:
    with pytest.raises(ValueError, match="write HOST:PORT"):
        parse_address(text)


def test_an_address_that_is_taken_is_refused_before_the_flight(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(ValueError, match="give another address"), process.serving(tmp_path / "x.mcap", address):
            pytest.fail("it said it serves")


@pytest.mark.realtime
def test_the_process_finds_its_flight_and_goes_with_it(tmp_path: Path) -> None:
    log = tmp_path / "flight.mcap"
    with manifest.new_flight(log, "test-live") as directory:
        pass
    storage = manifest.Storage(1, 1, 1, 0)
    about = manifest.Manifest(directory, log, "rocksat", storage, Preamble("test-live", (), {}))
    writer = RingWriter(directory / "joint.ring", records.SCALAR, 10_000)
    command = [sys.executable, "-m", "onboard.live", str(log), "127.0.0.1:0"]
    try:
        with directories.belong(directory):
            about.save()
            server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
            assert server.stdout is not None
            ready, port = server.stdout.readline().split()
            assert ready == "ready"

            async def client() -> None:
                async with subscribed(int(port)) as (connection, channel):
                    assert channel["topic"] == "/joint"
                    for first in range(0, 500, 5):  # a channel that was only just made may not be known at once
                        writer.push(rows(first, 5))
                        await asyncio.sleep(0.1)
                        with contextlib.suppress(TimeoutError):
                            if isinstance(await asyncio.wait_for(connection.recv(), 1), bytes):
                                return
                        await connection.send(request(channel))
                pytest.fail("no message came")

            asyncio.run(client())
        assert server.wait(20) == 0
        server.stdout.close()
    finally:
        about.remove()
