"""What each channel of a bus is to bring from the start of a flight on, so that what never came is a gap too."""

from drivers.records import IMU, SCALAR
from onboard import config
from onboard.flight.acquire.publisher import ExpectedChannel


def expected(vehicle: config.Vehicle, bus: str, *, is_open: bool = True) -> dict[str, ExpectedChannel]:
    """Of the channels of a bus, which may not be there yet; those without a rate of their own have period 0."""
    channels: dict[str, ExpectedChannel] = {}
    for name, device in vehicle.devices_on(bus).items():
        period_ns = 0.0 if device.tells_changes else 1e9 / vehicle.rate_hz(name)
        within_ns = round(1e9 * device.first_row_s)
        for place, (channel, dtype) in enumerate(device.channels(name).items()):
            has_rate = place == 0 or dtype in (IMU, SCALAR)
            unheard = device.tells_changes and not is_open
            channels[channel] = ExpectedChannel(period_ns if has_rate else 0.0, within_ns, unheard)
    return channels
