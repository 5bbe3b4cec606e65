"""Protocols of a twin's analogue inputs and oscillator.

The twins in ``hil_sim.devices`` model registers, frames and timing; the sensor models implement these Protocols. Every
``time_s`` is mission time: true seconds since power-up of all devices. A twin requests no instant later than the
``now_ns`` it was last advanced to.
"""

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray


class ImuAnalog(Protocol):
    """Sensing elements, low-pass filter and converters of an inertial measurement unit."""

    def counts(
        self, times_s: NDArray[np.float64], accel_lsb_per_g: float, gyro_lsb_per_dps: float, dlpf_cfg: int
    ) -> NDArray[np.int16]:
        """Converter words at the instants the chip latches them.

        Args:
            times_s: Increasing mission times, shape (n,).
            accel_lsb_per_g: Sensitivity of the selected accelerometer range.
            gyro_lsb_per_dps: Sensitivity of the selected gyroscope range.
            dlpf_cfg: The chip's low-pass filter code; its bandwidth and delay are applied.

        Returns:
            Shape (n, 7): specific force x, y, z; temperature word; angular rate x, y, z. Sensor axes, quantised and
            saturated.
        """


@runtime_checkable
class KnownAhead(Protocol):
    """An input whose future is known."""

    @property
    def known_s(self) -> float:
        """Mission time before which it can be asked, whatever time it is."""


class ScalarAnalog(Protocol):
    """Analogue input at the converter of a field node."""

    def value(self, time_s: float) -> float:
        """SI value at a mission time: a joint angle in rad, or a force in N, filtered as the node's front end does."""


@runtime_checkable
class ManyValues(Protocol):
    """A scalar input that can be asked for many instants at once, with the same answers."""

    def values(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """``value`` at each of ``times_s`` (n,)."""


class ChipClock(Protocol):
    """A device's oscillator: a few tens of ppm off for a crystal, up to 1 % off for an MPU-6050."""

    def time_ns(self, chip_ns: int) -> int:
        """True ``CLOCK_MONOTONIC`` ns at which the device's clock shows ``chip_ns`` since power-up; monotone."""

    def chip_ns(self, time_ns: int) -> int:
        """Inverse of ``time_ns``."""

    def times_s(self, chip_ns: NDArray[np.float64]) -> NDArray[np.float64]:
        """Mission times at which the device's clock shows each of ``chip_ns``, shape (n,)."""
