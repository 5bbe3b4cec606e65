"""Modbus load cell transmitter as a polled device: one read of 40007 to 40014 is one sample."""

from collections.abc import Callable, Iterator

from drivers.errors import FrameError
from drivers.modbus_load_cell.frame import ModbusException, ModbusReply, read_request
from drivers.modbus_load_cell.registers import COUNT, STATUS, ModbusLoadCellConfig, decode_weights
from drivers.ports import SerialPort, Station
from drivers.records import Severity
from drivers.serial_line.device import Clock, OpenPort
from drivers.serial_line.poll import PolledDevice, Value

ASKED = range(1, 17)  # addresses: a line has few, from 1 on
ANSWERED_S = 0.06  # the slowest answer, at 9600 bit/s


class ModbusLoadCell(PolledDevice):
    """A Laumas transmitter, as SCALAR rows; see ``drivers.serial_line.poll`` for their two stamps.

    After an unanswered request the next one reads one register more, so that a late answer has the wrong length and is
        rejected. ``device_status`` is the low byte of the status register. NOT_VALID: cell or converter error, or
        unknown unit; SATURATED: capacity exceeded.

    Args:
        name: Channel (or its first part), and source of events.
        open_port: Opens its serial port.
        clock: CLOCK_MONOTONIC, ns.
        config: Address, values, scale and timing.
    """

    def __init__(
        self, name: str, open_port: OpenPort, clock: Clock, config: ModbusLoadCellConfig | None = None
    ) -> None:
        self.config = ModbusLoadCellConfig() if config is None else config
        periods = self.config.poll_period_ms, self.config.sample_period_ms
        super().__init__(name, open_port, clock, *periods, self.config.timeout_ms, self.config.pause_ms)
        self._extra = 0  # surplus registers in the request, which mark it against a late answer
        self._open = ModbusReply(read_request(self.config.address, STATUS, COUNT))
        self._said = ""  # unit and scale in the last event

    def _value_channels(self) -> tuple[str, ...]:
        values = self.config.values
        return (self.name,) if len(values) == 1 else tuple(f"{self.name}_{value}" for value in values)

    def _question(self, retry: bool) -> bytes:
        self._extra = 1 - self._extra if retry else 0
        request = read_request(self.config.address, STATUS, COUNT + self._extra)
        self._open = ModbusReply(request, self.config.echo)
        return request

    def _missing(self) -> int:
        return self._open.missing

    def _answer(self, host_ns: int, data: bytes) -> list[Value] | None:
        try:
            registers = self._open.receive(data)
        except ModbusException as error:
            self._report.event(host_ns, Severity.ERROR, f"exception_{error.code}", str(error))
            return []
        if registers is None:
            return None
        weights = decode_weights(registers, self.config)
        self._tell_scale(host_ns, registers[COUNT - 1], weights.scale, weights.unit)
        chosen = {"gross": weights.gross, "net": weights.net}
        return [
            Value(channel, chosen[value], weights.scale, weights.unit, weights.device_status, int(weights.status))
            for channel, value in zip(self._value_channels(), self.config.values, strict=True)
        ]

    def _tell_scale(self, host_ns: int, code: int, scale: float, unit: str) -> None:
        said = f"division and unit code {code:04X}h, {scale:g} {unit} per count"
        if said != self._said:
            known = scale != 0.0
            text = said if known else f"{said}: not a mass; give scale and unit in its configuration"
            severity = Severity.INFO if known else Severity.ERROR
            self._report.event(host_ns, severity, "scale" if known else "unit_unknown", text)
            self._said = said


def answering(port: SerialPort, wait: Callable[[float], object]) -> Iterator[Station]:
    """Stations of the addresses ``ASKED`` that answer a read of 40007 to 40014, or refuse it, at the line's speed.

    Raises:
        OSError: The line fails.
    """
    for address in ASKED:
        port.read(port.in_waiting)
        request = read_request(address, STATUS, COUNT)
        port.write(request)
        wait(ANSWERED_S)
        try:
            registers = ModbusReply(request).receive(port.read(port.in_waiting))
        except ModbusException as error:
            yield Station(address, f"Modbus, refuses 40007 to 40014: {error}", is_read=False)
        except FrameError:
            continue
        else:
            if registers is not None:
                yield Station(address, f"Modbus load cell transmitter: address = {address}")
