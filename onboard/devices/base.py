"""Base classes of all kinds of device.

A kind is a :class:`DeviceSection` with ``kind: Literal["..."]``; methods not overridden have the defaults given here.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields
from typing import Any, ClassVar, NamedTuple, Protocol, TypeVar

import numpy as np

from drivers.device import Device
from drivers.play.player import PlayerConfig
from drivers.ports import SerialPort, Station
from drivers.records import Rows
from onboard.devices import roles
from onboard.devices.roles import Correction, ImuRole, JointRole, LoadCellKeys, LoadCellRole, Roles, SmoothedChannel
from onboard.section import IDENTITY, Gain, Matrix3, NotNegative, Positive, Section, Vector3, ZeroCount
from onboard.timebase.delays import Delay
from onboard.timebase.timebase import ChannelClock, FollowerChannel, SyncLine

Channels = dict[str, np.dtype[np.void]]
Clock = Callable[[], int]
Answering = Callable[[SerialPort, Callable[[float], object]], Iterator[Station]]
Heard = Callable[[Mapping[int, bytes]], Iterator[Station]]
Problem = tuple[list[str], str]
"""The key that is wrong, as a path from the top of the file, and a sentence with the remedy."""


class Surroundings(Protocol):
    """Interface of the vehicle to its devices."""

    def url(self, bus: str) -> str:
        """URL of a bus that is there, as it is opened."""

    def baud(self, bus: str) -> float:
        """Bit rate in the URL of a serial line or a CAN bus, as the vehicle file has it: a replay has no other."""

    def devices_on(self, bus: str) -> "Mapping[str, BusDevice]":
        """Devices by name on one bus."""

    @property
    def buses(self) -> list[str]:
        """Names of all buses."""

    def play(self, bus: str) -> PlayerConfig[Any] | None:
        """What the drives of a bus are to play; None: nothing."""


class DeviceSection(Section):
    """A ``[device.NAME]`` table. ``kind`` says which."""

    records: ClassVar[np.dtype[np.void]]
    about_role: ClassVar[str] = "none"  # for docs/devices.md: what it is to the estimator,
    about_clock: ClassVar[str]  # and what its samples' times are made of
    kind: str

    @property
    def nominal_hz(self) -> float:
        """Nominal rate of its samples, where it is its own: by its key of a rate or a period."""
        fields = type(self).model_fields
        for key in ("sample_rate_hz", "rate_hz"):
            if key in fields:
                return float(getattr(self, key))
        for key in ("sample_period_ms", "period_ms"):
            if key in fields:
                return 1e3 / float(getattr(self, key))
        raise NotImplementedError

    def rate_on(self, around: Surroundings) -> float:
        """Nominal rate of its samples."""
        return self.nominal_hz

    def channels(self, name: str) -> Channels:
        """Its channels and their records, in a fixed order."""
        return {name: self.records}

    def clocks(self, name: str, around: Surroundings) -> dict[str, ChannelClock]:
        """The clock of each channel whose samples are put on vehicle time."""
        return {}

    def sync_line(self, name: str) -> SyncLine | None:
        """The sync line, if that is what it reads."""
        return None

    def delays(self, name: str, around: Surroundings) -> list[Delay]:
        """Delays subtracted from its samples' times; may include zeros."""
        return []

    def roles(self, name: str, period_s: float) -> Roles:
        """Its roles in the estimator; ``period_s`` is the nominal sample period."""
        return Roles.none()

    def problems(self, name: str, around: Surroundings) -> Iterator[Problem]:
        """Errors of this table beyond single keys."""
        return iter(())


def first_leads(channels: Channels, clock: ChannelClock) -> dict[str, ChannelClock]:
    """The clock of the first channel, which the others are sampled by."""
    first, *others = channels
    return {first: clock, **dict.fromkeys(others, FollowerChannel(first))}


class Closable(Protocol):
    """What every port has."""

    def close(self) -> None:
        """Close the bus."""


P = TypeVar("P", bound=Closable)
C = TypeVar("C")


class OpeningBus(NamedTuple):
    """A bus to be opened: what is on it (kinds of one bus type), and who takes its ports."""

    name: str
    devices: Mapping[str, Any]
    around: Surroundings
    clock: Clock
    ports: list[Closable]

    @property
    def url(self) -> str:
        """Of the bus."""
        return self.around.url(self.name)

    def own(self, port: P) -> P:
        """Have a port closed with the bus."""
        self.ports.append(port)
        return port


class BusDevice(DeviceSection):
    """A device on a bus of the file; ``onboard.devices.buses`` has a base for each type of bus."""

    bus_type: ClassVar[str]
    urls: ClassVar[Mapping[str, tuple[str, ...]]]  # of its buses: options by scheme
    shares_bus: ClassVar[bool] = False
    driver_configs: ClassVar[tuple[type, ...]] = ()  # what its driver is configured by; the keys are explained there
    rate_tolerance: ClassVar[float] = 0.1  # of nominal_hz, before a preflight finds fault
    first_row_s: ClassVar[float] = 3.0  # from the start of a flight: a first row that is later has others before it
    marks_at_rest: ClassVar[bool] = True  # no sync pulse in its stream means that the line does not reach it
    new_keys: ClassVar[str] = ""  # its keys in a file that heft init makes, {number}: of its joint or node; else none
    new_bus: ClassVar[str] = ""  # its bus there; a serial line of its own if empty,
    new_baud: ClassVar[int] = 115_200  # of this speed
    new_url: ClassVar[str] = ""  # of that bus, where it is no line and its name does not say it
    answering: ClassVar[Answering | None] = None  # asks who is on an open line or connection; None: it cannot be asked
    heard: ClassVar[Heard | None] = None  # of a CAN bus that is none of CANopen's: by the last frame of each identifier
    bus: str

    @classmethod
    def open_on(cls, bus: OpeningBus) -> list[Device]:
        """Open a bus of this type and make the drivers on it.

        Raises:
            DriverError: a URL or a configuration that cannot be.
            OSError: the bus cannot be opened.
        """
        raise NotImplementedError

    @classmethod
    def bus_problems(cls, bus: str, devices: "Mapping[str, BusDevice]") -> Iterator[Problem]:
        """What is wrong with the devices of one bus together."""
        return iter(())

    def settings(self, name: str) -> Any:
        """The configuration of its driver: keys of the same name, by default.

        Raises:
            ConfigurationError: values that do not go together.
        """
        return self._settings(self.driver_configs[0]) if self.driver_configs else None

    def verify(self, name: str) -> None:
        """Raise ConfigurationError for values that do not go together."""
        self.settings(name)

    @property
    def tells_changes(self) -> bool:
        """Whether it sends on change and has no rate."""
        return False

    @property
    def tick_rate_hz(self) -> float | None:
        """Nominal rate of its rows' ``tick``, if a preflight can check it."""
        return None

    def marks(self, name: str, rows: Mapping[str, Rows]) -> int | None:
        """Sync pulses in its own stream; None: it has no input for them."""
        return None

    def _settings(self, kind: type[C], **others: Any) -> C:
        """A driver's configuration: the keys that have the same name here, and ``others``."""
        same = {field.name for field in fields(kind) if field.name in type(self).model_fields}  # type: ignore[arg-type]
        return kind(**{name: getattr(self, name) for name in same} | others)


class ImuDevice(DeviceSection):
    """It measures specific force and angular rate in the axes of the URDF's ``frame``; noise is that of a sample.

    ``accel_scale_sigma`` and ``gyro_scale_sigma``: of its calibration, relative; ``misalignment_sigma_rad``: of the
    axes of gyro and of accelerometer; ``delay_sigma_ms``: of the samples of either. Intervals by rows carry them.
    Readings are ``accel_matrix`` times the specific force plus ``accel_bias_m_s2``, and likewise of the gyro.
    """

    about_role = "IMU"
    frame: str
    accel_noise_m_s2: Positive
    gyro_noise_rad_s: Positive
    accel_scale_sigma: NotNegative = 0.0
    gyro_scale_sigma: NotNegative = 0.0
    misalignment_sigma_rad: NotNegative = 0.0
    delay_sigma_ms: NotNegative = 0.0
    accel_matrix: Matrix3 = IDENTITY
    accel_bias_m_s2: Vector3 = (0.0, 0.0, 0.0)
    gyro_matrix: Matrix3 = IDENTITY
    gyro_bias_rad_s: Vector3 = (0.0, 0.0, 0.0)
    calibrated: str = ""
    kelvin_per_count: ClassVar[float] = 0.0  # of the temperature word of its samples

    @property
    def filter_delays_s(self) -> tuple[float, float]:
        """Delays of the gyro's and of the accelerometer's filters."""
        return 0.0, 0.0

    def roles(self, name: str, period_s: float) -> Roles:
        """See ``DeviceSection``."""
        gyro_delay_s, accel_delay_s = self.filter_delays_s
        noise = (self.gyro_noise_rad_s,) * 3 + (self.accel_noise_m_s2,) * 3
        signal = SmoothedChannel((gyro_delay_s,) * 3 + (accel_delay_s,) * 3, noise, period_s, {})
        gyro, accel = (self.gyro_matrix, self.gyro_bias_rad_s), (self.accel_matrix, self.accel_bias_m_s2)
        if any(one != (IDENTITY, (0.0, 0.0, 0.0)) for one in (gyro, accel)):
            signal = signal._replace(corrections=(Correction(*gyro), Correction(*accel)))
        role = ImuRole(
            (name,),
            self.frame,
            self.gyro_scale_sigma,
            self.accel_scale_sigma,
            self.kelvin_per_count,
            self.misalignment_sigma_rad,
            1e-3 * self.delay_sigma_ms,
        )
        return Roles([role], [], [], [], [], {name: signal})


class JointDevice(BusDevice):
    """It measures the angle of ``joint``: ``zero_count`` is its reading at angle zero.

    Of a joint that slides it measures the travel: rad are metres, N m are newtons, and a revolution is 2 pi metres.

    On the motor side of a gear it has cyclic errors: ``eccentricity_rad`` once, ``transmission_error_rad`` twice per
    motor revolution, which are unknowns of the estimate; of one that has jumped they are noise. ``scale_sigma`` is of
    its counts per revolution, relative, ``zero_sigma_rad`` of its zero; the intervals of rows contain both.
    ``gain``: what it reads of one radian, by ``counts_per_revolution``; negative where it counts against the joint.
    """

    about_role = "joint angle"
    new_keys = """counts_per_revolution = 500000 # of the joint: quadrature and gear included
zero_count = 0                 # what it reads at joint angle zero
noise_rad = 4e-6               # a count / sqrt(12), plus what the gear adds
"""
    new_smoothing_ms: ClassVar[int] = 100  # of the rows, in a file that heft init makes: by its noise
    new_floating_smoothing_ms: ClassVar[int | None] = None  # of the joints of a base that floats; None: the same
    keeps_zero: ClassVar[bool] = True  # over a reset of the device
    joint: str
    counts_per_revolution: int
    zero_count: ZeroCount = 0
    noise_rad: Positive
    scale_sigma: NotNegative = 0.0
    zero_sigma_rad: NotNegative = roles.ZERO_SIGMA_RAD
    gear_ratio: Positive = 1.0
    eccentricity_rad: NotNegative = 0.0
    transmission_error_rad: NotNegative = 0.0
    gain: Gain = 1.0
    calibrated: str = ""

    def roles(self, name: str, period_s: float) -> Roles:
        """See ``DeviceSection``."""
        turns = self.gear_ratio
        ripple = (turns, self.eccentricity_rad), (2.0 * turns, self.transmission_error_rad)
        signal = roles.scalar(0.0, self.noise_rad, period_s, roles.ANGLE)._replace(
            zero_count=self.zero_count,
            absolute=self.keeps_zero,
            ripple=tuple(tone for tone in ripple if tone[1]),
            corrections=roles.corrections(self.gain, 0.0),
        )
        joint = JointRole(self.joint, name, False, self.scale_sigma, self.zero_sigma_rad)
        return Roles([], [joint], [], [], [], {name: signal})


class LoadCellDevice(BusDevice, LoadCellKeys):
    """A load cell as a separate device: its first channel is the force used by the estimator.

    ``gravity_m_s2``: newton per kilogram of its readings, if its unit is kg.
    """

    about_role = "load cell"
    new_delay: ClassVar[str] = """delay_ms = 0.5                 # yours: of its filter, against the joints'
delay_sigma_ms = 0.05
"""

    def roles(self, name: str, period_s: float) -> Roles:
        """See ``DeviceSection``."""
        channel = next(iter(self.channels(name)))
        return Roles([], [], [LoadCellRole(name, channel, self)], [], [], {channel: roles.force(self, period_s)})

    def delays(self, name: str, around: Surroundings) -> list[Delay]:
        """See ``DeviceSection``."""
        channel, cause = next(iter(self.channels(name))), "filter of the load cell's amplifier"
        return [Delay(channel, "", self.delay_ms * 1e-3, self.delay_sigma_ms * 1e-3, cause)]
