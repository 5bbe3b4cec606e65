"""Base of drivers of I2C devices: set-up in steps, watch over the registers, back-off, recovery.

A driver says how it is set up (a generator that yields the time to wait before its next step), which registers it
expects while it runs, and how samples are taken. A failed transfer, a wrong device or a register that cannot be written
sends it away for a time that doubles up to one second. A device that kept its registers continues where it was; one
that lost them, by a brown-out or a flipped bit, is set up again.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from enum import Enum, auto
from typing import NamedTuple

from drivers.errors import ConfigurationError, DriverError, WrongDeviceError
from drivers.i2c.bus import RegisterBus, explain
from drivers.ports import I2cPort
from drivers.records import Batch, Severity
from drivers.reporter import Absence, Reporter

MS = 1_000_000
CHECK_ROUND_NS = 1000 * MS  # in which every register is looked at once


class Watched(NamedTuple):
    """A register and its value while the device runs, under ``mask``; ``reset``: its value after a loss of power."""

    register: int
    value: int
    reset: int
    mask: int = 0xFF


class _State(Enum):
    STOPPED = auto()
    AWAY = auto()  # or being set up: continued at the deadline
    RUNNING = auto()


class I2cSensor(ABC):
    """A device of registers. See ``drivers.device.Device``.

    Args:
        name: Channel, and source of its events.
        port: The bus.
        address: 7-bit address.
        poll_period_ns: Time between two pumps.
    """

    def __init__(self, name: str, port: I2cPort, address: int, poll_period_ns: int) -> None:
        self.name = name
        self._address = address
        self._where = f"I2C {address:#x}"
        self._bus: RegisterBus = RegisterBus(port, address)
        self._report = Reporter(name)
        self._poll_ns = self._wait_ns = poll_period_ns
        self._state = _State.STOPPED
        self._steps: Iterator[int] | None = None
        self._configured = False  # since then its registers are as expected
        self._deadline_ns = 0
        self._absence = Absence(self._report)
        self._cause = ""  # the first one since samples were taken
        self._checked_ns = 0
        self._check = 0

    @property
    def period_ns(self) -> int:
        """Time until the next pump, ns."""
        return self._wait_ns

    @property
    def bus_errors(self) -> int:
        """Failed transfers, including those whose retry succeeded."""
        return self._bus.errors

    @property
    def is_running(self) -> bool:
        """Whether samples are taken."""
        return self._state is _State.RUNNING

    @abstractmethod
    def _set_up(self) -> Iterator[int]:
        """Probe and configure the device; yields ns to wait before the next step.

        Raises:
            DriverError: It is another device, or it cannot be set up.
            OSError: The bus failed.
        """

    @abstractmethod
    def _begin(self, now_ns: int, anew: bool) -> str:
        """Samples are taken from now on; ``anew``: it was set up again. Returns the text of the event."""

    @abstractmethod
    def _take(self, now_ns: int) -> None:
        """Read what there is. Raises OSError."""

    def _interrupt(self, cause: str) -> None:
        """No samples are taken from now on, because of ``cause``."""
        self._cause = self._cause or cause

    @abstractmethod
    def _finish(self, now_ns: int) -> str:
        """Record what is missing at the end; returns what is said of the flight."""

    @abstractmethod
    def _sleep(self, now_ns: int) -> None:
        """Put the device to rest. Raises OSError."""

    @abstractmethod
    def _watched(self) -> list[Watched]:
        """Its registers while it runs."""

    def start(self, now_ns: int) -> list[Batch]:
        """See ``drivers.device.Device``."""
        self._configured, self._steps = False, None
        self._absence.forget()
        self._state, self._deadline_ns = _State.AWAY, now_ns
        self._advance(now_ns)
        return self._report.take()

    def pump(self, now_ns: int, timeout_s: float = 0.0) -> list[Batch]:
        """Read samples, or take the next step of the set-up when due. ``timeout_s`` is not used."""
        del timeout_s
        self._advance(now_ns)
        return self._report.take()

    def stop(self, now_ns: int) -> list[Batch]:
        """Take what is waiting, put the device to sleep, record what is missing."""
        if self._state is _State.RUNNING:
            try:
                self._take(now_ns)
                self._sleep(now_ns)
            except OSError as error:
                self._fault(now_ns, error)
        if self._state is not _State.STOPPED:
            text = f"stopped after {self._finish(now_ns)}, {self.bus_errors} failed transfers"
            self._report.event(now_ns, Severity.INFO, "stopped", text)
        self._state = _State.STOPPED
        self._report.flush(now_ns)
        return self._report.take()

    def _advance(self, now_ns: int) -> None:
        try:
            if self._state is _State.RUNNING:
                self._take(now_ns)
                self._check_one(now_ns)
            elif self._state is _State.AWAY and now_ns >= self._deadline_ns:
                self._step(now_ns)
        except DriverError as error:
            code = "wrong_device" if isinstance(error, WrongDeviceError) else "configuration"
            self._stay_away(now_ns, code, error)
        except OSError as error:
            self._fault(now_ns, error)

    def _step(self, now_ns: int) -> None:
        anew = not self._configured
        if not anew:
            lost = next(self._differing(), None)
            if lost is not None:
                self._lose_configuration(now_ns, *lost)
                return
        else:
            self._steps = self._steps or self._set_up()
            wait_ns = next(self._steps, None)
            if wait_ns is not None:
                self._deadline_ns = now_ns + wait_ns
                return
        self._steps, self._configured = None, True
        self._state, self._checked_ns = _State.RUNNING, now_ns
        self._absence.end(now_ns)
        said = self._begin(now_ns, anew)
        if anew:
            self._report.event(now_ns, Severity.INFO, "started", said)

    # Registers

    def _write(self, register: int, value: int, mask: int = 0xFF) -> None:
        """Write a register and read it back.

        Raises:
            ConfigurationError: It reads another value, under ``mask``.
        """
        self._bus.write(register, value)
        read = self._bus.byte(register)
        if (read ^ value) & mask:
            raise ConfigurationError(
                f"{self.name}: register {register:#04x} reads {read:#04x}, not {value:#04x}: replace the chip"
            )

    def _differing(self) -> Iterator[tuple[Watched, int]]:
        """Each register that is not as expected, with its value."""
        for watched in self._watched():
            value = self._bus.byte(watched.register)
            if (value ^ watched.value) & watched.mask:
                yield watched, value

    def _check_one(self, now_ns: int) -> None:
        """Verify one register at a time, each once in ``CHECK_ROUND_NS``."""
        watched = self._watched()
        if self._state is not _State.RUNNING or now_ns - self._checked_ns < CHECK_ROUND_NS // len(watched):
            return
        self._checked_ns = now_ns
        self._check = (self._check + 1) % len(watched)
        one = watched[self._check]
        value = self._bus.byte(one.register)
        if (value ^ one.value) & one.mask:
            self._lose_configuration(now_ns, one, value)

    def _lose_configuration(self, now_ns: int, watched: Watched, value: int) -> None:
        brown_out = value & watched.mask == watched.reset & watched.mask
        cause = "brown_out" if brown_out else "configuration_lost"
        why = "it was reset, check its supply" if brown_out else "samples of up to 1 s before may be wrong"
        text = f"register {watched.register:#04x} reads {value:#04x}: {why}"
        self._report.event(now_ns, Severity.ERROR, cause, text)
        self._set_up_again(now_ns, cause)

    def _set_up_again(self, now_ns: int, cause: str) -> None:
        self._interrupt(cause)
        self._configured, self._steps, self._wait_ns = False, None, self._poll_ns
        self._state, self._deadline_ns = _State.AWAY, now_ns

    # Away

    def _fault(self, now_ns: int, error: OSError) -> None:
        code = "bus_error" if self._configured else "no_answer"
        text = f"{self.name}: {self._where} does not answer {explain(error)}"
        self._stay_away(now_ns, code, DriverError(text))

    def _stay_away(self, now_ns: int, code: str, error: DriverError) -> None:
        """Report once, then retry after a back-off that doubles up to one second."""
        self._state, self._deadline_ns = _State.AWAY, self._absence.begin(now_ns, code, str(error))
        self._interrupt(code)
        self._steps, self._wait_ns = None, self._poll_ns
