"""Channels of a recording from elsewhere (``heft import``): no bus, and host stamps that are the times of samples."""

from typing import Literal

from drivers.records import IMU, SCALAR
from onboard.config.devices.base import DeviceSection, ImuDevice, LoadCellKeys
from onboard.config.types import Positive


class RecordedDevice(DeviceSection):
    """A recorded channel."""

    period_ms: Positive

    @property
    def nominal_hz(self) -> float:
        """Nominal."""
        return 1e3 / self.period_ms


class RecordedImu(RecordedDevice, ImuDevice):
    """An IMU."""

    records = IMU
    kind: Literal["recorded_imu"]


class RecordedAngle(RecordedDevice):
    """A joint angle; ``zero_count``: the raw value at angle zero."""

    records = SCALAR
    kind: Literal["recorded_angle"]
    joint: str
    zero_count: int = 0
    noise_rad: Positive


class RecordedRate(RecordedDevice):
    """A joint rate; the joint turns a body of revolution, its angle is of no account."""

    records = SCALAR
    kind: Literal["recorded_rate"]
    joint: str
    noise_rad_s: Positive


class RecordedLoadCell(RecordedDevice, LoadCellKeys):
    """A load cell, or one axis of a six-axis one: a moment is in N m, where ``lever_m`` is not given."""

    records = SCALAR
    kind: Literal["recorded_load_cell"]


class RecordedValue(RecordedDevice):
    """A value of no role of its own: a phase, say."""

    records = SCALAR
    kind: Literal["recorded_value"]
