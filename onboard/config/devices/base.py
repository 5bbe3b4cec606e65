"""What every kind of device has, and the three things that one can measure for the estimator."""

from dataclasses import fields
from enum import StrEnum
from typing import Any, ClassVar, Literal, TypeVar

import numpy as np

from onboard.config.types import NotNegative, Positive, Section, Vector3

STANDARD_GRAVITY_M_S2 = 9.80665
Channels = dict[str, np.dtype[np.void]]
C = TypeVar("C")


class BusType(StrEnum):
    """What a device is plugged into."""

    I2C = "I2C"
    CAN = "CAN"
    SERIAL = "a serial line"
    PULSE = "a pulse line"
    PULSE_OUTPUT = "a pulse output"


class DeviceSection(Section):
    """A ``[device.NAME]`` table. ``kind`` says which."""

    records: ClassVar[np.dtype[np.void]]
    kind: str

    def channels(self, name: str) -> Channels:
        """Its channels and their records, in a fixed order."""
        return {name: self.records}

    @property
    def nominal_hz(self) -> float | None:
        """Nominal rate of its samples; None: one for each SYNC of its bus."""
        raise NotImplementedError


class BusDevice(DeviceSection):
    """A device on a bus of the file."""

    bus_type: ClassVar[BusType]
    bus: str

    def settings(self, name: str) -> Any:
        """The configuration of its driver.

        Raises:
            ConfigurationError: values that do not go together.
        """
        raise NotImplementedError

    def _settings(self, kind: type[C], **others: Any) -> C:
        """A driver's configuration: the keys that have the same name here, and ``others``."""
        same = {field.name for field in fields(kind) if field.name in type(self).model_fields}  # type: ignore[arg-type]
        return kind(**{name: getattr(self, name) for name in same} | others)


class ImuDevice(DeviceSection):
    """It measures specific force and angular rate in the axes of the URDF's ``frame``; noise is that of one sample."""

    frame: str
    accel_noise_m_s2: Positive
    gyro_noise_rad_s: Positive


class JointDevice(BusDevice):
    """It measures the angle of ``joint``: ``zero_count`` is what it reads at angle zero.

    On the motor's side of a gear it errs with the motor's turns: ``eccentricity_rad`` once, ``transmission_error_rad``
    twice in each.
    """

    joint: str
    counts_per_revolution: int
    zero_count: int = 0
    noise_rad: Positive
    gear_ratio: Positive = 1.0
    eccentricity_rad: NotNegative = 0.0
    transmission_error_rad: NotNegative = 0.0


class LoadCellKeys(Section):
    """A force along an axis, or a moment about one.

    ``measures = "moment"``: the cell's force times ``lever_m`` is the moment about ``axis`` of ``frame`` that the
    actuator exerts on everything beyond that frame. ``measures = "force"``: its force along ``axis``.
    """

    frame: str
    axis: Vector3
    measures: Literal["moment", "force"]
    lever_m: Positive = 1.0
    lever_sigma_m: NotNegative = 0.0
    capacity_N: Positive  # noqa: N815  (the newton's own letter)
    scale_sigma: NotNegative = 0.0
    noise_N: Positive  # noqa: N815
    delay_ms: NotNegative = 0.0
    delay_sigma_ms: NotNegative = 0.0
    gravity_m_s2: Positive = STANDARD_GRAVITY_M_S2


class LoadCellDevice(BusDevice, LoadCellKeys):
    """A load cell that is a device of its own.

    ``gravity_m_s2``: what one of its kilograms weighs, where it tells kilograms.
    """
