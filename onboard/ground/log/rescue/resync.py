"""``heft resync``: logs of recorders whose clocks have nothing in common, put on the time of the first with an IMU.

What is compared: the IMU's angular rate with that of another IMU on the same body, or with joint rates. A vehicle that
floats freely and whose joints the other log has goes further, through its own model
(:mod:`onboard.ground.log.rescue.fit_clocks`), which also gives what it was holding. Memory: 60 bytes a sample.

When the samples of a channel were taken, on the clock of the computer that recorded them.

A log that carries its vehicle has that vehicle's clocks. In any other, arrival stamps that rise are the times, as they
are in an imported recording; where rows share them (a FIFO that is drained), the device's tick count is put on the
line through the least delayed arrivals.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.console import Group, RenderableType
from rich.table import Table

from drivers.records import IMU, SCALAR, Rows
from onboard import config
from onboard.devices import si
from onboard.devices.roles import ANGLE, RATE
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.payload import BodyEstimate
from onboard.dynamics.model.vehicle import VehicleModel as Model
from onboard.dynamics.model.vehicle import VehicleSpec
from onboard.dynamics.ticks import FlightSignals
from onboard.estimation.arrays import FloatArray
from onboard.estimation.policy import HALF
from onboard.flight.estimate.readings.roles import roles_of
from onboard.ground.log.rescue.fit_clocks import RecordedPair, coarse_clocks, rescue
from onboard.ground.log.tables.flight_tables import FlightTables
from onboard.ground.log.tables.vehicle_time import UNKNOWN
from onboard.identification.free_flyer.batch import FreeBase, MotionFit
from onboard.identification.free_flyer.prediction.imu_errors import ImuPrior
from onboard.recording.reader import LogReader
from onboard.timebase.resync import Alignment, RecorderStream, ResyncError, align, shocks
from onboard.timebase.timebase import FreeChannel, Timebase

_BLOCK_NS = 100_000_000
# An IMU without calibration: MPU-6050 product specification 3.4, sections 6.1 and 6.2, halved to 1 sigma; drift of
# its zeros over the warm-up of a flight.
UNCALIBRATED = ImuPrior(0.17, 1e-3, 0.015, 0.01, 0.4, 1e-2, 0.015, 0.01, 0.0)
# Of a payload that could be anything an arm holds: kg, kg m, kg m^2, about none at all.
SHOCK_S, SHOCK_HZ = 0.005, 15.0  # a tap rings some milliseconds
ANY_PAYLOAD = np.array([50.0, *[20.0] * 3, *[10.0] * 6])


def sampled(log: LogReader, channel: str) -> tuple[Rows, FloatArray]:
    """The usable rows (n,) of ``channel`` and the times (n,) of their samples [s], rising."""
    tables = FlightTables(log)
    if channel in tables.clocked:
        rows = tables.read(channel)
        time_ns = rows["time_ns"]
    else:
        rows = log.read(channel)
        rises = (np.diff(rows["host_ns"]) > 0).all()
        time_ns = rows["host_ns"] if rises else _by_tick(channel, rows)
    good = si.usable(rows) & (time_ns != UNKNOWN)
    rows, time_ns = rows[good], time_ns[good]
    rising = np.ones(len(rows), np.bool_)
    rising[1:] = time_ns[1:] > np.maximum.accumulate(time_ns)[:-1]
    return rows[rising], time_ns[rising] * 1e-9


def _by_tick(channel: str, rows: Rows) -> NDArray[np.int64]:
    ticks = int(rows["tick"][-1]) - int(rows["tick"][0])
    if ticks <= 0:
        return np.full(len(rows), UNKNOWN)
    period_ns = float(rows["host_ns"][-1] - rows["host_ns"][0]) / ticks
    timebase = Timebase({channel: FreeChannel(period_ns)}, None)
    edges = np.arange(rows["host_ns"][0], rows["host_ns"][-1] + _BLOCK_NS, _BLOCK_NS) + _BLOCK_NS
    cuts = [0, *np.searchsorted(rows["host_ns"], edges).tolist()]
    found = np.full(len(rows), UNKNOWN)
    first = 0  # row without a time
    for now_ns, start, end in zip(edges.tolist(), cuts[:-1], cuts[1:], strict=True):
        timebase.update(now_ns, {channel: rows[start:end]})
        times = timebase.time_ns(channel, rows[first:end]) if end > first else None
        if times is not None:
            found[first:end], first = times, end
    return found


class _Joint(NamedTuple):
    recorded: RecorderStream  # (n, 1) rad, or rad/s
    is_rate: bool


class AlignedLog(NamedTuple):
    """Where a log's clock lies: reference time = ``offset_s + (1 + rate) * (its time - pivot_s) + pivot_s``."""

    log: Path
    reference: Path
    offset_s: float
    rate: float
    drift_per_s: float
    pivot_s: float
    sigma_offset_s: float
    sigma_rate: float
    how: str
    unique: str  # how the answer stands out
    payload: BodyEstimate | None  # in the payload link's frame

    @property
    def shift_s(self) -> float:
        """To be added to its time once that is multiplied by ``1 + rate``."""
        return self.offset_s - self.rate * self.pivot_s

    @property
    def merge_option(self) -> str:
        """For ``heft merge``."""
        return f"--align {self.log.stem}={self.shift_s:.9f},{1.0 + self.rate:.9f}"

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        made: dict[str, Any] = {**self._asdict(), "log": str(self.log), "reference": str(self.reference)}
        made["merge"] = self.merge_option
        if self.payload is not None:
            body, covariance = self.payload
            made["payload"] = {
                "mass_kg": body.mass_kg,
                "centre_of_mass_m": body.centre_of_mass_m.tolist(),
                "inertia_kg_m2": body.inertia_kg_m2.tolist(),
                "covariance": covariance.tolist(),
            }
        return made


def resync(
    logs: Sequence[LogReader],
    vehicle: config.Vehicle | None,
    peak_Hz: float,
    rate_limit: float,
    by_shocks: bool = False,
    told: Callable[[str], object] = lambda text: None,
) -> list[AlignedLog]:
    """The clock of every log but the reference.

    Args:
        logs: two or more.
        vehicle: says which channel is what, and the model where there is one; else every scalar channel in rad or
            rad/s is taken for a joint.
        peak_Hz: where the motion is liveliest, see :func:`onboard.timebase.resync.align`.
        rate_limit: largest accepted relative error of a clock.
        by_shocks: compare taps of a mallet, which every recorder feels, and nothing else; good to some milliseconds.
        told: called with what is done next.

    Raises:
        ResyncError: a clock that cannot be determined, with the reason.
        ValueError: no IMU in any of the logs, or no motion in one.
    """
    if len(logs) < 2:
        raise ValueError("give two logs or more: the clocks of a flight computer's log are fitted to its pulses")
    imus = {number: name for number, log in enumerate(logs) if (name := _imu_channel(log, vehicle))}
    if not imus:
        raise ValueError("none of the logs has an IMU: give the log with the IMU first")
    first = next(iter(imus))
    told(f"reads {logs[first].path.name}")
    rate, force = _imu(logs[first], imus[first])
    placed = []
    for number, log in enumerate(logs):
        if number == first:
            continue
        told(f"{log.path.name} on the time of {logs[first].path.name}")
        try:
            seen = (force,) if by_shocks else (rate, force)
            placed.append(_place(log, logs[first], imus.get(number), seen, vehicle, peak_Hz, rate_limit))
        except ResyncError as error:
            raise ResyncError(f"{log.path} on the time of {logs[first].path}: {error}") from error
    return placed


def _place(
    log: LogReader,
    reference: LogReader,
    imu: str | None,
    seen: tuple[RecorderStream, ...],  # rate and specific force of the reference; specific force alone: compare shocks
    vehicle: config.Vehicle | None,
    peak_Hz: float,
    rate_limit: float,
) -> AlignedLog:
    joints = {} if imu else _joints(log, vehicle)
    if not imu and not joints:
        raise ValueError(f"{log.path} has neither an IMU nor a joint in rad or rad/s: nothing to compare")
    if len(seen) == 1:
        felt = _imu(log, imu)[1] if imu else _rates(joints)
        ours, theirs = shocks(seen[0], SHOCK_S), shocks(felt, SHOCK_S)
        found = align(ours, theirs, SHOCK_HZ, rate_limit, first_s=float(np.ptp(theirs.time_s)))
        return _aligned(log, reference, found, "shocks that both felt")
    if vehicle is not None and vehicle.file.vehicle.base_kind.falls and vehicle.file.vehicle.payload_link and joints:
        return _through_the_model(log, reference, joints, (seen[0], seen[1]), vehicle, rate_limit)
    turns = _imu(log, imu)[0] if imu else _rates(joints)
    how = "angular rates of two IMUs" if imu else "angular rate and joint rates"
    return _aligned(log, reference, align(seen[0], turns, peak_Hz, rate_limit), how)


def _aligned(log: LogReader, reference: LogReader, found: Alignment, how: str) -> AlignedLog:
    unique = (
        f"{found.nats:.0f} nats to the next offset, {found.runner_up_s:+.2f} s away; explains {found.explained:.1%}"
    )
    sigma = found.sigma_offset_s, found.sigma_rate
    clock = found.offset_s, found.rate, found.drift_per_s, found.pivot_s
    return AlignedLog(log.segments[0], reference.segments[0], *clock, *sigma, how, unique, None)


def _through_the_model(
    log: LogReader,
    reference: LogReader,
    joints: dict[str, _Joint],
    seen: tuple[RecorderStream, RecorderStream],
    vehicle: config.Vehicle,
    rate_limit: float,
) -> AlignedLog:
    section, roles = vehicle.file.vehicle, roles_of(vehicle)
    urdf = vehicle.urdf_text
    model = Model(urdf, VehicleSpec(BaseKind.FREE, section.base_link, section.payload_link))
    frame = roles.imu.frame
    noise = roles.signals[roles.imu.channels[0]].noise
    by_joint = {joint.joint: joints[joint.channel] for joint in roles.joints if joint.channel in joints}
    if missing := [joint.name for joint in model.joints if joint.name not in by_joint or by_joint[joint.name].is_rate]:
        raise ValueError(f"{log.path} has no angle of {', '.join(missing)}: give the log that has all joints")
    ordered = [by_joint[joint.name].recorded for joint in model.joints]
    own_s = ordered[0].time_s
    angle = np.column_stack([np.interp(own_s, one.time_s, one.values[:, 0]) for one in ordered])
    recorded = RecordedPair(seen[0].time_s, seen[0].values, seen[1].values, (noise[0], noise[-1]), own_s, angle)

    def build(signals: FlightSignals, imu_prior: ImuPrior) -> MotionFit:
        return MotionFit(FreeBase(model, signals), frame, ANY_PAYLOAD, {}, imu_prior)

    found = rescue(recorded, coarse_clocks(model, recorded, rate_limit), build, UNCALIBRATED)
    clock = found.clock
    how = "base rate and specific force predicted from the joints, payload and momentum fitted with the clock"
    unique = f"residuals are {found.misfit:.2f} times the noise, settled in {found.rounds} rounds"
    line = clock.offset_s, clock.rate, 0.0, clock.pivot_s, clock.sigma_offset_s, clock.sigma_rate
    return AlignedLog(log.segments[0], reference.segments[0], *line, how, unique, found.found.payload)


def _imu_channel(log: LogReader, vehicle: config.Vehicle | None) -> str | None:
    if vehicle is not None:
        channel = roles_of(vehicle).imu.channels[0]
        return channel if log.channels.get(channel) == IMU else None
    return next((name for name, dtype in log.channels.items() if dtype == IMU), None)


def _imu(log: LogReader, channel: str) -> tuple[RecorderStream, RecorderStream]:
    """Angular rate and specific force of the usable samples, sensor axes."""
    rows, time_s = sampled(log, channel)
    values = si.imu(rows)
    return RecorderStream(time_s, values[:, :3]), RecorderStream(time_s, values[:, 3:])


def _joints(log: LogReader, vehicle: config.Vehicle | None) -> dict[str, _Joint]:
    """The joints' samples by channel."""
    roles = roles_of(vehicle) if vehicle is not None else None
    wanted = [joint.channel for joint in roles.joints] if roles else list(log.channels)
    found = {}
    for name in wanted:
        if log.channels.get(name) != SCALAR:
            continue
        rows, time_s = sampled(log, name)
        unit = bytes(rows["unit"][0]) if len(rows) else b""
        factor = {**ANGLE, **RATE}.get(unit)
        if factor is not None:
            signal = roles.signals[name] if roles else None
            stream = RecorderStream(time_s, factor * si.scalar(rows, signal)[:, None])
            found[name] = _Joint(stream, unit in RATE)
    return found


def _rates(joints: dict[str, _Joint]) -> RecorderStream:
    """Rates of all joints at the times of the first; differences are as good as they need be, a filter follows."""
    time_s = next(iter(joints.values())).recorded.time_s
    columns = []
    for (own_s, values), is_rate in joints.values():
        rate = values[:, 0] if is_rate else np.gradient(values[:, 0], own_s)
        columns.append(np.interp(time_s, own_s, rate))
    return RecorderStream(time_s, np.column_stack(columns))


def render(placed: Sequence[AlignedLog]) -> RenderableType:
    """For a terminal."""
    parts: list[RenderableType] = []
    for one in placed:
        table = Table(title=f"{one.log} on the time of {one.reference}", title_justify="left", show_header=False)
        table.add_row("offset", f"{one.offset_s:+.6f} s ± {1e6 * HALF * one.sigma_offset_s:.0f} µs (95 %)")
        table.add_row("rate", f"{1e6 * one.rate:+.2f} ppm ± {1e6 * HALF * one.sigma_rate:.2f} ppm")
        if one.drift_per_s:
            table.add_row("drift", f"{60e6 * one.drift_per_s:+.3f} ppm a minute; merge leaves it out")
        table.add_row("at", f"{one.pivot_s:.3f} s of its time")
        table.add_row("from", one.how)
        table.add_row("unique", one.unique)
        if one.payload is not None:
            body, sigma = one.payload.body, np.sqrt(np.diag(one.payload.covariance))
            table.add_row("payload", f"{body.mass_kg:.4f} kg ± {HALF * sigma[0]:.4f} kg")
            centre = ", ".join(
                f"{1e3 * c:.2f} ± {1e3 * HALF * s:.2f}" for c, s in zip(body.centre_of_mass_m, sigma[1:4], strict=True)
            )
            table.add_row("", f"centre of mass {centre} mm")
        table.add_row("merge", one.merge_option)
        parts.append(table)
    return Group(*parts)
