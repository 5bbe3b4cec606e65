"""The gate before the live server, attacked: pages of other hosts, rebound names, floods, long messages, crowds."""

import asyncio
import json
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.typing import Origin

from drivers import records
from onboard.live import gate
from onboard.live.server import LiveServer
from onboard.ring import RingWriter

PROTOCOL = "foxglove.sdk.v1"


@pytest.fixture
def server(caplog: pytest.LogCaptureFixture) -> Iterator[LiveServer]:
    caplog.set_level("CRITICAL", logger="foxglove")  # as the process has it
    made = LiveServer("test", "127.0.0.1", 0, stall_s=2.0)
    yield made
    made.close()


def status(
    server: LiveServer, origin: str | None = None, host: str | None = None, protocols: tuple[str, ...] = (PROTOCOL,)
) -> int:
    """Of a viewer's request: 101 where it is let in."""

    async def ask() -> int:
        port = server.port
        url = f"ws://{host or '127.0.0.1'}:{port}"
        try:
            async with connect(
                url,
                origin=None if origin is None else Origin(origin),
                subprotocols=list(protocols) or None,  # type: ignore[arg-type]
                host="127.0.0.1",
                port=port,
            ) as client:
                assert client.subprotocol in protocols
                assert json.loads(await asyncio.wait_for(client.recv(), 20))["op"] == "serverInfo"
        except InvalidStatus as error:
            return error.response.status_code
        return 101

    return asyncio.run(ask())


@pytest.mark.parametrize(
    "origin", [None, "http://localhost:8080", "http://127.0.0.1", "https://app.foxglove.dev", "file://"]
)
def test_viewers_are_let_in(server: LiveServer, origin: str | None) -> None:
    assert status(server, origin) == 101


@pytest.mark.parametrize(
    ("protocols", "expected"),
    [
        ((PROTOCOL,), 101),
        (("foxglove.websocket.v1",), 101),
        (("other", "foxglove.websocket.v1"), 101),
        (("foxglove.websocket.v1", PROTOCOL), 101),
        ((), 400),
        (("other",), 400),
    ],
)
def test_both_names_of_the_protocol_are_understood(
    server: LiveServer, protocols: tuple[str, ...], expected: int
) -> None:
    assert status(server, protocols=protocols) == expected


@pytest.mark.parametrize(
    "origin",
    [
        "https://evil.example",
        "null",
        "http://app.foxglove.dev",  # not encrypted: anybody on the way could be it
        "https://app.foxglove.dev.evil.example",
        "https://localhost.evil.example",
        "https://evil.example/?localhost",
        "https://localhost@evil.example",
        "http://[::1",
        "chrome-extension://abc",
    ],
)
def test_pages_of_other_hosts_are_not(server: LiveServer, origin: str) -> None:
    assert status(server, origin) == 403


def test_a_name_that_was_made_to_point_here_is_no_way_in(server: LiveServer) -> None:
    assert status(server, "http://evil.example", host="evil.example") == 403  # the page and the host agree
    assert status(server, None, host="evil.example") == 403
    assert status(server, "http://localhost", host="localhost") == 101


def test_the_server_behind_cannot_be_reached_but_through_the_gate(server: LiveServer) -> None:
    behind = server._server.port
    with socket.socket() as direct:
        direct.settimeout(1.0)
        with pytest.raises(TimeoutError):
            direct.connect(("127.0.0.1", behind))
    assert status(server) == 101


@pytest.mark.parametrize(
    "request_",
    [
        b"GET / HTTP/1.1\r\nHost: a\r\n" + b"X: " + bytes(100_000),
        b"\x16\x03\x01" + bytes(200) + b"\r\n\r\n",
        b"POST / HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"GET / HTTP/1.1\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: localhost\r\nOrigin: http://localhost\r\nOrigin: https://evil.example\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: [::1\r\n\r\n",
    ],
)
def test_what_is_no_request_is_refused(server: LiveServer, request_: bytes) -> None:
    with socket.create_connection(("127.0.0.1", server.port)) as client:
        client.settimeout(10.0)
        try:
            client.sendall(request_)
            answer = client.recv(100)
        except ConnectionResetError:  # it was cut off while it was still sending
            answer = b"HTTP/1.1 400"
    assert answer.startswith((b"HTTP/1.1 400", b"HTTP/1.1 403"))
    assert status(server) == 101


def test_one_viewer_too_many(server: LiveServer) -> None:
    async def crowd() -> None:
        url = f"ws://127.0.0.1:{server.port}"
        clients = [await connect(url, subprotocols=[PROTOCOL]) for _ in range(gate.MOST_CLIENTS)]  # type: ignore[list-item]
        with pytest.raises(InvalidStatus, match="503"):
            await connect(url, subprotocols=[PROTOCOL])  # type: ignore[list-item]
        for client in clients:
            await client.close()

    asyncio.run(crowd())
    for _ in range(100):  # they are gone a moment later
        if status(server) == 101:
            return
        time.sleep(0.05)
    pytest.fail("nobody is let in any more")


async def sends(server: LiveServer, messages: list[str], pause_s: float = 0.0) -> bool:
    """Whether a viewer that sends so is still connected."""
    url = f"ws://127.0.0.1:{server.port}"
    async with connect(url, subprotocols=[PROTOCOL], max_size=None, max_queue=None) as client:  # type: ignore[list-item]
        try:
            for message in messages:
                await client.send(message)
                await asyncio.sleep(pause_s)
            await asyncio.sleep(0.3)
            await asyncio.wait_for(await client.ping(), 5)
        except (ConnectionClosed, TimeoutError):
            return False
        return True


SUBSCRIBE = json.dumps({"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 1}]})


def test_a_flood_and_a_long_message_end_the_connection(server: LiveServer) -> None:
    assert asyncio.run(sends(server, [SUBSCRIBE] * 20, 0.01))
    assert not asyncio.run(sends(server, ["x" * (gate.LONGEST_MESSAGE + 1)]))
    assert not asyncio.run(sends(server, [SUBSCRIBE] * 5000))
    assert not asyncio.run(sends(server, ["y" * 60_000] * 100))
    assert status(server) == 101


def test_a_message_in_pieces_is_no_longer_than_one(server: LiveServer) -> None:
    async def pieces(count: int) -> bool:
        url = f"ws://127.0.0.1:{server.port}"
        async with connect(url, subprotocols=[PROTOCOL], max_size=None, max_queue=None) as client:  # type: ignore[list-item]
            try:
                await client.send(["z" * 30_000] * count)
                await asyncio.wait_for(await client.ping(), 5)
            except (ConnectionClosed, TimeoutError):
                return False
            return True

    assert asyncio.run(pieces(2))
    assert not asyncio.run(pieces(4))


def test_an_allowance_is_of_two_seconds() -> None:
    allowance = gate.Allowance(0.0)
    assert all(allowance.take(0.0, 1) for _ in range(2 * int(gate.MOST_MESSAGES_S)))
    assert not allowance.take(0.0, 1)
    assert allowance.take(1.0, 1)
    assert not gate.Allowance(0.0).take(0.0, 2 * gate.MOST_BYTES_S + 1)


def test_silence_is_no_request(server: LiveServer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate, "REQUEST_S", 0.2)
    with socket.create_connection(("127.0.0.1", server.port)) as client:
        client.settimeout(10.0)
        assert client.recv(100).startswith(b"HTTP/1.1 400")


def test_the_pump_never_waits_for_a_viewer(server: LiveServer, tmp_path: Path) -> None:
    writer = RingWriter(tmp_path / "joint.ring", records.EVENT, 5000)
    server.pump(tmp_path)
    with socket.create_connection(("127.0.0.1", server.port)) as silent:  # half a request, and then nothing
        silent.sendall(b"GET / HTTP/1.1\r\n")
        rows = records.event(0, records.Severity.INFO, "x", "y", "z").rows.repeat(1000)
        for _ in range(20):
            writer.push(rows)
            assert server.pump(tmp_path) == 1000
