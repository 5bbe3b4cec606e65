"""SPI ports: spidev over an ioctl of the test's own; the simulated node and socket with a chip that answers."""

import ctypes
import errno
import fcntl
import os
import threading
import time

import pytest

from drivers.errors import UrlError
from drivers.transports import open_spi
from hil_sim.buses.in_process import in_process
from hil_sim.buses.spi import SpiBus, install_spi
from hil_sim.faults import Fault, FaultError, FaultPlan
from hil_sim.scenario import bus_tables
from hil_sim.serve import SpiSocketPort
from tests.conftest import VirtualClock

MODE, SPEED = 0x40016B01, 0x40046B04  # linux/spi/spidev.h


class KernelTransfer(ctypes.Structure):
    """struct spi_ioc_transfer of linux/spi/spidev.h."""

    _fields_ = (
        *(("tx_buf", ctypes.c_uint64), ("rx_buf", ctypes.c_uint64), ("len", ctypes.c_uint32)),
        *(("speed_hz", ctypes.c_uint32), ("delay_usecs", ctypes.c_uint16), ("bits_per_word", ctypes.c_uint8)),
        *(("cs_change", ctypes.c_uint8), ("tx_nbits", ctypes.c_uint8), ("rx_nbits", ctypes.c_uint8)),
        *(("word_delay_usecs", ctypes.c_uint8), ("pad", ctypes.c_uint8)),
    )


@pytest.fixture
def kernel(monkeypatch, tmp_path):
    """A node answered here, byte by byte with its complement; what it was asked, and the errno that it fails with."""
    calls, failure = [], {"errno": 0}
    node = tmp_path / "spidev0.0"
    node.touch()

    def fake_ioctl(fd, request, argument):
        if failure["errno"]:
            raise OSError(failure["errno"], os.strerror(failure["errno"]))
        if request in (MODE, SPEED):
            calls.append((request, int.from_bytes(argument, "little")))
            return 0
        assert request & 0xC000FFFF == 0x40006B00
        size = request >> 16 & 0x3FFF
        assert size % 32 == 0
        frames = (KernelTransfer * (size // 32)).from_buffer_copy(argument)
        assert [frame.cs_change for frame in frames] == [1] * (len(frames) - 1) + [0]
        for frame in frames:
            data = ctypes.string_at(frame.tx_buf, frame.len)
            calls.append(data)
            ctypes.memmove(frame.rx_buf, bytes(byte ^ 0xFF for byte in data), frame.len)
        return 0

    monkeypatch.setattr(fcntl, "ioctl", fake_ioctl)
    return node, calls, failure


def test_frames_of_a_transfer_are_one_call_with_the_chip_deselected_between(kernel):
    node, calls, _ = kernel
    clock = VirtualClock()
    port = open_spi(f"spi://{node}?speed=2000000", clock, 1)
    reply = port.transfer(b"\x01\x02\x03\x04\x05\x06", 2)
    assert calls == [(MODE, 1), (SPEED, 2_000_000), b"\x01\x02", b"\x03\x04", b"\x05\x06"]
    assert reply == (b"\xfe\xfd\xfc\xfb\xfa\xf9", clock())
    port.close()


def test_a_node_that_fails_is_opened_again(kernel):
    node, calls, failure = kernel
    clock = VirtualClock()
    port = open_spi(f"spi://{node}", clock, 1)
    failure["errno"] = errno.ENODEV
    for _ in range(2):
        with pytest.raises(OSError, match=r"\w+") as raised:
            port.transfer(b"ab", 2)
        assert raised.value.errno == errno.ENODEV
    clock.advance(1_000_000_000)
    with pytest.raises(OSError, match="gone"):  # its mode cannot be set
        port.transfer(b"ab", 2)
    failure["errno"] = 0
    clock.advance(1_000_000_000)
    assert port.transfer(b"ab", 2).data == b"\x9e\x9d"
    assert calls.count((MODE, 1)) == 2
    port.close()


def test_no_node_and_no_such_url(tmp_path):
    with pytest.raises(FileNotFoundError):
        open_spi(f"spi://{tmp_path}/spidev9.9", VirtualClock(), 1)
    with pytest.raises(UrlError):
        open_spi("spi:///dev/spidev0.0?mode=1", VirtualClock(), 1)
    with pytest.raises(UrlError, match="one select line: add"):
        open_spi("spi:///dev/spidev0.0", VirtualClock(), 1, second=True)
    with pytest.raises(UrlError, match="no path"):
        open_spi("spi:///dev/spidev0.0?second=spidev0.1", VirtualClock(), 1, second=True)


class Echo:
    """A chip that answers with the frame before."""

    mode = 1

    def __init__(self) -> None:
        self.frames = [b"\0\0"]

    def advance(self, now_ns: int) -> None:
        pass

    def exchange(self, frame: bytes, now_ns: int) -> bytes:
        self.frames.append(frame)
        return self.frames[-2]


def test_the_simulated_node_answers_spidev_and_leaves_others_alone(tmp_path):
    clock, bus, node = VirtualClock(), SpiBus(), tmp_path / "bus.spidev"
    real = fcntl.ioctl
    start_ns = clock()
    uninstall = install_spi(node, bus, clock)
    assert open_spi(f"spi://{node}", clock, 0).transfer(b"abcd", 2).data == bytes(4)  # no chip drives the line
    bus.add(Echo())
    with pytest.raises(ValueError, match="select line"):
        bus.add(Echo())
    with pytest.raises(OSError, match="Invalid"):
        open_spi(f"spi://{node}", clock, 0)
    port = open_spi(f"spi://{node}", clock, 1)
    assert port.transfer(b"abcd", 2).data == b"\0\0ab"
    assert port.transfer(b"ef", 2).data == b"cd"
    assert bus.frames == 5
    bus.inject(FaultPlan([Fault("unplug", "bus", 1.0, 2.0)], start_ns).of("bus"))
    clock.advance(1_500_000_000)
    with pytest.raises(OSError, match="No such device"):
        port.transfer(b"ef", 2)
    clock.advance(1_000_000_000)
    assert port.transfer(b"gh", 2).data == b"ef"
    with open(os.devnull, "rb") as other, pytest.raises(OSError, match="Inappropriate"):
        fcntl.ioctl(other.fileno(), MODE, b"\1")
    with pytest.raises(FaultError):
        bus.inject(FaultPlan([Fault("nack", "bus", 1.0, 2.0)], start_ns).of("bus"))
    port.close()
    uninstall()
    assert fcntl.ioctl is real
    assert not node.exists()


class Pair:
    """A chip with two select lines."""

    def __init__(self) -> None:
        self.dies = Echo(), Echo()


def test_a_chip_of_two_dies_has_two_nodes_that_go_together(tmp_path):
    clock = VirtualClock()
    start_ns = clock()
    with in_process({"one": bus_tables.SpiBusTable(kind="spi")}, tmp_path, clock) as ports:
        bus = ports.buses["one"]
        bus.add(Pair())
        lines = [open_spi(ports.urls["one"], clock, 1, second=second) for second in (False, True)]
        assert [line.transfer(data, 2).data for line, data in zip(lines, (b"ab", b"cd"), strict=True)] == [b"\0\0"] * 2
        assert [line.transfer(b"ef", 2).data for line in lines] == [b"ab", b"cd"]
        bus.inject(FaultPlan([Fault("unplug", "bus", 1.0, 2.0)], start_ns).of("bus"))
        clock.advance(1_500_000_000)
        for line in lines:
            with pytest.raises(OSError, match="No such device"):
                line.transfer(b"ef", 2)
    with pytest.raises(ValueError, match="select line"):
        SpiBus().add(Pair())


def test_a_simulator_over_a_socket(tmp_path):
    served = SpiSocketPort(tmp_path / "spi.sock")
    served.bus.add(Pair())
    done = threading.Event()

    def serve():
        while not done.is_set():
            served.advance(time.monotonic_ns())
            time.sleep(1e-4)

    thread = threading.Thread(target=serve)
    thread.start()
    port = open_spi(served.url, time.monotonic_ns, 1)
    try:
        assert port.transfer(b"abcdef", 2).data == b"\0\0abcd"
        with pytest.raises(OSError, match="Invalid"):
            port.transfer(b"abc", 2)
        other = open_spi(served.url, time.monotonic_ns, 1, second=True)
        assert other.transfer(b"ghij", 2).data == b"\0\0gh"
        other.close()
        assert served.counts() == {"frames": 5}
    finally:
        done.set()
        thread.join()
        port.close()
        served.close()
