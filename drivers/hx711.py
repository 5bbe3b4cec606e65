"""Avia Semiconductor HX711: 24-bit converter for a load cell bridge, on a clock line (PD_SCK) and a data line (DOUT).

Source: its data sheet. DOUT goes low when a conversion has ended; 25, 26 or 27 pulses read it and choose input and gain
of the next one. A pulse is high for 50 us at the most; beyond 60 us the chip goes to sleep, and begins anew when the
line is low again. Whoever makes pulses by system calls may be interrupted within one: such a reading is discarded and
counted, and the chip is reset, which costs the time in which it settles. So is a reading that took longer than half of
a conversion, for the data sheet does not say what DOUT shows when the next one ends meanwhile.

After 25 pulses DOUT is high. Where it is not, the line is held low, as by a chip without supply. The rate of its
oscillator is nominal; ``drivers.conversions`` numbers the conversions. A chip that is ready later than a conversion
after the last reading has begun anew: conversions do not fail to come. Known limit: one input, not both in turn.
"""

from dataclasses import dataclass
from enum import Enum, auto
from typing import Literal

from drivers.conversions import ConvertedForce
from drivers.errors import ConfigurationError, FrameError
from drivers.ports import Clocked, ClockedPort
from drivers.records import Batch, SampleStatus, Severity
from drivers.reporter import Absence, Reporter

MS = 1_000_000
BITS = 24
PULSES = {128: 25, 32: 26, 64: 27}  # by gain; 32 is input B
RATES = 10, 80  # by the level of RATE
HIGHEST, LOWEST = (1 << 23) - 1, -(1 << 23)
LONGEST_HIGH_NS = 50_000  # PD_SCK high time, T3
POWER_DOWN_MS = 0.06
SETTLING_NS = {10: 400 * MS, 80: 100 * MS}  # after a reset or a change of input or gain, at the nominal rate
OSCILLATOR = 0.2  # relative bound of its rate: 10.8 of 10, 92 and 93.7 of 80 are reported of boards
LONGEST_READ = 0.5  # conversions
RESTARTED = 1.5  # conversions since the last reading without another: one, and the bound of its rate
SILENCE_PERIODS = 16  # twice the settling
BROWN_OUT = "brown_out"


@dataclass(frozen=True)
class Hx711Config:
    """Settings.

    Attributes:
        sample_rate_hz: Nominal, by its pin RATE: 10 (low) or 80 (high).
        amplifier: Gain: 128 or 64 of input A, 32 of input B.
        scale: N per count.
        poll_period_ms: Time between two looks at DOUT while a conversion is due.
    """

    sample_rate_hz: Literal[10, 80] = 80
    amplifier: Literal[128, 64, 32] = 128
    scale: float = 1.0
    poll_period_ms: float = 1.0

    def __post_init__(self) -> None:
        if self.sample_rate_hz not in RATES or self.amplifier not in PULSES:
            raise ConfigurationError(
                f"{self.sample_rate_hz} samples/s, gain {self.amplifier}: it has 10 and 80, and 128, 64 and 32"
            )
        if not POWER_DOWN_MS < self.poll_period_ms <= 500.0 / self.sample_rate_hz:
            raise ConfigurationError(
                f"poll_period_ms {self.poll_period_ms:g}: more than {POWER_DOWN_MS:g} (a reset lasts as long), and half"
                " a conversion at the most, or it loses samples"
            )

    @property
    def period_ns(self) -> float:
        """Nominal, of its conversions."""
        return 1e9 / self.sample_rate_hz


def decode_reading(bits: int, pulses: int) -> tuple[int, int]:
    """Counts, and their ``SampleStatus``: SATURATED at either end of the range.

    Args:
        bits: Level of DOUT after each pulse, the first one in the highest bit.
        pulses: 25 to 27.

    Raises:
        FrameError: DOUT is not high after the 25th pulse: it is no reading.
    """
    after = max(pulses - BITS, 0)
    ones = (1 << after) - 1
    if not 1 <= after <= 3 or bits >> pulses or bits & ones != ones:
        raise FrameError(f"DOUT is not high after {pulses} pulses: check the chip's supply, and which line is which")
    counts = ((bits >> after) ^ 1 << BITS - 1) + LOWEST
    return counts, int(SampleStatus.SATURATED if counts in (HIGHEST, LOWEST) else SampleStatus.OK)


class _State(Enum):
    STOPPED = auto()
    AWAY = auto()  # until the deadline
    RESETTING = auto()  # the clock line is high
    RUNNING = auto()


class Hx711:
    """An HX711 on a ``ClockedPort``, as SCALAR rows in N on the channel of its name. See ``drivers.device.Device``.

    ``sequence`` and ``tick``: number of the conversion since the first start, missed ones included. ``host_ns``: of the
        look that found it.

    Args:
        name: Channel, and source of its events.
        port: Its two lines.
        config: Settings.

    Attributes:
        broken: Readings that were discarded because a pulse, or all of them, took too long.
    """

    def __init__(self, name: str, port: ClockedPort, config: Hx711Config | None = None) -> None:
        self.name, self.config = name, config or Hx711Config()
        self.broken = self._readings = 0
        self._port = port
        self._report = Reporter(name)
        self._poll_ns = self._wait_ns = round(self.config.poll_period_ms * MS)
        self._pulses = PULSES[self.config.amplifier]
        self._count = ConvertedForce(self._report, self.config.scale, self.config.period_ns, OSCILLATOR)
        self._state = _State.STOPPED
        self._deadline_ns = self._settled_ns = 0
        self._selects = True  # input and gain are chosen by the first reading after a reset
        self._looked_ns = self._sampled_ns = 0
        self._cause = ""  # the first one since a row
        self._absence = Absence(self._report)

    @property
    def period_ns(self) -> int:
        """Time until the next pump, ns."""
        return self._wait_ns

    @property
    def within_ns(self) -> int:
        """See ``drivers.device.Hurried``: between two looks no more than one conversion may end."""
        shortest_ns = (1.0 - OSCILLATOR) * self.config.period_ns
        return max(int(0.5 * shortest_ns) // self._poll_ns, 1) * self._poll_ns

    def start(self, now_ns: int) -> list[Batch]:
        """See ``drivers.device.Device``."""
        self._absence.forget()
        self._state, self._deadline_ns = _State.AWAY, now_ns
        return self.pump(now_ns)

    def pump(self, now_ns: int, timeout_s: float = 0.0) -> list[Batch]:
        """Look at DOUT and read what is ready, or take the next step of a reset. ``timeout_s`` is not used."""
        del timeout_s
        try:
            if self._state is _State.RUNNING:
                self._take(now_ns)
            elif self._state is not _State.STOPPED and now_ns >= self._deadline_ns:
                self._reset(now_ns)
        except OSError as error:
            text = f"{self.name}: its GPIO lines fail ({error}): check the chip's name, and who else has the lines"
            self._stay_away(now_ns, "bus_error", text)
        return self._report.take()

    def stop(self, now_ns: int) -> list[Batch]:
        """Take what is waiting, put the chip to sleep, record what is missing."""
        if self._state is not _State.STOPPED:
            batches = self.pump(now_ns)
            try:
                self._port.drive(True)
            except OSError as error:
                self._report.event(now_ns, Severity.WARNING, "bus_error", f"it cannot be put to sleep ({error})")
            self._count.finish(now_ns, self._cause)
            taken, broken = self._count.number + 1, f"{self.broken} of {self._readings} readings were broken"
            text = f"stopped after {taken} samples; {broken}"
            self._report.event(now_ns, Severity.INFO, "stopped", text)
            self._report.flush(now_ns)
            self._state, self._cause = _State.STOPPED, ""
            return batches + self._report.take()
        return []

    def _reset(self, now_ns: int) -> None:
        """The clock line goes high, and a pump later low again."""
        if self._state is _State.AWAY:
            self._port.drive(True)
            self._state, self._deadline_ns, self._wait_ns = _State.RESETTING, now_ns + self._poll_ns, self._poll_ns
            return
        self._port.drive(False)
        self._state = _State.RUNNING
        self._looked_ns = self._sampled_ns = now_ns
        self._begins_anew(now_ns)

    def _begins_anew(self, now_ns: int) -> None:
        """The chip has its reset values, and converts in another phase."""
        self._selects = True
        self._settles(now_ns)
        self._count.anew()

    def _settles(self, now_ns: int) -> None:
        self._settled_ns = now_ns + round((1.0 + OSCILLATOR) * SETTLING_NS[self.config.sample_rate_hz])

    def _take(self, now_ns: int) -> None:
        look = self._port.look()
        looked_ns = min(now_ns, look.host_ns)
        self._wait_ns = self._poll_ns
        if look.high:
            self._looked_ns = looked_ns
            silent = (now_ns - self._sampled_ns) / self.config.period_ns
            if silent > SILENCE_PERIODS:
                text = "DOUT stays high: check the chip's supply, both lines and RATE"
                self._stay_away(now_ns, "no_samples", text)
            elif silent > RESTARTED and not self._selects and now_ns >= self._settled_ns:
                self._begins_anew(now_ns)
                self._cause = self._cause or BROWN_OUT
            elif self._count.number >= 0 and self._count.is_early(now_ns):
                self._wait_ns = self._count.next_look_ns(now_ns, self._poll_ns, self.within_ns)
            return
        not_before_ns, self._looked_ns = self._looked_ns, looked_ns
        reading = self._port.clock_out(self._pulses)
        self._readings += 1
        if self._is_broken(now_ns, reading, look.host_ns):
            return
        try:
            counts, status = decode_reading(reading.bits, self._pulses)
        except FrameError as error:
            self._stay_away(now_ns, "no_samples", str(error))
            return
        self._sampled_ns = now_ns
        self._answers(now_ns)
        if self._cause == BROWN_OUT:
            self._report.event(now_ns, Severity.ERROR, BROWN_OUT, "it was reset: check its supply")
        if now_ns < self._settled_ns:
            status |= SampleStatus.NOT_VALID
        if self._selects and self._pulses != PULSES[128]:  # what was read is input A with 128 yet
            status |= SampleStatus.NOT_VALID
            self._settles(now_ns)
        self._selects = False
        self._cause = self._count.hand_over(not_before_ns, look.host_ns, counts, status, self._cause)
        if self._count.is_early(now_ns):
            self._wait_ns = self._count.next_look_ns(now_ns, self._poll_ns, self.within_ns)

    def _is_broken(self, now_ns: int, reading: Clocked, looked_ns: int) -> bool:
        """Discard a reading within which a pulse, or all of them, took too long, and reset the chip."""
        took_ns = reading.host_ns - looked_ns
        if reading.high_ns <= LONGEST_HIGH_NS and took_ns <= LONGEST_READ * self.config.period_ns:
            return False
        self.broken += 1
        text = (
            f"reading {self._readings} discarded, the {self.broken}th: PD_SCK high for {reading.high_ns // 1000} us, "
            f"{took_ns // 1000} us in all; give heft real-time priority, or a microcontroller the chip"
        )
        self._report.event(now_ns, Severity.WARNING, "read_broken", text)
        self._cause = self._cause or "read_broken"
        self._state, self._deadline_ns = _State.AWAY, now_ns
        return True

    def _answers(self, now_ns: int) -> None:
        """A reading came: say so, where it is the first one or was said to be away."""
        if not self._absence.end(now_ns) and self._count.number < 0:
            rate, gain = self.config.sample_rate_hz, self.config.amplifier
            self._report.event(now_ns, Severity.INFO, "started", f"HX711 answers: {rate} samples/s, gain {gain}")

    def _stay_away(self, now_ns: int, code: str, text: str) -> None:
        """Report once, then reset it after a back-off that doubles up to one second."""
        self._cause = code if self._cause in ("", BROWN_OUT) else self._cause
        self._wait_ns = self._poll_ns
        self._state, self._deadline_ns = _State.AWAY, self._absence.begin(now_ns, code, text, kind=code)
