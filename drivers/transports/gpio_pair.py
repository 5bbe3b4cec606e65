"""A clock line out and a data line in, of one GPIO chip, by libgpiod version 2; or of a simulator, over a socket."""

from collections.abc import Callable, Iterable
from typing import Self

import gpiod
from gpiod.line import Bias, Direction, Value

from drivers.ports import Clocked, ClockedPort, Look
from drivers.transports.i2c_unix import UnixI2cPort
from drivers.transports.reopening import Reopening


class GpiodPair:
    """A ``ClockedPort`` by system calls, two for a pulse and one for its bit.

    A scheduler that takes the processor away between the two leaves the clock line high: ``Clocked.high_ns`` is from
    before the first to after the second. The data line is pulled up where the chip can do so: it is high when nothing
    drives it.
    """

    def __init__(self, request: gpiod.LineRequest, data: int, clock_line: int, clock: Callable[[], int]) -> None:
        self._request, self._data, self._line = request, data, clock_line
        self._clock = clock

    @classmethod
    def open(cls, chip: str, data: int, clock_line: int, clock: Callable[[], int]) -> Self:
        """Request both lines of ``chip`` (``/dev/gpiochip0``), the clock line low. Raises OSError."""
        config: dict[Iterable[int | str] | int | str, gpiod.LineSettings | None] = {
            data: gpiod.LineSettings(direction=Direction.INPUT, bias=Bias.PULL_UP),
            clock_line: gpiod.LineSettings(direction=Direction.OUTPUT, output_value=Value.INACTIVE),
        }
        return cls(gpiod.request_lines(chip, config, consumer="heft"), data, clock_line, clock)

    def look(self) -> Look:
        """See ``ClockedPort``."""
        return Look(self._request.get_value(self._data) is Value.ACTIVE, self._clock())

    def drive(self, high: bool) -> None:
        """See ``ClockedPort``."""
        self._request.set_value(self._line, Value.ACTIVE if high else Value.INACTIVE)

    def clock_out(self, pulses: int) -> Clocked:
        """See ``ClockedPort``."""
        request, clock, high, low = self._request, self._clock, Value.ACTIVE, Value.INACTIVE
        bits = longest_ns = after_ns = 0
        for _ in range(pulses):
            before_ns = clock()
            request.set_value(self._line, high)
            request.set_value(self._line, low)
            after_ns = clock()
            longest_ns = max(longest_ns, after_ns - before_ns)
            bits = bits << 1 | (request.get_value(self._data) is high)
        return Clocked(bits, longest_ns, after_ns)

    def close(self) -> None:
        """Release both lines."""
        self._request.release()


class ReopeningPair(Reopening[ClockedPort]):
    """A ``ClockedPort`` over ports that ``open_port`` opens, one after the other; see :class:`Reopening`."""

    def __init__(self, open_port: Callable[[], ClockedPort], clock: Callable[[], int]) -> None:
        super().__init__(open_port, clock, "the GPIO chip")

    def look(self) -> Look:
        """See ``ClockedPort``."""
        return self._tried(lambda port: port.look())

    def drive(self, high: bool) -> None:
        """See ``ClockedPort``."""
        self._tried(lambda port: port.drive(high))

    def clock_out(self, pulses: int) -> Clocked:
        """See ``ClockedPort``."""
        return self._tried(lambda port: port.clock_out(pulses))


class UnixPair:
    """A ``ClockedPort`` of a simulator: requests of ``i2c_unix`` at address 0.

    Reading one byte without a request: level of the data line. Writing one byte: level of the clock line. A request of
    one byte, which is answered by eight: so many pulses; bits and longest time high, ns, both u32, little-endian.
    """

    def __init__(self, path: str, clock: Callable[[], int]) -> None:
        self._socket = UnixI2cPort(path, clock)

    def look(self) -> Look:
        """See ``ClockedPort``."""
        data, host_ns = self._socket.write_read(0, b"", 1)
        return Look(bool(data[0]), host_ns)

    def drive(self, high: bool) -> None:
        """See ``ClockedPort``."""
        self._socket.write(0, bytes([high]))

    def clock_out(self, pulses: int) -> Clocked:
        """See ``ClockedPort``."""
        data, host_ns = self._socket.write_read(0, bytes([pulses]), 8)
        return Clocked(int.from_bytes(data[:4], "little"), int.from_bytes(data[4:], "little"), host_ns)

    def close(self) -> None:
        """Drop the connection."""
        self._socket.close()
