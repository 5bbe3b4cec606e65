"""Roles of a device in the estimator: IMU, joint angle or rate, load cell; conversion of its rows."""

import math
from collections.abc import Mapping
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field

from onboard.estimation.arrays import FloatArray
from onboard.estimation.smoothing import filtered_inflation
from onboard.section import NotNegative, Positive, Real, Section, Vector3

STANDARD_GRAVITY_M_S2 = 9.80665
ZERO_SIGMA_RAD = 1e-3  # of a joint's zero where its device is silent
ANGLE = {b"rad": 1.0, b"deg": math.pi / 180.0}
RATE = {b"rad/s": 1.0, b"deg/s": math.pi / 180.0}
FORCE = {b"N": 1.0}
SPECIFIC_FORCE = {b"m/s^2": 1.0, b"g": STANDARD_GRAVITY_M_S2}


class Correction(NamedTuple):
    """A calibration, taken off readings: these are ``matrix @ true + bias``, SI."""

    matrix: tuple[tuple[float, ...], ...]  # (k, k)
    bias: tuple[float, ...]  # (k,)

    def taken_off(self, readings: FloatArray) -> FloatArray:
        """True values from readings, (n, k)."""
        return np.asarray((readings - np.array(self.bias)) @ np.linalg.inv(np.array(self.matrix)).T, np.float64)


def corrections(gain: float, offset: float) -> tuple[Correction, ...]:
    """Of a channel of one value that reads ``gain x true + offset``; none where it reads the truth."""
    return () if (gain, offset) == (1.0, 0.0) else (Correction(((gain,),), (offset,)),)


class LoadCellKeys(Section):
    """A force along an axis, or a moment about it; it reads ``gain`` newton for each, and ``offset_N`` without load.

    ``measures = "moment"``: the cell's force times ``lever_m`` is the moment about ``axis`` of ``frame`` that the
    actuator exerts on everything beyond that frame. ``measures = "force"``: its force along ``axis``.
    """

    frame: str
    axis: Vector3
    measures: Literal["moment", "force"]
    lever_m: Positive = 1.0
    lever_sigma_m: NotNegative = 0.0
    capacity_N: Positive  # noqa: N815  (the newton's letter)
    scale_sigma: NotNegative = 0.0
    noise_N: Positive  # noqa: N815
    zero_sigma_N: Annotated[  # noqa: N815
        Positive | None, Field(description="ExIDDM: 1 sigma of its reading at no load; 1 % of capacity_N if silent.")
    ] = None
    zero_drift_N_s: Annotated[  # noqa: N815
        Positive | None,
        Field(description="1 sigma of its zero's drift; 1e-5 of capacity_N a second if silent."),
    ] = None
    delay_ms: NotNegative = 0.0
    delay_sigma_ms: NotNegative = 0.0
    gravity_m_s2: Positive = STANDARD_GRAVITY_M_S2
    gain: Positive = 1.0
    offset_N: Real = 0.0  # noqa: N815
    calibrated: str = ""

    @property
    def drift_N_s(self) -> float:  # noqa: N802
        """1 sigma of the drift of its zero, as stated or as of a silent file."""
        return 1e-5 * self.capacity_N if self.zero_drift_N_s is None else self.zero_drift_N_s

    @property
    def relative_sigma(self) -> float:
        """Relative 1 sigma common to all readings: calibration and lever."""
        lever = self.lever_sigma_m / self.lever_m if self.measures == "moment" else 0.0
        return math.hypot(self.scale_sigma, lever)

    @property
    def shown(self) -> tuple[str, float]:
        """Unit in texts, and the factor from a reading to it."""
        return ("mN m", 1e3 * self.lever_m) if self.measures == "moment" else ("N", 1.0)

    @property
    def meaning(self) -> str:
        """The measured quantity, in words."""
        axis = ", ".join(f"{part:g}" for part in self.axis)
        how = f"along ({axis})" if self.measures == "force" else f"whose moment about ({axis})"
        lever = f", lever {self.lever_m:g} m" if self.measures == "moment" else ""
        return f"force of the load cell {how} of frame {self.frame}{lever}"


class TorqueKeys(Section):
    """The torque of a joint's actuator (force of a sliding one), or its motor's current; of a free base, by ExIDDM too.

    The reading is ``(1 + scale) (torque + friction + rotor inertia + offset)``; friction, rotor inertia and offset are
    parameters ``Fc_``, ``Fv_``, ``Ia_<joint>`` and ``bias_<device>`` with sigmas in [estimation.prior.absolute].
    """

    joint: Annotated[str, Field(description="Name of the URDF's joint.")]
    sigma_N_m: Annotated[Positive, Field(description="1 sigma of the model's error of a smoothed reading.")]  # noqa: N815
    gain_N_m_A: Annotated[  # noqa: N815
        Positive | None, Field(description="Joint torque per ampere; for readings in A.")
    ] = None
    scale_sigma: Annotated[NotNegative, Field(description="Relative 1 sigma of gain or calibration.")] = 0.0
    friction: Annotated[bool, Field(description="Whether friction and rotor inertia are parameters.")] = True
    presliding_rad: Annotated[
        NotNegative, Field(description="Presliding length of Coulomb friction after a reversal (Dahl); 0: none.")
    ] = 0.0
    still_rad_s: Annotated[NotNegative, Field(description="Joint rate below which the row is left out.")] = 0.0
    delay_ms: Annotated[
        Real,
        Field(description="Of its samples against the joints'; negative: they are stamped before they were taken."),
    ] = 0.0
    delay_sigma_ms: NotNegative = 0.0

    @property
    def relative_sigma(self) -> float:
        """Relative 1 sigma common to all readings."""
        return self.scale_sigma

    @property
    def changed_sigma(self) -> float:
        """Relative 1 sigma of the gain with the payload against that without; 0: one gain."""
        return 0.0

    @property
    def shown(self) -> tuple[str, float]:
        """Unit in texts, and the factor from a reading to it."""
        return "N m", 1.0

    @property
    def meaning(self) -> str:
        """The measured quantity, in words."""
        return f"torque of joint {self.joint}, or the current of its motor"


class SmoothedChannel(NamedTuple):
    """A smoothed channel and its properties.

    Attributes:
        delays_s: of the filter of each of its columns.
        noise: standard deviation of a sample of each column, SI.
        period_s: nominal.
        si: SI units in each unit that its rows may carry; empty for IMU rows, whose units are fixed.
        zero_count: raw value at zero.
        limit: values as large as this are saturated, SI.
        absolute: it keeps its zero over a reset of its device.
        ripple: its cyclic errors: periods of each in a radian of what it measures, times 2 pi, and its rms, SI.
        corrections: its calibration, of its columns in their order: gyro and accelerometer, or one value; or none.
        inflation: of the sigma of a mean of its samples: its own filter makes neighbours alike.
    """

    delays_s: tuple[float, ...]
    noise: tuple[float, ...]
    period_s: float
    si: Mapping[bytes, float]
    zero_count: int = 0
    limit: float = math.inf
    absolute: bool = True
    ripple: tuple[tuple[float, float], ...] = ()
    is_pose: bool = False  # attitude w, x, y, z and position x, y, z of a tracker
    quantum_counts: float = 1.0  # between readings that differ least: a recording is rounded to more than its counts
    repeats: bool = False  # its recorder may write a reading again: equal ones do not show that it is stuck
    corrections: tuple[Correction, ...] = ()
    inflation: float = 1.0

    def corrected(self, readings: FloatArray) -> FloatArray:
        """True values from readings, SI, (n, columns)."""
        if not self.corrections:
            return readings
        parts = np.split(readings, len(self.corrections), axis=1)
        return np.hstack([one.taken_off(part) for one, part in zip(self.corrections, parts, strict=True)])

    @property
    def travels(self) -> bool:
        """Whether it is the angle of a joint, whose noise is quantisation: at rest it repeats."""
        return b"rad" in self.si


class ImuRole(NamedTuple):
    """Channels of gyro x, y, z, accel x, y, z in this order, in one or one by one; the URDF's frame they measure in."""

    channels: tuple[str, ...]
    frame: str
    gyro_scale_sigma: float = 0.0  # relative, of the calibration; considered by rows, as all below
    accel_scale_sigma: float = 0.0
    kelvin_per_count: float = 0.0  # of its temperature word; 0: it has none, or its scale is not known
    misalignment_sigma_rad: float = 0.0
    delay_sigma_s: float = 0.0


class JointRole(NamedTuple):
    """The channel of a joint's angle, or of its rate where ``is_rate``."""

    joint: str
    channel: str
    is_rate: bool = False
    scale_sigma: float = 0.0  # relative, of its counts a revolution; considered by rows
    zero_sigma_rad: float = 0.0  # of its zero; considered by rows
    delay_sigma_s: float = 0.0  # considered by rows


class LoadCellRole(NamedTuple):
    """A load cell, or the torque of a joint: the name of its row, its channel, what it measures."""

    name: str
    channel: str
    keys: LoadCellKeys | TorqueKeys
    delay_sigma_s: float = 0.0

    @property
    def titled(self) -> tuple[str, str]:
        """Title of its readings in figures, and their unit."""
        if isinstance(self.keys, TorqueKeys):
            return f"joint torque: {self.channel}", "N m"
        return f"load cell: {self.channel}", "N"


class ThrusterRole(NamedTuple):
    """A thruster: the channel of its force, along an axis of a frame and through its origin."""

    name: str
    channel: str
    frame: str
    axis: tuple[float, float, float]
    scale_sigma: float  # relative, of its force


class TrackerRole(NamedTuple):
    """A pose tracker: its channel, the frame that it sees, 1 sigma of its errors, and what its readings are."""

    channel: str
    frame: str
    acceleration_m_s2: float  # of its axes against free fall
    misalignment_rad: float  # of the frame
    place_m: float
    scale: float
    delay_s: float
    signal: SmoothedChannel


class Roles(NamedTuple):
    """The roles of a device or of a whole vehicle, and the signals by channel that fill them."""

    imus: list[ImuRole]
    joints: list[JointRole]
    cells: list[LoadCellRole]
    thrusters: list[ThrusterRole]
    trackers: list[TrackerRole]
    signals: dict[str, SmoothedChannel]

    @classmethod
    def none(cls) -> "Roles":
        """Roles of a device that is only recorded."""
        return cls([], [], [], [], [], {})

    def add(self, other: "Roles") -> None:
        """Add those of another device."""
        self.imus.extend(other.imus)
        self.joints.extend(other.joints)
        self.cells.extend(other.cells)
        self.thrusters.extend(other.thrusters)
        self.trackers.extend(other.trackers)
        self.signals.update(other.signals)

    @property
    def imu(self) -> ImuRole:
        """The one that measures the base."""
        return self.imus[0]


def scalar(delay_ms: float, noise: float, period_s: float, si: Mapping[bytes, float]) -> SmoothedChannel:
    """A channel of one value a row: delay of its filter, ms; noise of a sample, SI; its units."""
    return SmoothedChannel((delay_ms * 1e-3,), (noise,), period_s, si)


def force(keys: LoadCellKeys, period_s: float) -> SmoothedChannel:
    """The channel of a load cell: N or kg, or N m where its lever is 1 m."""
    direct = keys.measures == "moment" and keys.lever_m == 1.0
    si = {b"N m": 1.0} if direct else {b"N": 1.0, b"kg": keys.gravity_m_s2}
    return scalar(keys.delay_ms, keys.noise_N, period_s, si)._replace(
        limit=keys.capacity_N,
        corrections=corrections(keys.gain, keys.offset_N),
        inflation=filtered_inflation(max(keys.delay_ms, 0.0) * 1e-3, period_s),
    )
