"""Meaning of a channel's rows for a reader of the table alone: frame, zero, quantity, clock."""

from typing import NamedTuple

import numpy as np

from drivers.records import PULSE
from onboard import config
from onboard.channels import HEALTH, HEALTH_STREAM, ORDER, ORDER_REPLY
from onboard.devices.roles import Roles, SmoothedChannel
from onboard.flight.estimate.readings.roles import roles_of
from onboard.ground.log.tables.vehicle_time import clocked
from onboard.recording.reader import LogReader

_NO_CLOCK = "not known without the vehicle file, which names its clock"


_OF_RECORD = {
    HEALTH: "how streams, workers and the flight computer stood, once a second",
    HEALTH_STREAM: "each device channel in the second before a record of health",
    ORDER: "what an operator asked of the flight, refused or not",
    ORDER_REPLY: "what became of it",
}


class ChannelMeaning(NamedTuple):
    """Of one channel.

    Attributes:
        measures: in words; empty where the vehicle does not say.
        frame: of the URDF, in whose axes vectors are; empty where it has none.
        zero_count: raw value at zero, subtracted from converted values.
        signal: what the vehicle file says of its readings; its calibration is taken off converted values.
        time: which of its clocks ``time_s`` is of, in words.
        delay: of the filters that the sample came through, which is not taken off its time; in words.
        time_field: the field that holds that time [ns]; empty where the flight's clocks place the sample, or
            nothing does.
        scratch: fields that only replay needs.
    """

    measures: str = ""
    frame: str = ""
    zero_count: int = 0
    signal: SmoothedChannel | None = None
    time: str = "arrival at the flight computer"
    delay: str = ""
    time_field: str = "host_ns"
    scratch: frozenset[str] = frozenset()


def meanings(log: LogReader, vehicle: config.Vehicle | None) -> dict[str, ChannelMeaning]:
    """The meaning of every channel of ``log``, from ``vehicle``; None: from the rows alone."""
    found = {name: _of_rows(dtype) for name, dtype in log.channels.items()}
    if vehicle is None:
        sampled = ChannelMeaning(time=_NO_CLOCK, time_field="")
        if "import" in log.metadata:
            sampled = ChannelMeaning(time="the sample, by the recording's clock")
        return {n: sampled if "tick" in (log.channels[n].names or ()) else one for n, one in found.items()}
    roles = roles_of(vehicle)
    measures, frames = _measures(roles), {one.channels[0]: one.frame for one in roles.imus if len(one.channels) == 1}
    for name in clocked(log, vehicle):
        signal = roles.signals.get(name)
        found[name] = ChannelMeaning(
            measures=measures.get(name, ""),
            frame=frames.get(name, ""),
            zero_count=signal.zero_count if signal else 0,
            signal=signal,
            time="the sample, by its clock",
            delay=_delay(signal),
            time_field="",
        )
    return found


def _delay(signal: SmoothedChannel | None) -> str:
    if signal is None or not any(signal.delays_s):
        return ""
    parts = dict(zip(("gyro ", "accel "), signal.delays_s[::3], strict=True)) if len(signal.delays_s) == 6 else {}
    named = parts or {"": signal.delays_s[0]}
    return ", ".join(f"{part}{delay_s * 1e3:g} ms" for part, delay_s in named.items())


def _of_rows(dtype: np.dtype[np.void]) -> ChannelMeaning:
    fields = dtype.names or ()
    if dtype == PULSE:
        return ChannelMeaning("edges of the sync line", time="the edge, stamped by the kernel", time_field="edge_ns")
    if "vehicle_ns" in fields:
        scratch = frozenset({"triangle"} & set(fields))
        return ChannelMeaning(
            time="the instant it refers to, on vehicle time", time_field="vehicle_ns", scratch=scratch
        )
    if {"first_sequence", "last_sequence", "consumed"} <= set(fields):
        return ChannelMeaning("what each step of the estimator consumed", scratch=frozenset(fields))
    if "tick" in fields:
        return ChannelMeaning()
    return ChannelMeaning(_OF_RECORD.get(dtype, ""), time="when it was reported")


def _measures(roles: Roles) -> dict[str, str]:
    said = {joint.channel: f"{'rate' if joint.is_rate else 'angle'} of joint {joint.joint}" for joint in roles.joints}
    for imu in roles.imus:
        for number, channel in enumerate(imu.channels):
            one = f"angular rate about {'xyz'[number]}" if number < 3 else f"specific force along {'xyz'[number - 3]}"
            what = "angular rate and specific force" if len(imu.channels) == 1 else one
            said[channel] = f"{what}, in axes of frame {imu.frame}"
    for cell in roles.cells:
        said[cell.channel] = cell.keys.meaning
    for name, zero in ((name, signal.zero_count) for name, signal in roles.signals.items()):
        if zero:
            said[name] = f"{said.get(name, '')}; zero count {zero} is subtracted from the value"
    for name, signal in roles.signals.items():
        if signal.corrections:
            said[name] = f"{said.get(name, '')}; the vehicle file's calibration is taken off the value"
    return said
