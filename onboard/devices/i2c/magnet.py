"""Base of chips above a magnet on a joint's axis, polled for each reading."""

from typing import ClassVar

from drivers.records import SCALAR
from onboard.devices.base import JointDevice, Surroundings
from onboard.devices.buses import SamplePeriod
from onboard.devices.roles import Roles
from onboard.timebase.delays import Delay
from onboard.timebase.timebase import ChannelClock, PolledChannel


class MagnetDevice(JointDevice):
    """The absolute angle of a magnet, once in `sample_period_ms`."""

    records = SCALAR
    new_smoothing_ms: ClassVar[int] = 300  # its noise, through 100 ms, biases the rows
    new_floating_smoothing_ms: ClassVar[int | None] = 600  # and through 300 ms what a free-flyer holds
    sample_period_ms: SamplePeriod = 5.0

    @property
    def lag_s(self) -> tuple[float, float]:
        """Of a reading behind the angle, and sigma."""
        raise NotImplementedError

    def clocks(self, name: str, around: Surroundings) -> dict[str, ChannelClock]:
        """See ``DeviceSection``."""
        return {name: PolledChannel()}

    def delays(self, name: str, around: Surroundings) -> list[Delay]:
        """See ``DeviceSection``."""
        return [Delay(name, "", *self.lag_s, "filter of the magnet's angle")]

    def roles(self, name: str, period_s: float) -> Roles:
        """See ``DeviceSection``."""
        roles, (delay_s, _) = super().roles(name, period_s), self.lag_s
        single = abs(self.counts_per_revolution) <= type(self).model_fields["counts_per_revolution"].default
        signal = roles.signals[name]._replace(delays_s=(delay_s,), absolute=single)
        return roles._replace(signals={name: signal})
