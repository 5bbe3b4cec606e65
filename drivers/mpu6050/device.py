"""The MPU-6050 as a device: set up, drain the FIFO, notice when it lost samples, lost its mind, or went away."""

from enum import Enum, auto

import numpy as np

from drivers.errors import ConfigurationError, DriverError, NoAnswerError, WrongDeviceError
from drivers.mpu6050 import registers as reg
from drivers.mpu6050.bus import NOT_ACKNOWLEDGED, RegisterBus, explain
from drivers.mpu6050.decode import PACKET_BYTES, decode_packets, first_misaligned
from drivers.mpu6050.registers import CHIPS, INCOMPATIBLE, Chip, Mpu6050Config, configuration
from drivers.mpu6050.sample_clock import SampleClock
from drivers.ports import I2cPort
from drivers.records import Batch, Rows, SampleStatus, Severity
from drivers.reporter import Reporter

RESET_NS = 100_000_000  # after DEVICE_RESET
RESET_LIMIT_NS = 1_000_000_000
WAKE_NS = 100_000_000  # gyro start-up 60 ms, PLL 10 ms, zero-rate settling 30 ms (PS 6.1)
SILENCE_NS = 100_000_000
CHECK_ROUND_NS = 1_000_000_000
BACKOFF_NS = 20_000_000
LONGEST_BACKOFF_NS = 1_000_000_000
LAST_DRAINS = 8


class _State(Enum):
    STOPPED = auto()
    AWAY = auto()  # no answer, or not the answer we want: try again at the deadline
    RESETTING = auto()
    WAKING = auto()
    RUNNING = auto()


class Mpu6050:
    """An MPU-6050 on an ``I2cPort``, as IMU rows on the channel of its name.

    ``sequence`` and ``tick`` are both the sample number since the first start, samples known to be lost included. Rows
    of one drain share ``host_ns``: the stamp of the FIFO_COUNT read that counted them, at which instant the newest
    was less than one sample period old.

    Args:
        name: Channel, and source of its events.
        port: The bus.
        config: How to set it up.
    """

    def __init__(self, name: str, port: I2cPort, config: Mpu6050Config | None = None) -> None:
        self.name = name
        self.config = Mpu6050Config() if config is None else config
        self._bus = RegisterBus(port, self.config.address)
        self._report = Reporter(name)
        self._clock = SampleClock(self.config.sample_period_ns)
        self._state = _State.STOPPED
        self._chip = CHIPS[0x68]
        self._expected: dict[int, int] = {}  # what its registers must hold; empty unless the FIFO runs and is counted
        self._next = 0  # number of the next sample
        self._deadline_ns = 0
        self._reset_ns = 0
        self._backoff_ns = BACKOFF_NS
        self._away_since_ns: int | None = None
        self._told = ""
        self._cause = ""  # why samples may be missing from here on; empty while the stream is whole
        self._after_reset = False
        self._temperature: int | None = None
        self._sampled_ns = 0
        self._checks = 0

    @property
    def period_ns(self) -> int:
        """Time between two pumps, ns."""
        return round(self.config.poll_period_ms * 1e6)

    @property
    def bus_errors(self) -> int:
        """Transfers that failed, those that a retry mended included."""
        return self._bus.errors

    def probe(self) -> Chip:
        """Ask the chip who it is.

        Raises:
            NoAnswerError: Nothing answers at the address.
            WrongDeviceError: Something else answers.
        """
        where = f"{self.name}: I2C {self.config.address:#x}"
        try:
            value = self._bus.byte(reg.WHO_AM_I)
        except OSError as error:
            raise NoAnswerError(f"{where} does not answer {explain(error)}") from error
        if value in CHIPS:
            return CHIPS[value]
        what = INCOMPATIBLE.get(value, "unknown")
        raise WrongDeviceError(
            f"{where} has WHO_AM_I {value:#04x} ({what}), MPU-6050 has 0x68: fit that chip or mend the address"
        )

    def start(self, now_ns: int) -> list[Batch]:
        """Probe and reset the chip; ``pump`` goes on from there. See ``drivers.device.Device``."""
        self._clock = SampleClock(self.config.sample_period_ns)
        self._after_reset = self._next > 0
        self._begin(now_ns)
        return self._report.take()

    def pump(self, now_ns: int, timeout_s: float = 0.0) -> list[Batch]:
        """Drain the FIFO, or take the next step of setting up when its time has come. ``timeout_s`` is not used."""
        del timeout_s
        try:
            if self._state is _State.RUNNING:
                if self._drain(now_ns):
                    self._check_one_register(now_ns)
                else:
                    self._look_into_silence(now_ns)
            elif self._state is not _State.STOPPED and now_ns >= self._deadline_ns:
                self._step(now_ns)
        except OSError as error:
            self._fault(now_ns, error)
        return self._report.take()

    def stop(self, now_ns: int) -> list[Batch]:
        """Stop FIFO writes, drain what is left, put the chip to sleep. What cannot be had is named as a gap."""
        if self._state is _State.RUNNING:
            try:
                for _ in range(LAST_DRAINS):
                    self._bus.write(reg.FIFO_EN, 0)
                    if not self._drain(now_ns):
                        break
                self._bus.write(reg.USER_CTRL, 0)
                self._bus.write(reg.PWR_MGMT_1, reg.SLEEP)
            except OSError as error:
                self._fault(now_ns, error)
        if self._cause and self._clock:
            self._lose(now_ns, self._clock.produced(now_ns))
        if self._state is not _State.STOPPED:
            text = f"stopped after {self._next} samples, {self.bus_errors} failed transfers"
            self._report.event(now_ns, Severity.INFO, "stopped", text)
        self._state = _State.STOPPED
        self._expected = {}
        self._report.flush(now_ns)
        return self._report.take()

    # Setting up

    def _begin(self, now_ns: int) -> None:
        self._expected = {}
        try:
            chip = self.probe()
            self._bus.write(reg.PWR_MGMT_1, reg.DEVICE_RESET)
        except WrongDeviceError as error:
            self._stay_away(now_ns, "wrong_device", error)
        except NoAnswerError as error:
            self._stay_away(now_ns, "no_answer", error)
        except OSError as error:
            self._fault(now_ns, error)
        else:
            if chip is not self._chip:
                text = f"{chip.name} in place of {self._chip.name}: temperature {chip.temperature} degC, other filters"
                self._report.event(now_ns, Severity.WARNING, "clone", text)
            self._chip = chip
            self._state, self._reset_ns, self._deadline_ns = _State.RESETTING, now_ns, now_ns + RESET_NS

    def _step(self, now_ns: int) -> None:
        if self._state is _State.AWAY:
            if self._expected and self._mismatch() is None:
                self._state = _State.RUNNING
                self._sampled_ns = now_ns
                self._recovered(now_ns)
                self._drain(now_ns)
            else:
                self._begin(now_ns)
        elif self._state is _State.RESETTING:
            if not self._bus.byte(reg.PWR_MGMT_1) & reg.DEVICE_RESET:
                self._bus.write(reg.PWR_MGMT_1, reg.CLOCK_PLL_GYRO_X)
                self._state, self._deadline_ns = _State.WAKING, now_ns + WAKE_NS
            elif now_ns - self._reset_ns > RESET_LIMIT_NS:
                text = f"{self.name}: DEVICE_RESET does not clear: power-cycle the {self._chip.name}"
                self._stay_away(now_ns, "configuration", ConfigurationError(text))
        else:
            self._run(now_ns)

    def _run(self, now_ns: int) -> None:
        """Write the configuration, read it back, start the FIFO."""
        settings = configuration(self.config, self._chip)
        for register, value in settings.items():
            self._bus.write(register, value)
        for register, value in settings.items():
            read = self._bus.byte(register)
            if read != value:
                text = f"{self.name}: register {register:#04x} reads {read:#04x}, not {value:#04x}: replace the chip"
                self._stay_away(now_ns, "configuration", ConfigurationError(text))
                return
        self._restart_fifo(now_ns, 0)
        self._state = _State.RUNNING
        self._sampled_ns = now_ns
        self._recovered(now_ns)
        config = self.config
        ranges = f"{config.accel_range_g} g, {config.gyro_range_deg_s} deg/s, DLPF {config.filter_code}"
        text = f"{self._chip.name} runs: {config.sample_rate_hz} Hz, {ranges}"
        self._report.event(now_ns, Severity.INFO, "started", text)

    def _restart_fifo(self, now_ns: int, at_least: int) -> None:
        """Empty the FIFO and start it; then name what was lost: what the clock says, ``at_least`` samples."""
        self._expected = {}
        self._bus.write(reg.FIFO_EN, 0)
        self._bus.write(reg.USER_CTRL, 0)
        self._bus.write(reg.USER_CTRL, reg.USER_FIFO_RESET)
        self._bus.write(reg.USER_CTRL, reg.USER_FIFO_EN)
        self._bus.byte(reg.INT_STATUS)  # clears the overflow
        self._temperature = None
        self._bus.write(reg.FIFO_EN, reg.FIFO_EN_ALL)
        reply = self._bus.read(reg.FIFO_COUNT_H, 2)
        queued = int.from_bytes(reply.data) // PACKET_BYTES
        if self._clock:
            self._lose(now_ns, max(self._clock.produced(reply.host_ns) - queued, self._next + at_least))
            if self._after_reset:
                self._clock.forget_phase()
        self._clock.observe(reply.host_ns, self._next + queued)
        self._expected = configuration(self.config, self._chip) | reg.STREAMING

    # Draining

    def _drain(self, now_ns: int) -> bool:
        """Take what the FIFO holds. False: it was empty."""
        reply = self._bus.read(reg.FIFO_COUNT_H, 2)
        count = int.from_bytes(reply.data)
        samples, part = divmod(min(count, self._chip.fifo_bytes), PACKET_BYTES)
        if count > self._chip.fifo_bytes - PACKET_BYTES:
            self._overflow(now_ns, samples, count)
            return True
        if part:
            self._discard(now_ns, "misaligned", samples, f"FIFO holds {count} bytes, no whole packets: it was reset")
            return True
        self._cause = ""
        if not samples:
            return False
        data, broke_off = self._burst(samples * PACKET_BYTES)
        if broke_off is None:
            try:  # only now, for it may have run over after it was counted
                if self._bus.byte(reg.INT_STATUS) & reg.FIFO_OFLOW:
                    self._overflow(now_ns, samples, count)
                    return True
            except OSError as error:
                broke_off = error
        rows = decode_packets(data, self.config)
        slip = first_misaligned(rows["temperature_raw"], self._temperature)
        self._sampled_ns = now_ns
        if slip is None:
            self._clock.observe(reply.host_ns, self._next + samples)
        good = self._hand_over(rows[:slip], reply.host_ns)
        if slip is not None:
            self._discard(now_ns, "misaligned", samples - good, "temperature word jumped: the FIFO was reset")
        elif broke_off is not None and broke_off.errno in NOT_ACKNOWLEDGED:
            raise broke_off  # the rest is still in the FIFO
        elif broke_off is not None:
            self._discard(now_ns, "bus_error", samples - good, f"FIFO read broke off {explain(broke_off)}")
        return True

    def _burst(self, left: int) -> tuple[bytes, OSError | None]:
        """``left`` bytes in transfers of whole packets; fewer, and the reason, when the bus fails on the way."""
        longest = self.config.max_transfer_bytes // PACKET_BYTES * PACKET_BYTES
        pieces: list[bytes] = []
        while left:
            size = min(left, longest)
            try:
                pieces.append(self._bus.pop(reg.FIFO_R_W, size))
            except OSError as error:
                return b"".join(pieces), error
            left -= size
        return b"".join(pieces), None

    def _hand_over(self, rows: Rows, host_ns: int) -> int:
        """Number the rows and put them out; how many they were."""
        if not len(rows):
            return 0
        rows["sequence"] = rows["tick"] = np.arange(self._next, self._next + len(rows), dtype=np.uint64)
        rows["host_ns"] = host_ns
        if self._after_reset:
            rows["status"][0] |= SampleStatus.AFTER_RESET
            self._after_reset = False
        self._temperature = int(rows["temperature_raw"][-1])
        self._next += len(rows)
        self._report.rows(self.name, rows)
        return len(rows)

    def _overflow(self, now_ns: int, samples: int, count: int) -> None:
        text = f"FIFO ran over, {count} bytes counted: it was reset; pump more often"
        self._discard(now_ns, "fifo_overflow", samples + 1, text)

    def _discard(self, now_ns: int, cause: str, at_least: int, text: str) -> None:
        """Give up what the FIFO holds (``at_least`` samples are lost) and start it anew."""
        self._cause = self._cause or cause
        self._report.event(now_ns, Severity.WARNING, cause, text)
        self._restart_fifo(now_ns, at_least)

    def _lose(self, now_ns: int, up_to: int) -> None:
        """Name the samples from the next one up to, not including, ``up_to`` as lost, and go on from there."""
        if up_to > self._next:
            duration_ns = round((up_to - self._next) * self._clock.period_ns())
            self._report.gap(now_ns, self.name, self._next, up_to - 1, duration_ns, self._cause)
            self._next = up_to
        self._cause = ""

    # Watching

    def _look_into_silence(self, now_ns: int) -> None:
        """An empty FIFO: between two samples, or because the chip was reset, or sleeps, or is stuck."""
        silent_ns = now_ns - self._sampled_ns
        if silent_ns < max(5 * self.config.sample_period_ns, 2 * self.period_ns):
            return
        lost = self._mismatch()
        if lost is not None:
            self._configure_anew(now_ns, *lost)
        elif silent_ns > max(SILENCE_NS, 20 * self.config.sample_period_ns):
            text = "awake and configured, and makes no samples: it is reset"
            self._report.event(now_ns, Severity.ERROR, "no_samples", text)
            self._cause = "no_samples"
            self._after_reset = True
            self._begin(now_ns)

    def _check_one_register(self, now_ns: int) -> None:
        """Each register once in ``CHECK_ROUND_NS``, one at a time: a flipped bit must not scale the data for long."""
        self._checks += 1
        every = max(1, CHECK_ROUND_NS // (self.period_ns * max(len(self._expected), 1)))
        if self._checks % every:
            return
        registers = list(self._expected)
        register = registers[self._checks // every % len(registers)]
        value = self._bus.byte(register)
        if value != self._expected[register]:
            self._configure_anew(now_ns, register, value)

    def _mismatch(self) -> tuple[int, int] | None:
        """The first register that does not hold what was written, and what it holds."""
        for register, expected in self._expected.items():
            value = self._bus.byte(register)
            if value != expected:
                return register, value
        return None

    def _configure_anew(self, now_ns: int, register: int, value: int) -> None:
        brown_out = register == reg.PWR_MGMT_1 and bool(value & reg.SLEEP)
        self._cause = "brown_out" if brown_out else "configuration_lost"
        why = "it was reset, check its supply" if brown_out else f"rows up to 1 s before {self._next} are suspect"
        text = f"register {register:#04x} reads {value:#04x}: {why}"
        self._report.event(now_ns, Severity.ERROR, self._cause, text)
        self._after_reset = True
        self._begin(now_ns)

    # Away

    def _fault(self, now_ns: int, error: OSError) -> None:
        self._cause = self._cause or "bus_error"
        text = f"{self.name}: I2C {self.config.address:#x} fails {explain(error)}"
        self._stay_away(now_ns, "bus_error", NoAnswerError(text))

    def _stay_away(self, now_ns: int, code: str, error: DriverError) -> None:
        """Tell once, then try again after a back-off that doubles up to a second."""
        text = str(error)
        if text != self._told:
            self._report.event(now_ns, Severity.ERROR, code, text)
            self._told = text
        if self._away_since_ns is None:
            self._away_since_ns = now_ns
        self._state, self._deadline_ns = _State.AWAY, now_ns + self._backoff_ns
        self._backoff_ns = min(2 * self._backoff_ns, LONGEST_BACKOFF_NS)

    def _recovered(self, now_ns: int) -> None:
        if self._away_since_ns is not None:
            away_ms = (now_ns - self._away_since_ns) // 1_000_000
            self._report.event(now_ns, Severity.INFO, "bus_recovered", f"answers again after {away_ms} ms")
        self._away_since_ns = None
        self._told = ""
        self._backoff_ns = BACKOFF_NS
