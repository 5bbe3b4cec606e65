"""Memsense nIMU on a serial line."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from drivers.nimu.device import Nimu
from drivers.nimu.packet import PACKET_BYTES, TICK_NS, NimuConfig
from drivers.records import IMU, SCALAR
from onboard.devices.base import Channels, Clock, ImuDevice, Surroundings, first_leads
from onboard.devices.buses import OpenSerial, PollPeriod, SerialLineDevice
from onboard.section import NotNegative, Positive
from onboard.timebase.delays import Delay, on_wire_s
from onboard.timebase.timebase import ChannelClock, FreeChannel


class NimuDevice(SerialLineDevice, ImuDevice):
    """Memsense nIMU. ``gyro_delay_ms`` and ``accel_delay_ms`` are those of its filters.

    ``latency_ms``: measured time from the sample to the first bit of its packet; default: half a sample period, with
        that as its sigma.
    """

    about_clock = "Its packet timer, fitted to arrival: it has no sync input. Its times include the delay of the line."
    records = IMU
    driver_configs = (NimuConfig,)
    new_keys = """sample_rate_hz = 150
accel_noise_m_s2 = 0.02        # yours: density by its certificate x sqrt(150 Hz / 2)
gyro_noise_rad_s = 2e-3        # the same
accel_delay_ms = 4.5           # yours: of its filter; of two poles at 50 Hz
gyro_delay_ms = 4.5
"""
    first_row_s = 0.3  # it talks unasked, a quarter of a second after its power came
    kind: Literal["nimu"]
    kelvin_per_count: ClassVar[float] = 1.8165e-2  # of the gyro temperature words
    sample_rate_hz: Positive
    gyro_delay_ms: NotNegative = 0.0
    accel_delay_ms: NotNegative = 0.0
    latency_ms: Annotated[
        NotNegative | None,
        Field(description="From sample to first bit of its packet, as measured; half a sample period where not given."),
    ] = None
    latency_sigma_ms: Annotated[NotNegative, Field(description="Standard deviation of `latency_ms`.")] = 0.0
    accel_range_g: float = NimuConfig.accel_range_g
    gyro_range_deg_s: float = NimuConfig.gyro_range_deg_s
    accel_scale_g: float = NimuConfig.accel_scale_g
    gyro_scale_deg_s: float = NimuConfig.gyro_scale_deg_s
    magnetometer: bool = NimuConfig.magnetometer
    magnetometer_scale_gauss: float = NimuConfig.magnetometer_scale_gauss
    checksum_span: Literal["packet", "after_sync", "payload"] = "packet"
    poll_period_ms: PollPeriod = NimuConfig.poll_period_ms
    silence_ms: Positive = NimuConfig.silence_ms

    def channels(self, name: str) -> Channels:
        """The IMU, and its magnetometer where wanted."""
        magnetometer = [f"{name}_mag_{axis}" for axis in "xyz"] if self.magnetometer else []
        return {name: IMU, **dict.fromkeys(magnetometer, SCALAR)}

    def clocks(self, name: str, around: Surroundings) -> dict[str, ChannelClock]:
        """See ``DeviceSection``."""
        return first_leads(self.channels(name), FreeChannel(TICK_NS, *self._packet_delay_ns(around)))

    def delays(self, name: str, around: Surroundings) -> list[Delay]:
        """See ``DeviceSection``."""
        delay_ns, sigma_ns = self._packet_delay_ns(around)
        gyro_s, accel_s = self.filter_delays_s
        return [
            Delay(name, "", delay_ns * 1e-9, sigma_ns * 1e-9, "packet: wait for the line, and on it", name),
            Delay(name, "gyro", gyro_s, 0.0, "its filter"),
            Delay(name, "accel", accel_s, 0.0, "its filter"),
        ]

    @property
    def filter_delays_s(self) -> tuple[float, float]:
        """See ``ImuDevice``."""
        return self.gyro_delay_ms * 1e-3, self.accel_delay_ms * 1e-3

    def driver(self, name: str, open_port: OpenSerial, clock: Clock, baud: int) -> Nimu:
        """See ``SerialLineDevice``."""
        return Nimu(name, open_port, clock, self.settings(name))

    def _packet_delay_ns(self, around: Surroundings) -> tuple[float, float]:
        """From a sample to its packet's arrival, and sigma."""
        wire_ns = 1e9 * on_wire_s(PACKET_BYTES, around.baud(self.bus))
        latency_ns, sigma_ns = self._latency_ns()
        return wire_ns + latency_ns, sigma_ns

    def _latency_ns(self) -> tuple[float, float]:
        """From a sample to its packet: within one sample period where not measured."""
        if self.latency_ms is not None:
            return 1e6 * self.latency_ms, 1e6 * self.latency_sigma_ms
        period_ns = 1e9 / self.sample_rate_hz
        return 0.5 * period_ns, period_ns / 12**0.5
