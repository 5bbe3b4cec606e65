"""A Mantracourt DSC or DCell strain-gauge converter on its ASCII protocol (DSC user manual, appendix B).

A command is ``!``, three digits of the station, ``:``, up to four letters, then ``?`` (read), ``=`` and a decimal
number of up to 15 characters (write) or nothing (execute), and CR. Every ``!`` begins anew; case does not matter. Read
is answered by a number and CR, write and execute by CR, what cannot be done by ``?`` and CR. Station 000 is for all:
obeyed and not answered. Other stations and lines without ``:`` are not answered. A number is sign, DPB digits, point,
DP digits.

Commands here: ``SOUT`` and ``SYS`` (force less ``SZ``), ``SZ`` (system zero, rw), ``SNAP`` (takes ``SYS`` into
``SYSN``: broadcast, it samples all stations at once), ``PEAK`` and ``TRGH`` with ``RSPT``, ``FLAG`` (rw), ``STAT``,
``STN``, ``BAUD``, ``RATE``, ``DP``, ``DPB`` (rw), ``RST``. ``STN``, ``BAUD`` and ``RATE`` are taken over by ``RST`` or
at power-up; all settings survive both. Codes: BAUD 0..7 = 2400, 4800, 9600, 19200, 38400, 57600, 76800, 115200;
RATE 0..9 = 1, 2, 5, 10, 20, 50, 60, 100, 200, 500 conversions a second. These two tables, ``SNAP``, ``SYSN``, ``RSPT``
and the error answer were not checked against the manual's pages. The delay of an answer varies between two limits
within the manual's 50 ms.
"""

import math
import re
from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import Field

from hil_sim.devices.emulator import FORCES, Bench, Equivalent, MeasuringEmulator, Twin
from hil_sim.devices.serial_line.sampled_scalar import SampledScalar
from hil_sim.devices.serial_line.serial_twin import POLLED_KINDS, SerialTwin
from hil_sim.devices.serial_wire import LineFormat
from hil_sim.faults import NO_FAULTS, DeviceFaults, FaultyScalar
from hil_sim.scenario.sensor_tables import NonNegative
from hil_sim.scenario.sheets import Sheets
from hil_sim.sensing.analog import ChipClock, ScalarAnalog
from hil_sim.sensing.sensors import LoadCellSensor

_BAUD_RATES: Final = (2400, 4800, 9600, 19200, 38400, 57600, 76800, 115_200)
_RATES_HZ: Final = (1, 2, 5, 10, 20, 50, 60, 100, 200, 500)
_COMMAND: Final = re.compile(rb"(\d{3}):([0-9A-Za-z]{1,4})(?:(\?)|=([0-9+\-. ]{1,15}))?")
_LIMITS: Final = {
    "STN": (1, 999),
    "BAUD": (0, len(_BAUD_RATES) - 1),
    "RATE": (0, len(_RATES_HZ) - 1),
    "DP": (0, 8),
    "DPB": (1, 8),
    "FLAG": (0, 0xFFFF),
    "SZ": (-1e8, 1e8),
}
_WHOLE: Final = frozenset(_LIMITS) - {"SZ"}
_LONGEST_COMMAND: Final = 32
_LONGEST_DELAY_NS: Final = 50_000_000
_CHORE_NS: Final = 100_000_000
_BOOT_NS: Final = 250_000_000  # from power-up to the first answer


class DscLoadCellTwin(SerialTwin):
    """One converter with its cell.

    Args:
        analog: Force on the cell as the converter sees it, N.
        clock: The converter's oscillator.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        station: 1 to 999.
        baud_code: BAUD.
        rate_code: RATE.
        digits: DPB and DP.
        capacity_n: Full scale, N, either way; the converter clips there.
        delay_ns: Shortest and longest delay of an answer.
        seed: Of the delays.
        faults: What breaks.

    Raises:
        FaultError: a fault that the converter cannot have.
        ValueError: a delay beyond the 50 ms of the manual, or a setting out of its range.
    """

    def __init__(
        self,
        analog: ScalarAnalog,
        clock: ChipClock,
        start_ns: int,
        *,
        station: int = 1,
        baud_code: int = 7,
        rate_code: int = 9,
        digits: tuple[int, int] = (5, 3),
        capacity_n: float = 50.0,
        delay_ns: tuple[int, int] = (1_000_000, 5_000_000),
        seed: int = 0,
        faults: DeviceFaults = NO_FAULTS,
    ) -> None:
        settings = {"STN": station, "BAUD": baud_code, "RATE": rate_code, "DPB": digits[0], "DP": digits[1]}
        for name, value in settings.items():
            if not _LIMITS[name][0] <= value <= _LIMITS[name][1]:
                raise ValueError(f"{name} = {value} is not within {_LIMITS[name]}.")
        if not 0 <= delay_ns[0] <= delay_ns[1] <= _LONGEST_DELAY_NS:
            raise ValueError(f"Delays of {delay_ns} ns: the manual promises an answer within 50 ms.")
        super().__init__(LineFormat(_BAUD_RATES[baud_code]), start_ns, faults, POLLED_KINDS)
        self.produced = 0  # SOUT and SYS answered
        self._cell = SampledScalar(FaultyScalar(analog, faults, start_ns), clock, start_ns, _RATES_HZ[rate_code])
        self._capacity_n = capacity_n
        self._delay_ns = delay_ns
        self._rng = np.random.default_rng([seed, 0xD5C])
        self._settings: dict[str, float] = {**settings, "SZ": 0.0, "FLAG": 0}
        self._clear_state()

    def _power_up(self, now_ns: int) -> None:
        self._clear_state()
        self.line = LineFormat(_BAUD_RATES[int(self._settings["BAUD"])])
        self._cell.power_up(now_ns, _RATES_HZ[int(self._settings["RATE"])])
        self._at("boot", now_ns + _BOOT_NS, self._boot)
        self._at("chores", now_ns + _CHORE_NS, self._chores)

    def _clear_state(self) -> None:
        self._ready = False
        self._station = int(self._settings["STN"])
        self._force_n = self._snapshot_n = 0.0
        self._peak_n, self._trough_n = -math.inf, math.inf
        self._command: bytearray | None = None

    def _boot(self, now_ns: int) -> None:
        del now_ns
        self._ready = True

    def _chores(self, now_ns: int) -> None:
        self._convert(now_ns)
        self._at("chores", now_ns + _CHORE_NS, self._chores)

    def _convert(self, now_ns: int) -> None:
        made = [min(max(sample, -self._capacity_n), self._capacity_n) for sample in self._cell.settle(now_ns)]
        if made:
            self._force_n = made[-1]
            self._peak_n, self._trough_n = max(self._peak_n, *made), min(self._trough_n, *made)

    # Protocol

    def _on_byte(self, byte: int, now_ns: int) -> None:
        if not self._ready:
            return
        if byte == ord("!"):
            self._command = bytearray()
        elif self._command is not None:
            if byte == ord("\r"):
                command, self._command = bytes(self._command), None
                self._obey(command, now_ns)
            elif len(self._command) < _LONGEST_COMMAND:
                self._command.append(byte)

    def _obey(self, command: bytes, now_ns: int) -> None:
        parts = _COMMAND.fullmatch(command)
        if parts is None:
            self._answer_malformed(command, now_ns)
            return
        station, name = int(parts[1]), parts[2].decode("ascii").upper()
        if station not in (0, self._station):
            return
        self._convert(now_ns)
        if parts[3]:
            answer = self._read(name)
        elif parts[4]:
            answer = "" if self._write(name, parts[4].decode("ascii")) else "?"
        else:
            answer = "" if self._execute(name, now_ns) else "?"
        if station:
            self._answer(answer, now_ns)

    def _answer_malformed(self, command: bytes, now_ns: int) -> None:
        if command[:4] == b"%03d:" % self._station:
            self._answer("?", now_ns)

    def _answer(self, text: str, now_ns: int) -> None:
        delay_ns = int(self._rng.integers(self._delay_ns[0], self._delay_ns[1], endpoint=True))
        self._send(text.encode("ascii") + b"\r", self._late(now_ns + delay_ns))

    def _read(self, name: str) -> str:
        system_n = self._force_n - self._settings["SZ"]
        values = {
            "SOUT": system_n,
            "SYS": system_n,
            "SYSN": self._snapshot_n,
            "PEAK": self._peak_n - self._settings["SZ"],
            "TRGH": self._trough_n - self._settings["SZ"],
            "STAT": 0,
            **self._settings,
        }
        if name not in values:
            return "?"
        self.produced += name in ("SOUT", "SYS")
        return self._number(values[name])

    def _write(self, name: str, text: str) -> bool:
        try:
            value = float(text.replace(" ", ""))
        except ValueError:
            return False
        low, high = _LIMITS.get(name, (1, 0))
        if not low <= value <= high or (name in _WHOLE and value != round(value)):
            return False
        self._settings[name] = value
        return True

    def _execute(self, name: str, now_ns: int) -> bool:
        if name == "SNAP":
            self._snapshot_n = self._force_n - self._settings["SZ"]
        elif name == "RSPT":
            self._peak_n = self._trough_n = self._force_n
        elif name == "RST":
            self._at("restart", now_ns + self._delay_ns[1], self.restart)
        else:
            return False
        return True

    def _number(self, value: float) -> str:
        before, after = int(self._settings["DPB"]), int(self._settings["DP"])
        shown = min(round(abs(value) * 10.0**after), 10 ** (before + after) - 1)
        digits = f"{shown:0{before + after}d}"
        return f"{'-' if value < 0 and shown else '+'}{digits[:before]}.{digits[before:]}"


class DscLoadCellTable(MeasuringEmulator):
    """A Mantracourt DSC; ``delay_ms``: shortest and longest time that it takes to answer."""

    baud_rates = _BAUD_RATES
    quantities = FORCES

    kind: Literal["dsc_load_cell"]
    station: Annotated[int, Field(ge=1, le=999)] = 1
    rate_code: Annotated[int, Field(ge=0, le=9)] = 9  # 500 conversions a second
    delay_ms: tuple[NonNegative, NonNegative] = (1.0, 5.0)

    @classmethod
    def from_vehicle(cls, name: str, said: Mapping[str, Any], sheets: Sheets) -> Equivalent:
        """See ``Emulator``."""
        table = {"station": said.get("station", 1), "measures": name, "at": said["frame"]}
        return Equivalent(table, {name: sheets.load_cell(said)}, {name: "converter"})

    def build(self, bench: Bench) -> Twin:
        """See ``Emulator``."""
        cell = bench.sensor(LoadCellSensor)
        shortest_ms, longest_ms = self.delay_ms
        twin = DscLoadCellTwin(
            cell,
            bench.clock,
            bench.start_ns,
            station=self.station,
            baud_code=_BAUD_RATES.index(bench.line.baud_rate),
            rate_code=self.rate_code,
            capacity_n=cell.capacity_N,
            delay_ns=(round(shortest_ms * 1e6), round(longest_ms * 1e6)),
            seed=bench.seed,
            faults=bench.faults,
        )
        return Twin(twin, lambda: twin.produced, (bench.name,))
