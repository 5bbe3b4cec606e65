"""MPU-6050 device: set-up, sample transfer, detection of lost configuration and of a missing chip, recovery."""

from collections.abc import Callable
from enum import Enum, auto

from drivers.errors import ConfigurationError, DriverError, NoAnswerError, WrongDeviceError
from drivers.i2c.bus import RegisterBus, explain
from drivers.inertial.stream import MARKED, SampleStream
from drivers.mpu6050 import registers as reg
from drivers.mpu6050.burst import Burst
from drivers.mpu6050.fifo import Mpu6050Fifo
from drivers.mpu6050.noise import most_repeats
from drivers.mpu6050.registers import CHIPS, INCOMPATIBLE, Chip, Mpu6050Config, configuration
from drivers.mpu6050.self_test import SelfTest, run_self_test
from drivers.ports import I2cPort
from drivers.records import Batch, Severity
from drivers.repeats import Repeats
from drivers.reporter import Absence, Reporter

RESET_NS = 100_000_000  # after DEVICE_RESET
RESET_LIMIT_NS = 1_000_000_000
WAKE_NS = 100_000_000  # gyro start-up 60 ms, PLL 10 ms, zero-rate settling 30 ms (PS 6.1)
SILENCE_NS = 100_000_000
CHECK_ROUND_NS = 1_000_000_000
LAST_DRAINS = 8
WATCHED = 11  # largest number of registers checked per round


class _State(Enum):
    STOPPED = auto()
    AWAY = auto()  # no or wrong answer: retried at the deadline
    RESETTING = auto()
    WAKING = auto()
    RUNNING = auto()


class Mpu6050:
    """An MPU-6050 on an ``I2cPort``, as IMU rows on the channel of its name.

    ``sequence`` and ``tick`` are both the sample number since the first start, lost samples included. Rows of one drain
        share ``host_ns``: the stamp of the FIFO_COUNT read, when the newest sample was less than one period old. In
        burst mode each row has the stamp of its own transfer.

    Args:
        name: Channel, and source of its events.
        port: The bus.
        config: Ranges, rate, filter, mode.
    """

    def __init__(self, name: str, port: I2cPort, config: Mpu6050Config | None = None) -> None:
        self.name = name
        self.config = Mpu6050Config() if config is None else config
        self._bus = RegisterBus(port, self.config.address)
        self._report = Reporter(name)
        repeats = Repeats(most_repeats(self.config), self._report)
        self._stream = SampleStream(name, self.config.sample_period_ns, repeats, self._report)
        self._source: Mpu6050Fifo | Burst = (
            Mpu6050Fifo(self.config, self._bus, self._stream, self._report)
            if self.config.mode == "fifo"
            else Burst(self.config, self._bus, self._stream)
        )
        self._state = _State.STOPPED
        self._chip = CHIPS[0x68]
        self._deadline_ns = 0
        self._reset_ns = 0
        self._absence = Absence(self._report)
        self._sampled_ns = 0
        self._checks = 0

    @property
    def period_ns(self) -> int:
        """Time between two pumps, ns."""
        return self._source.period_ns

    @property
    def bus_errors(self) -> int:
        """Failed transfers, including those whose retry succeeded."""
        return self._bus.errors

    def probe(self) -> Chip:
        """Read WHO_AM_I.

        Raises:
            NoAnswerError: No device answers at the address.
            WrongDeviceError: Another device answers.
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
            f"{where} has WHO_AM_I {value:#04x} ({what}), MPU-6050 has 0x68: fit that chip or correct the address"
        )

    def self_test(self, wait: Callable[[float], object]) -> SelfTest:
        """Preflight self test: electrostatic actuation of the proof masses, response compared with the factory trim.

        Takes 1.3 s, during which the chip must be at rest; its settings are restored.

        Args:
            wait: Sleeps for that many seconds (``time.sleep``).

        Returns:
            Deviations from the factory trim.

        Raises:
            SelfTestError: An axis deviates by more than 14 %, or has no factory trim.
            ConfigurationError: It is streaming, or it is a clone with another trim coding.
            NoAnswerError: No device answers, or it stopped answering during the test.
            WrongDeviceError: Another device answers.
        """
        if self._state is not _State.STOPPED:
            raise ConfigurationError(f"{self.name} is streaming: stop it, then test it")
        chip = self.probe()
        if chip is not CHIPS[0x68]:
            raise ConfigurationError(f"{self.name} is an {chip.name}: its factory trim is not known here, test by hand")
        try:
            return run_self_test(self.name, self._bus, wait)
        except OSError as error:
            where = f"{self.name}: I2C {self.config.address:#x}"
            raise NoAnswerError(f"{where} fails in its self test {explain(error)}") from error

    def start(self, now_ns: int) -> list[Batch]:
        """Probe and reset the chip; ``pump`` continues the set-up. See ``drivers.device.Device``."""
        self._stream.begin()
        self._begin(now_ns)
        return self._report.take()

    def pump(self, now_ns: int, timeout_s: float = 0.0) -> list[Batch]:
        """Read samples, or take the next set-up step when due. ``timeout_s`` is not used."""
        del timeout_s
        try:
            if self._state is _State.RUNNING:
                if self._take(now_ns):
                    self._check_one_register(now_ns)
                else:
                    self._look_into_silence(now_ns)
            elif self._state is not _State.STOPPED and now_ns >= self._deadline_ns:
                self._step(now_ns)
        except OSError as error:
            self._fault(now_ns, error)
        return self._report.take()

    def rests_until(self, now_ns: int) -> int:
        """See ``drivers.device.Rests``: samples may wait in the FIFO: marks and not arrivals give their times."""
        rests = self._state is _State.RUNNING and self._stream.marks > MARKED
        return now_ns + self._source.rests_ns if rests else now_ns

    def stop(self, now_ns: int) -> list[Batch]:
        """Stop sampling, read the rest, put the chip to sleep. Samples that cannot be read are a gap."""
        if self._state is _State.RUNNING:
            try:
                for _ in range(LAST_DRAINS):
                    self._source.silence()
                    if not self._take(now_ns):
                        break
                self._bus.write(reg.USER_CTRL, 0)
                self._bus.write(reg.PWR_MGMT_1, reg.SLEEP)
            except OSError as error:
                self._fault(now_ns, error)
        stream = self._stream
        if stream.cause and stream.clock:
            stream.lose(now_ns, stream.clock.produced(now_ns))
        if self._state is not _State.STOPPED:
            text = f"stopped after {stream.next} samples, {self.bus_errors} failed transfers"
            self._report.event(now_ns, Severity.INFO, "stopped", text)
        self._state = _State.STOPPED
        self._source.running = False
        self._report.flush(now_ns)
        return self._report.take()

    # Setting up

    def _begin(self, now_ns: int) -> None:
        self._source.running = False
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
            self._chip = self._source.chip = chip
            self._state, self._reset_ns, self._deadline_ns = _State.RESETTING, now_ns, now_ns + RESET_NS

    def _step(self, now_ns: int) -> None:
        if self._state is _State.AWAY:
            if self._source.running and self._mismatch() is None:
                self._state = _State.RUNNING
                self._sampled_ns = now_ns
                self._absence.end(now_ns)
                self._take(now_ns)
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
        """Write the configuration, verify it by reading back, start the stream."""
        settings = configuration(self.config, self._chip)
        for register, value in settings.items():
            self._bus.write(register, value)
        for register, value in settings.items():
            read = self._bus.byte(register)
            if read != value:
                text = f"{self.name}: register {register:#04x} reads {read:#04x}, not {value:#04x}: replace the chip"
                self._stay_away(now_ns, "configuration", ConfigurationError(text))
                return
        self._source.restart(now_ns)
        self._state = _State.RUNNING
        self._sampled_ns = now_ns
        self._absence.end(now_ns)
        config = self.config
        ranges = f"{config.accel_range_g} g, {config.gyro_range_deg_s} deg/s, DLPF {config.filter_code}"
        text = f"{self._chip.name} runs: {config.sample_rate_hz} Hz, {ranges}"
        self._report.event(now_ns, Severity.INFO, "started", text)

    # Watching

    @property
    def _expected(self) -> dict[int, int]:
        """Register values expected while it runs."""
        return configuration(self.config, self._chip) | self._source.registers if self._source.running else {}

    def _take(self, now_ns: int) -> bool:
        """Read the available samples; False if there are none."""
        took = self._source.take(now_ns)
        if took:
            self._sampled_ns = now_ns
        return took

    def _look_into_silence(self, now_ns: int) -> None:
        """No samples: decide between normal timing and a chip that was reset, sleeps or is stuck."""
        silent_ns = now_ns - self._sampled_ns
        if silent_ns < max(5 * self.config.sample_period_ns, 2 * self.period_ns):
            return
        lost = self._mismatch()
        if lost is not None:
            self._reconfigure(now_ns, *lost)
        elif silent_ns > max(SILENCE_NS, 20 * self.config.sample_period_ns):
            text = "no samples although awake and configured: the chip is reset"
            self._report.event(now_ns, Severity.ERROR, "no_samples", text)
            self._stream.cause = "no_samples"
            self._stream.after_reset = True
            self._begin(now_ns)

    def _check_one_register(self, now_ns: int) -> None:
        """Verify one register per call, each once in ``CHECK_ROUND_NS``: limits how long a flipped bit affects data."""
        self._checks += 1
        every = max(1, CHECK_ROUND_NS // (self.period_ns * WATCHED))
        if self._checks % every:
            return
        registers = list(self._expected.items())
        register, expected = registers[self._checks // every % len(registers)]
        value = self._bus.byte(register)
        if value != expected:
            self._reconfigure(now_ns, register, value)

    def _mismatch(self) -> tuple[int, int] | None:
        """Address and value of the first register that differs from the value written; None if none does."""
        for register, expected in self._expected.items():
            value = self._bus.byte(register)
            if value != expected:
                return register, value
        return None

    def _reconfigure(self, now_ns: int, register: int, value: int) -> None:
        power = value if register == reg.PWR_MGMT_1 else self._bus.byte(reg.PWR_MGMT_1)
        brown_out = bool(power & reg.SLEEP)  # as after a reset, whichever register was looked at first
        cause = "brown_out" if brown_out else "configuration_lost"
        why = (
            "it was reset, check its supply" if brown_out else f"rows up to 1 s before {self._stream.next} may be wrong"
        )
        text = f"register {register:#04x} reads {value:#04x}: {why}"
        self._report.event(now_ns, Severity.ERROR, cause, text)
        self._stream.cause = cause
        self._stream.after_reset = True
        self._begin(now_ns)

    # Away

    def _fault(self, now_ns: int, error: OSError) -> None:
        self._stream.cause = self._stream.cause or "bus_error"
        text = f"{self.name}: I2C {self.config.address:#x} fails {explain(error)}"
        self._stay_away(now_ns, "bus_error", NoAnswerError(text))

    def _stay_away(self, now_ns: int, code: str, error: DriverError) -> None:
        """Report once, then retry after a back-off that doubles up to one second."""
        self._state, self._deadline_ns = _State.AWAY, self._absence.begin(now_ns, code, str(error))
