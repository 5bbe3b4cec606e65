"""I2C ports: smbus2 over an ioctl of the test's own, and the socket protocol against a server of the test's own."""

import contextlib
import ctypes
import errno
import os
import socket
import struct
import threading

import pytest
import smbus2.smbus2

from drivers.mpu6050 import Mpu6050
from drivers.transports import open_i2c
from tests.drivers.batches import codes, of, texts, whole
from tests.drivers.mpu6050_model import MS, Mpu6050Model

I2C_FUNCS, I2C_RDWR = 0x0705, 0x0707  # linux/i2c-dev.h


class KernelMessage(ctypes.Structure):
    """struct i2c_msg of linux/i2c.h."""

    _fields_ = [
        ("addr", ctypes.c_uint16),
        ("flags", ctypes.c_uint16),
        ("len", ctypes.c_uint16),
        ("buf", ctypes.POINTER(ctypes.c_uint8)),
    ]


@pytest.fixture
def kernel(monkeypatch):
    """An i2c-dev node answered here: notes each I2C_RDWR as one list of messages."""
    calls = []
    kernel_fd = os.open(os.devnull, os.O_RDWR)
    real_open = os.open
    failure = {"errno": 0}

    def fake_open(path, flags, *more, **named):
        return os.dup(kernel_fd) if path == "/dev/i2c-77" else real_open(path, flags, *more, **named)

    def fake_ioctl(fd, request, argument=0):
        if request == I2C_FUNCS:
            return 0
        assert request == I2C_RDWR
        if failure["errno"]:
            raise OSError(failure["errno"], os.strerror(failure["errno"]))
        messages = ctypes.cast(argument.msgs, ctypes.POINTER(KernelMessage))
        call = []
        for place in range(argument.nmsgs):
            message = messages[place]
            if message.flags & 1:
                for byte in range(message.len):
                    message.buf[byte] = byte + 1 & 0xFF
                call.append((message.addr, "read", message.len))
            else:
                call.append((message.addr, "write", bytes(message.buf[: message.len])))
        calls.append(call)
        return 0

    monkeypatch.setattr(smbus2.smbus2.os, "open", fake_open)
    monkeypatch.setattr(smbus2.smbus2, "ioctl", fake_ioctl)
    yield calls, failure
    os.close(kernel_fd)


def test_a_write_and_its_read_are_one_transfer(kernel, clock):
    calls, _ = kernel
    port = open_i2c("i2c:///dev/i2c-77", clock)
    port.write(0x68, b"\x6b\x80")
    reply = port.write_read(0x68, b"\x74", 252)
    port.close()
    assert calls == [[(0x68, "write", b"\x6b\x80")], [(0x68, "write", b"\x74"), (0x68, "read", 252)]]
    assert reply.data == bytes(range(1, 253))
    assert reply.host_ns == clock()


@pytest.mark.parametrize("code", [errno.EREMOTEIO, errno.ETIMEDOUT])
def test_the_errno_of_the_kernel_comes_through(kernel, clock, code):
    _, failure = kernel
    port = open_i2c("i2c:///dev/i2c-77", clock)
    failure["errno"] = code
    for transfer in (lambda: port.write(0x68, b"\x6b\x80"), lambda: port.write_read(0x68, b"\x75", 1)):
        with pytest.raises(OSError, match=os.strerror(code)) as caught:
            transfer()
        assert caught.value.errno == code
    port.close()


# An adapter that is unplugged and comes back


def swapped(path):
    """The node is another file from now on: it was unplugged and plugged in."""
    other = path.with_suffix(".new")
    other.write_bytes(b"")
    other.rename(path)


@pytest.fixture
def plugged(kernel, monkeypatch, tmp_path, clock):
    """A port on a node that has a name in the file system; opens counted, file descriptors that are open known."""
    _, failure = kernel
    path = tmp_path / "i2c-5"
    path.write_bytes(b"")
    opened = []
    real_open = os.open

    def counting(name, flags, *more, **named):
        fd = real_open(name, flags, *more, **named)
        opened.append(fd)
        return fd

    monkeypatch.setattr(smbus2.smbus2.os, "open", counting)
    port = open_i2c(f"i2c://{path}", clock)
    yield port, path, failure, opened
    port.close()


def is_open(fd):
    try:
        os.fstat(fd)
    except OSError:
        return False
    return True


@pytest.mark.parametrize("code", [errno.ENODEV, errno.ESHUTDOWN])
def test_an_adapter_that_says_it_is_gone_is_opened_anew(plugged, code):
    port, _, failure, opened = plugged
    failure["errno"] = code
    with pytest.raises(OSError, match=os.strerror(code)) as caught:
        port.write_read(0x68, b"\x75", 1)
    assert caught.value.errno == code
    assert not is_open(opened[0]), "the dead node is given back at once"
    failure["errno"] = 0
    assert port.write_read(0x68, b"\x75", 1).data == b"\x01"
    assert (len(opened), port.reopened) == (2, 1)


def test_while_the_node_is_away_every_transfer_says_so_and_then_it_is_back(plugged):
    port, path, failure, opened = plugged
    path.unlink()
    failure["errno"] = errno.ENODEV
    codes = []
    for _ in range(4):
        with pytest.raises(OSError, match=r".") as caught:
            port.write(0x68, b"\x6b\x00")
        codes.append(caught.value.errno)
    assert codes == [errno.ENODEV, *[errno.ENOENT] * 3]
    path.write_bytes(b"")
    failure["errno"] = 0
    port.write(0x68, b"\x6b\x00")
    assert (len(opened), port.reopened) == (2, 1)


@pytest.mark.parametrize("code", [errno.ENXIO, errno.EIO, errno.EREMOTEIO, errno.ETIMEDOUT])
def test_an_error_of_the_device_keeps_the_node_and_one_of_a_swapped_adapter_does_not(plugged, code):
    port, path, failure, opened = plugged
    failure["errno"] = code
    for _ in range(3):
        with pytest.raises(OSError, match=r"."):
            port.write(0x68, b"\x6b\x00")
    assert len(opened) == 1, "nobody acknowledged: the adapter is there"
    swapped(path)
    with pytest.raises(OSError, match=r"."):
        port.write(0x68, b"\x6b\x00")
    failure["errno"] = 0
    port.write(0x68, b"\x6b\x00")
    assert (len(opened), port.reopened) == (2, 1)


def test_a_file_closed_under_us_is_opened_anew_and_its_number_left_alone(plugged):
    port, _, failure, opened = plugged
    os.close(opened[0])
    other = os.open(os.devnull, os.O_RDONLY)  # gets the number
    failure["errno"] = errno.EBADF
    with pytest.raises(OSError, match=r"."):
        port.write(0x68, b"\x6b\x00")
    failure["errno"] = 0
    port.write(0x68, b"\x6b\x00")
    assert is_open(other)
    assert port.reopened == 1
    os.close(other)


def test_a_node_that_is_no_i2c_bus_leaves_nothing_open(plugged, monkeypatch, clock):
    _, path, _, opened = plugged

    def no_functions(fd, request, argument=0):
        raise OSError(errno.ENOTTY, os.strerror(errno.ENOTTY))

    monkeypatch.setattr(smbus2.smbus2, "ioctl", no_functions)
    with pytest.raises(OSError, match="ioctl"):
        open_i2c(f"i2c://{path}", clock)
    assert not is_open(opened[-1])


def test_the_driver_flies_on_when_its_adapter_is_back(monkeypatch, clock, tmp_path):
    """The retries of the device are what reopens the port: nothing else has to know."""
    chip = Mpu6050Model(clock)
    path = tmp_path / "i2c-5"
    path.write_bytes(b"")
    away = [False]

    def ioctl(fd, request, argument=0):
        if request == I2C_FUNCS:
            return 0
        if away[0]:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
        messages = ctypes.cast(argument.msgs, ctypes.POINTER(KernelMessage))
        data = bytes(messages[0].buf[: messages[0].len])
        if argument.nmsgs == 1:
            chip.write(messages[0].addr, data)
            return 0
        reply = chip.write_read(messages[0].addr, data, messages[1].len).data
        for place, byte in enumerate(reply):
            messages[1].buf[place] = byte
        return 0

    monkeypatch.setattr(smbus2.smbus2, "ioctl", ioctl)
    port = open_i2c(f"i2c://{path}", clock)
    device = Mpu6050("imu", port)
    batches = device.start(clock())

    def fly(polls):
        made = []
        for _ in range(polls):
            clock.advance(10 * MS)
            made += device.pump(clock())
        return made

    batches += fly(100)
    away[0] = True
    path.unlink()
    batches += fly(100)
    away[0] = False
    path.write_bytes(b"")
    batches += fly(200)
    batches += device.stop(clock())
    port.close()
    rows = whole(batches, "imu")
    assert codes(batches).count("bus_recovered") == 1
    assert "plug it in" in texts(batches, "bus_error")[0]
    assert [gap["cause"] for gap in of(batches, "gap")] == [b"bus_error"]
    assert rows["tick"][-1] == chip.written - 1
    assert port.reopened == 1


class Server:
    """The other side of ``i2c+unix``: answers each request by ``answer(op, address, data, count)``; None: hangs up."""

    def __init__(self, path, answer):
        self.listening = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.listening.bind(str(path))
        self.listening.listen()
        self.answer = answer
        self.thread = threading.Thread(target=self._serve, daemon=True)
        self.thread.start()

    def _serve(self):
        while True:
            try:
                connection, _ = self.listening.accept()
            except OSError:
                return
            with connection:
                while (head := connection.recv(6, socket.MSG_WAITALL)) and len(head) == 6:
                    operation, address, length, count = struct.unpack("<BBHH", head)
                    data = connection.recv(length, socket.MSG_WAITALL) if length else b""
                    reply = self.answer(operation, address, data, count)
                    if reply is None:
                        break
                    with contextlib.suppress(ConnectionError):  # the client may have given up
                        for byte in reply:  # in pieces: a stream has no frames
                            connection.sendall(bytes([byte]))

    def close(self):
        self.listening.shutdown(socket.SHUT_RDWR)
        self.listening.close()
        self.thread.join()


@pytest.fixture
def served(tmp_path, clock):
    """A function that serves ``answer`` and gives the port."""
    servers, ports = [], []

    def serve(answer, timeout_s=5.0):
        path = tmp_path / "i2c.sock"
        servers.append(Server(path, answer))
        ports.append(open_i2c(f"i2c+unix://{path}?timeout_s={timeout_s}", clock))
        return ports[-1]

    yield serve
    for port in ports:
        port.close()
    for server in servers:
        server.close()


def test_the_socket_protocol(served, clock):
    requests = []

    def answer(*request):
        requests.append(request)
        return struct.pack("<HH", 0, request[3]) + bytes(range(request[3]))

    port = served(answer)
    port.write(0x68, b"\x6b\x01")
    reply = port.write_read(0x69, b"\x72", 5)
    assert requests == [(0, 0x68, b"\x6b\x01", 0), (1, 0x69, b"\x72", 5)]
    assert reply == (bytes(range(5)), clock())


def test_an_errno_of_the_other_side_keeps_the_connection(served):
    answers = [struct.pack("<HH", errno.EREMOTEIO, 0), struct.pack("<HH", 0, 1) + b"\x68"]
    port = served(lambda *request: answers.pop(0))
    with pytest.raises(OSError, match="Remote I/O") as caught:
        port.write_read(0x68, b"\x75", 1)
    assert caught.value.errno == errno.EREMOTEIO
    assert port.write_read(0x68, b"\x75", 1).data == b"\x68"


def test_a_reply_of_another_length_is_no_data(served):
    port = served(lambda *request: struct.pack("<HH", 0, 2) + b"ab")
    with pytest.raises(OSError, match="2 bytes where 3") as caught:
        port.write_read(0x68, b"\x75", 3)
    assert caught.value.errno == errno.EPROTO


def test_after_a_timeout_or_a_hang_up_it_connects_anew(served):
    late = threading.Event()
    answers = [None, struct.pack("<HH", 0, 1) + b"\x99", struct.pack("<HH", 0, 1) + b"\x68"]

    def answer(*request):
        if len(answers) == 2:
            late.wait(5.0)  # what comes after the client gave up must not answer its next request
        return answers.pop(0)

    port = served(answer, timeout_s=0.05)
    codes = []
    for _ in range(2):
        with pytest.raises(OSError, match=r".") as caught:
            port.write_read(0x68, b"\x75", 1)
        codes.append(caught.value.errno)
    assert codes == [errno.ECONNRESET, errno.ETIMEDOUT]
    late.set()
    assert port.write_read(0x68, b"\x75", 1).data == b"\x68"


def test_a_server_that_is_not_there_yet_is_an_absent_device(tmp_path, clock):
    port = open_i2c(f"i2c+unix://{tmp_path / 'late.sock'}", clock)
    with pytest.raises(FileNotFoundError):
        port.write(0x68, b"\x6b\x01")
    server = Server(tmp_path / "late.sock", lambda *request: struct.pack("<HH", 0, 0))
    port.write(0x68, b"\x6b\x01")
    port.close()
    server.close()
