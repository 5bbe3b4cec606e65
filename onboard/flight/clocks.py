"""Clocks of a vehicle's channels and known delays of their samples, from its devices."""

from onboard import config
from onboard.timebase.delays import Delay
from onboard.timebase.timebase import ChannelClock, SyncLine, Timebase


def timebase_of(vehicle: config.Vehicle) -> Timebase:
    """The clocks of a vehicle's channels."""
    clocks: dict[str, ChannelClock] = {}
    for name, device in vehicle.file.device.items():
        clocks |= device.clocks(name, vehicle)
    return Timebase(clocks, sync_line(vehicle))


def sync_line(vehicle: config.Vehicle) -> SyncLine | None:
    """The sync line: the coded one, else a PPS."""
    lines = [device.sync_line(name) for name, device in vehicle.file.device.items()]
    there = [line for line in lines if line is not None]
    return min(there, key=lambda line: not line.coded, default=None)


def known_delays(vehicle: config.Vehicle) -> list[Delay]:
    """The delays subtracted from the samples' times, by channel."""
    devices = vehicle.file.device.items()
    delays = [delay for name, device in devices for delay in device.delays(name, vehicle)]
    return [delay for delay in delays if delay.delay_s or delay.sigma_s]
