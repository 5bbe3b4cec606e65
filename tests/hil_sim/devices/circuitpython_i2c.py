"""A ``busio.I2C`` of CircuitPython on an smbus2 bus, for libraries that were written for it."""

from adafruit_blinka import Lockable
from smbus2 import SMBus, i2c_msg

from tests.hil_sim.devices.twin_bench import START_NS


class SlowBusClock:
    """A clock on which a transfer takes its time; ``sleep`` and ``monotonic`` may stand for the library's."""

    def __init__(self, transfer_ns: int, start_ns: int = START_NS) -> None:
        self.transfer_ns, self.now_ns = transfer_ns, start_ns

    def __call__(self) -> int:
        self.now_ns += self.transfer_ns
        return self.now_ns

    def sleep(self, seconds: float) -> None:
        self.now_ns += round(seconds * 1e9)

    def monotonic(self) -> float:
        return self.now_ns * 1e-9


class SmbusI2c(Lockable):
    """Transfers as the ``busio.I2C`` documentation describes them, each one I2C_RDWR of smbus2.

    Args:
        bus: An open ``SMBus``.
    """

    def __init__(self, bus: SMBus) -> None:
        self._bus = bus

    def writeto(self, address, buffer, *, start=0, end=None):
        """START, address+W, bytes, STOP; no bytes at all is a probe, which smbus2 calls a quick write."""
        data = bytes(buffer)[start:end]
        if data:
            self._bus.i2c_rdwr(i2c_msg.write(address, data))
        else:
            self._bus.write_quick(address)

    def readfrom_into(self, address, buffer, *, start=0, end=None):
        """START, address+R, bytes, STOP."""
        part = memoryview(buffer)[start:end]
        reading = i2c_msg.read(address, len(part))
        self._bus.i2c_rdwr(reading)
        part[:] = bytes(reading)

    def writeto_then_readfrom(
        self, address, out_buffer, in_buffer, *, out_start=0, out_end=None, in_start=0, in_end=None
    ):
        """START, address+W, bytes, repeated START, address+R, bytes, STOP."""
        data = bytes(out_buffer)[out_start:out_end]
        part = memoryview(in_buffer)[in_start:in_end]
        reading = i2c_msg.read(address, len(part))
        self._bus.i2c_rdwr(i2c_msg.write(address, data), reading)
        part[:] = bytes(reading)
