"""The I2C bus on a socket: transfers, what they take, errors, clients that leave."""

import contextlib
import errno
import socket
import struct

import pytest

from hil_sim.buses.i2c_socket import I2cSocket
from hil_sim.buses.media import I2cBus
from hil_sim.devices.mpu6050.chip import Mpu6050Twin
from tests.hil_sim.devices.twin_bench import MS, START_NS, FlatImu, RateClock


class SocketBench:
    def __init__(self, directory, bit_rate=400_000):
        self.bus = I2cBus()
        self.chip = Mpu6050Twin(FlatImu([0x0102] * 7), RateClock(), START_NS)
        self.bus.add(self.chip)
        path = directory / "i2c.sock"
        self.server = I2cSocket(path, self.bus, bit_rate)
        self.client = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.client.connect(str(path))
        self.client.setblocking(False)
        self.now_ns = START_NS

    def send(self, operation, address, write=b"", count=0):
        self.client.sendall(struct.pack("<BBHH", operation, address, len(write), count) + write)

    def reply_after(self, ns):
        self.now_ns += ns
        self.server.advance(self.now_ns)
        try:
            reply = self.client.recv(65536)
        except BlockingIOError:
            return None
        code, count = struct.unpack_from("<HH", reply)
        assert len(reply) == 4 + count
        return code, reply[4:]

    def close(self):
        self.client.close()
        self.server.close()


@pytest.fixture
def wires(tmp_path):
    bench = SocketBench(tmp_path)
    yield bench
    bench.close()


def test_write_and_write_read(wires):
    wires.send(1, 0x68, b"\x75", 1)
    assert wires.reply_after(0) is None
    assert wires.reply_after(1 * MS) == (0, b"\x68")
    wires.send(0, 0x68, b"\x19\x07")
    wires.reply_after(0)
    assert wires.reply_after(1 * MS) == (0, b"")
    wires.send(1, 0x68, b"\x19", 1)
    wires.reply_after(0)
    assert wires.reply_after(1 * MS) == (0, b"\x07")


def test_a_reply_takes_as_long_as_the_wires_would(wires):
    wires.send(1, 0x68, b"\x3b", 14)
    assert wires.reply_after(0) is None
    assert 350_000 < wires.server.due_ns - wires.now_ns < 420_000  # 14 bytes at 400 kHz
    assert wires.reply_after(wires.server.due_ns - wires.now_ns - 1) is None
    assert wires.reply_after(1) == (0, bytes(14))


def test_errors_are_the_errno(wires):
    wires.send(1, 0x69, b"\x75", 1)
    wires.reply_after(0)
    assert wires.reply_after(MS) == (errno.EREMOTEIO, b"")
    wires.send(7, 0x68)
    assert wires.reply_after(0) == (errno.EINVAL, b"")


def test_requests_in_pieces_and_in_a_row(wires):
    request = struct.pack("<BBHH", 1, 0x68, 1, 1) + b"\x75"
    for byte in request:
        wires.client.sendall(bytes([byte]))
        assert wires.reply_after(0) is None
    assert wires.reply_after(MS) == (0, b"\x68")
    wires.client.sendall(request * 3)
    wires.reply_after(0)
    wires.now_ns += MS
    wires.server.advance(wires.now_ns)
    assert wires.client.recv(64) == b"\x00\x00\x01\x00\x68" * 3


def test_one_transfer_is_on_the_wires_at_a_time(wires, tmp_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as other:
        other.connect(str(tmp_path / "i2c.sock"))
        request = struct.pack("<BBHH", 1, 0x68, 1, 14) + b"\x3b"
        wires.client.sendall(request)
        other.sendall(request)
        wires.server.advance(wires.now_ns)
        first = wires.server.due_ns - wires.now_ns
        wires.server.advance(wires.now_ns + first)
        assert wires.server.due_ns - wires.now_ns == 2 * first


def test_a_client_may_leave_and_another_come(wires, tmp_path):
    wires.send(1, 0x68, b"\x75", 1)
    wires.client.close()
    wires.server.advance(wires.now_ns)
    wires.server.advance(wires.now_ns + MS)
    assert wires.server.clients == 0
    wires.client = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    wires.client.connect(str(tmp_path / "i2c.sock"))
    wires.client.setblocking(False)
    wires.send(1, 0x68, b"\x75", 1)
    wires.reply_after(0)
    assert wires.reply_after(2 * MS) == (0, b"\x68")


def test_a_client_that_takes_no_replies_is_left(wires):
    request = struct.pack("<BBHH", 1, 0x68, 1, 8000) + b"\x74"
    for _ in range(200):
        with contextlib.suppress(BrokenPipeError):
            wires.client.sendall(request)
        wires.now_ns += 1_000 * MS
        wires.server.advance(wires.now_ns)
        wires.server.advance(wires.now_ns + 200 * MS)
    assert wires.server.clients == 0
