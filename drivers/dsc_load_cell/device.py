"""DSC digitiser as a polled device: one read is one sample."""

from drivers.dsc_load_cell.message import DscLoadCellConfig, DscReply, decode_number, read_command
from drivers.errors import FrameError
from drivers.records import Severity
from drivers.serial_line.device import Clock, OpenPort
from drivers.serial_line.poll import PolledDevice, Value

REFUSED = b"?"


class DscLoadCell(PolledDevice):
    """A Mantracourt DSC, as SCALAR rows; see ``drivers.serial_line.poll`` for their two stamps.

    ``value_raw`` holds the digits as an integer, ``scale`` the power of ten of the last digit. The first answer fixes
    the number of digits; an answer of another form is a bad frame.

    Args:
        name: Channel, and source of its events.
        open_port: Opens its serial port.
        clock: CLOCK_MONOTONIC, ns.
        config: Station, command and timing.
    """

    def __init__(self, name: str, open_port: OpenPort, clock: Clock, config: DscLoadCellConfig | None = None) -> None:
        self.config = DscLoadCellConfig() if config is None else config
        periods = self.config.poll_period_ms, self.config.sample_period_ms
        super().__init__(name, open_port, clock, *periods, self.config.timeout_ms, 0.0)
        self._command = read_command(self.config.station, self.config.command)
        self._open = DscReply()
        self._form: tuple[int, int] | None = None  # decimals, bytes

    def _opened(self, now_ns: int) -> None:
        super()._opened(now_ns)
        self._form = None

    def _value_channels(self) -> tuple[str, ...]:
        return (self.name,)

    def _question(self, retry: bool) -> bytes:
        self._open = DscReply()
        return self._command

    def _missing(self) -> int:
        return 1 if self._form is None else max(1, self._form[1] + 1 - self._open.received)  # with the CR

    def _answer(self, host_ns: int, data: bytes) -> list[Value] | None:
        text = self._open.receive(data)
        if text is None:
            return None
        if text == REFUSED:
            text_of = f"it does not take {self.config.command}: check the command and the station number"
            self._report.event(host_ns, Severity.ERROR, "refused", text_of)
            return []
        number = decode_number(text)
        form = number.decimals, len(text)
        if self._form is not None and form != self._form:
            raise FrameError(f"{text!r} has another form than before: bytes were lost, or DP and DPB were changed")
        self._form = form
        return [Value(self.name, number.counts, 10.0**-number.decimals, self.config.unit)]
