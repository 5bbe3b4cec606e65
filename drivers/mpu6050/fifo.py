"""FIFO of the MPU-6050: its registers."""

from drivers.i2c.bus import RegisterBus
from drivers.inertial.fifo import Fifo
from drivers.inertial.packet import WordOrder, decode_words
from drivers.inertial.stream import SampleStream
from drivers.mpu6050 import registers as reg
from drivers.mpu6050.registers import Mpu6050Config
from drivers.ports import I2cReply
from drivers.records import Rows
from drivers.reporter import Reporter

ORDER = WordOrder(slice(0, 3), 3, slice(4, 7))  # RM 4.32, FIFO_R_W


def decode_packets(data: bytes, config: Mpu6050Config) -> Rows:
    """See ``drivers.inertial.packet.decode_words``; the data registers have the same order."""
    return decode_words(data, ORDER, config)


class Mpu6050Fifo(Fifo):
    """See ``Fifo``.

    Args:
        config: How the chip was set up.
        bus: Its registers.
        stream: Numbers its samples.
        report: Where events go.

    Attributes:
        chip: The die.
        registers: Register values besides the configuration while it runs.
    """

    order = ORDER
    registers = reg.FIFO_RUNS

    def __init__(self, config: Mpu6050Config, bus: RegisterBus, stream: SampleStream, report: Reporter) -> None:
        super().__init__(config, stream, report)
        self.chip = reg.CHIPS[0x68]
        self._bus = bus

    @property
    def fifo_bytes(self) -> int:
        """See ``Fifo``."""
        return self.chip.fifo_bytes

    def silence(self) -> None:
        """See ``Fifo``."""
        self._bus.write(reg.FIFO_EN, 0)

    def _clear(self) -> int:
        self.silence()
        self._bus.write(reg.USER_CTRL, 0)
        self._bus.write(reg.USER_CTRL, reg.USER_FIFO_RESET)
        self._bus.write(reg.USER_CTRL, reg.USER_FIFO_EN)
        return self._bus.read(reg.INT_STATUS).host_ns

    def _open(self) -> None:
        self._bus.write(reg.FIFO_EN, reg.FIFO_EN_ALL)

    def _queued(self) -> I2cReply:
        return self._bus.read(reg.FIFO_COUNT_H, 2)

    def _read(self, count: int) -> I2cReply:
        return self._bus.pop(reg.FIFO_R_W, count)

    def _has_run_over(self) -> bool:
        return bool(self._bus.byte(reg.INT_STATUS) & reg.FIFO_OFLOW)
