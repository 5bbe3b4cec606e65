"""US Digital QSB counter of an incremental encoder, on a serial line."""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field

from drivers.marks import MARK
from drivers.qsb.device import Qsb
from drivers.qsb.registers import QsbConfig
from drivers.records import SCALAR, Rows
from onboard.devices.base import Channels, Clock, JointDevice, Surroundings
from onboard.devices.buses import OpenSerial, PollPeriod, SerialLineDevice
from onboard.section import Positive
from onboard.timebase.delays import Delay, on_wire_s
from onboard.timebase.timebase import ChannelClock, FreeChannel, MarkedChannel

TICK_NS = 1.925e6  # 1.900 or 1.953 ms: the manual says both
LINE_BYTES = 26  # with spaces, stamp, CR and LF
MEASUREMENT_S = 100e-6


class QsbDevice(SerialLineDevice, JointDevice):
    """US Digital QSB counter of an incremental encoder; ``sync_edge``: of the sync line, on its digital I/O 0."""

    about_clock = (
        "The adapter's timestamp, fitted to the sync edges that it latches its count on. Wire the sync line to its"
        " digital I/O 0. It holds no zero over a loss of power, and counts modulo 500 until it is set up: give its"
        " `zero_count` after that, joint at zero. After a reset in flight its rows are refused."
    )
    keeps_zero = False
    new_baud = 230_400
    marks_at_rest = False
    driver_configs = (QsbConfig,)
    kind: Literal["qsb"]
    counts_per_revolution: Annotated[
        int, Field(description="Counts per joint revolution, gear included; negative: reversed direction.")
    ]
    counting: Literal[1, 2, 4] = 4
    count_down: bool = QsbConfig.count_down
    interval_ticks: int = QsbConfig.interval_ticks
    tick_jitter: int = QsbConfig.tick_jitter
    sync_edge: Annotated[
        Literal["rising", "falling", "none"], Field(description="Edge of the sync line that latches its count.")
    ] = "rising"
    poll_period_ms: PollPeriod = QsbConfig.poll_period_ms
    silence_ms: Positive = QsbConfig.silence_ms
    reply_timeout_ms: Positive = QsbConfig.reply_timeout_ms

    @property
    def nominal_hz(self) -> float:
        """Nominal, give or take 1.4 %."""
        return 1e9 / self.settings("").interval_ns

    def channels(self, name: str) -> Channels:
        """Positions, and what was latched on the sync line's edges."""
        return {name: SCALAR, f"{name}_mark": MARK}

    def clocks(self, name: str, around: Surroundings) -> dict[str, ChannelClock]:
        """See ``DeviceSection``."""
        if self.sync_edge == "none":
            return {name: FreeChannel(TICK_NS, *self._line_delay_ns(around))}
        return {name: MarkedChannel(TICK_NS, f"{name}_mark", latches_counts=True)}

    def delays(self, name: str, around: Surroundings) -> list[Delay]:
        """See ``DeviceSection``: of arrival, where that is what its times are made of."""
        if self.sync_edge != "none":
            return []
        delay_ns, sigma_ns = self._line_delay_ns(around)
        return [Delay(name, "", delay_ns * 1e-9, sigma_ns * 1e-9, "measurement, and line on the wire", name)]

    def marks(self, name: str, rows: Mapping[str, Rows]) -> int | None:
        """See ``BusDevice``."""
        return None if self.sync_edge == "none" else len(rows.get(f"{name}_mark", ()))

    def settings(self, name: str) -> QsbConfig:
        """See ``BusDevice``."""
        return self._settings(QsbConfig, sync_edge=None if self.sync_edge == "none" else self.sync_edge)

    def driver(self, name: str, open_port: OpenSerial, clock: Clock, baud: int) -> Qsb:
        """See ``SerialLineDevice``."""
        return Qsb(name, open_port, clock, self.settings(name))

    def _line_delay_ns(self, around: Surroundings) -> tuple[float, float]:
        """From a sample to its line's arrival, and sigma."""
        wire_ns = 1e9 * on_wire_s(LINE_BYTES, around.baud(self.bus))
        return wire_ns + 1e9 * MEASUREMENT_S, TICK_NS / 12**0.5
