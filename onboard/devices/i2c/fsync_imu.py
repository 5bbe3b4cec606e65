"""IMUs whose samples carry the marks of the sync line on their FSYNC pin."""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from drivers.records import IMU, Rows
from onboard.devices.base import ImuDevice, Surroundings
from onboard.devices.buses import I2cDevice
from onboard.section import Positive
from onboard.timebase.delays import Delay
from onboard.timebase.timebase import ChannelClock, FreeChannel, SampledChannel


class FsyncImuDevice(I2cDevice, ImuDevice):
    """An IMU with a FIFO."""

    about_clock = (
        "The sample number, fitted to the sync pulses that FSYNC marks in its samples. Wire the sync line to FSYNC; "
        "where it is not, say `sync_input = false`: then the fit is to arrival stamps, good to about a sample."
    )
    records = IMU
    addresses: ClassVar[tuple[int, ...]] = (0x68, 0x69)
    filter_register: ClassVar[str]
    filter_code: Annotated[int, Field(ge=0, le=6)] = 2
    accel_range_g: Literal[2, 4, 8, 16] = 4
    gyro_range_deg_s: Literal[250, 500, 1000, 2000] = 250
    poll_period_ms: Positive = 10.0
    max_transfer_bytes: int = 252
    sync_input: bool = True

    def clocks(self, name: str, around: Surroundings) -> dict[str, ChannelClock]:
        """See ``DeviceSection``."""
        period_ns = 1e9 / self.nominal_hz
        return {name: SampledChannel(period_ns) if self.sync_input else FreeChannel(period_ns, 0.0, period_ns)}

    def delays(self, name: str, around: Surroundings) -> list[Delay]:
        """See ``DeviceSection``."""
        gyro_s, accel_s = self.filter_delays_s
        sigma_s, why = 1e-3 * self.delay_sigma_ms, f"low-pass filter, {self.filter_register} {self.filter_code}"
        return [Delay(name, "gyro", gyro_s, sigma_s, why), Delay(name, "accel", accel_s, sigma_s, why)]

    def marks(self, name: str, rows: Mapping[str, Rows]) -> int | None:
        """See ``BusDevice``."""
        return int(np.count_nonzero(rows[name]["sync"])) if self.sync_input else None
