"""Devices on the desk, at rest: how fast, complete and quiet their samples are, and what their clock does.

The samples are taken as they come, before any smoothing. Noise is what a second of them has beside its own straight
line, so that neither a drift nor a slow push counts. It is judged against what the file states of a sample, and is too
large where chance does not explain it: the estimator believes what is stated.
"""

from collections.abc import Collection, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from drivers.records import IMU, SCALAR, Rows
from onboard import config
from onboard.devices import si
from onboard.devices.base import BusDevice
from onboard.devices.roles import SmoothedChannel
from onboard.estimation import policy
from onboard.estimation.arrays import FloatArray
from onboard.flight.check.preflight import Check, Clock, RunDevices, Wait, look_at_devices
from onboard.timebase.timebase import FollowerChannel, FreeChannel, MarkedChannel, PolledChannel, SampledChannel

SECONDS = 120.0
WINDOW_S = 1.0
FEWEST_SAMPLES = 20  # of a window: it is longer where a device is slower
FEWEST_WINDOWS = 10  # their scatter says how well the noise is known
_OF_IMU = tuple((f"{what} {axis}", unit) for what, unit in (("gyro", "rad/s"), ("accel", "m/s^2")) for axis in "xyz")


class RestSignal(NamedTuple):
    """What a device measures, at rest; all in ``unit``.

    Attributes:
        name: channel, or axis.
        unit: of all the numbers.
        mean: over all usable samples.
        noise: 1 sigma of a sample; None: too few.
        stated: the same by the file; None: it states none.
        drift: change from the beginning to the end, by a straight line.
        too_loud: the noise is above what is stated, and chance does not explain it.
    """

    name: str
    unit: str
    mean: float
    noise: float | None
    stated: float | None
    drift: float
    too_loud: bool


class DeskTest(NamedTuple):
    """A device that ran on the desk.

    Attributes:
        seen: what a preflight sees of it.
        url: of its bus.
        seconds: that it ran.
        lost: samples that its first channel lacks.
        longest_gap_s: the longest time without one, by their numbers.
        not_usable: samples that are saturated or not valid, of all channels.
        clock: whose clock its samples carry, in words.
        clock_ppm: how much faster that is than stated; None: it has none, or it is not known.
        clock_sigma_ppm: 1 sigma of it.
        signals: what it measures.
        problems: why it is not ready, of its bus too, with the remedy.
        warnings: what can be flown with, with the remedy.
    """

    seen: Check
    url: str
    seconds: float
    lost: int
    longest_gap_s: float
    not_usable: int
    clock: str
    clock_ppm: float | None
    clock_sigma_ppm: float | None
    signals: tuple[RestSignal, ...]
    problems: tuple[str, ...]
    warnings: tuple[str, ...]


def alone(vehicle: config.Vehicle, names: Collection[str]) -> config.Vehicle:
    """A vehicle file's devices ``names``, with all that is on their buses, and the sync line."""
    device = vehicle.file.device
    buses = {one.bus for name in names if isinstance(one := device[name], BusDevice)}
    buses |= {one.bus for name, one in device.items() if isinstance(one, BusDevice) and one.sync_line(name) is not None}
    kept = {name: one for name, one in device.items() if isinstance(one, BusDevice) and one.bus in buses}
    bus = {name: url for name, url in vehicle.file.bus.items() if name in buses}
    return vehicle.with_sections(bus=bus, device=kept)


def desk_tests(
    vehicle: config.Vehicle,
    names: Collection[str],
    clock: Clock,
    wait: Wait,
    run: RunDevices | None = None,
    seconds: float = SECONDS,
) -> list[DeskTest]:
    """Run devices at rest, and judge some of them.

    Args:
        vehicle: with these devices and what is on their buses (:func:`alone`).
        names: those that are judged.
        clock: CLOCK_MONOTONIC, ns.
        wait: lets that many seconds pass.
        run: as of :func:`onboard.flight.check.preflight.preflight`.
        seconds: for which they run.
    """
    looked = look_at_devices(vehicle, clock, wait, run, seconds)
    found = []
    for check in looked.checks:
        device = vehicle.file.device[check.device]
        if check.device not in names or not isinstance(device, BusDevice):
            continue
        of_bus = [text for text in looked.problems if text.startswith(f"{device.bus}: ")]
        found.append(_tested(vehicle, device, check, looked.rows, seconds, of_bus))
    return found


def _tested(
    vehicle: config.Vehicle, device: BusDevice, check: Check, rows: dict[str, Rows], seconds: float, of_bus: list[str]
) -> DeskTest:
    channels = [(name, rows[name]) for name in device.channels(check.device) if name in rows]
    first = rows.get(next(iter(device.channels(check.device))), np.zeros(0, device.records))
    missing = np.diff(first["sequence"].astype(np.int64)) - 1
    longest_s = float(missing.max(initial=0)) / check.nominal_hz if check.nominal_hz else 0.0
    known = device.roles(check.device, 1.0 / vehicle.rate_hz(check.device)).signals
    signals = tuple(
        each
        for name, some in channels
        if some.dtype in (IMU, SCALAR)
        for each in _signals(name, some[si.usable(some)], known.get(name), check.nominal_hz)
    )
    unusable = sum(int((~si.usable(some)).sum()) for _, some in channels if some.dtype in (IMU, SCALAR))
    loud = dict.fromkeys((one.unit, one.stated) for one in signals if one.too_loud)
    said = [_too_loud([one for one in signals if one.too_loud and (one.unit, one.stated) == alike]) for alike in loud]
    return DeskTest(
        *(check, vehicle.url(device.bus), seconds, int(missing.sum()), longest_s, unusable),
        *_clock_of(vehicle, device, check, first),
        *(signals, tuple(dict.fromkeys((*check.problems, *of_bus))), (*check.warnings, *said)),
    )


def _too_loud(signals: Sequence[RestSignal]) -> str:
    """What to do about values of which the same is stated."""
    named, most = ", ".join(one.name for one in signals), max(one.noise or 0.0 for one in signals)
    return (
        f"{named}: noise {most:.3g} {signals[0].unit} where {signals[0].stated:.3g} is stated: state it, or look for "
        "what shakes it, its supply and its shielding"
    )


def _signals(name: str, rows: Rows, signal: SmoothedChannel | None, nominal_hz: float | None) -> Iterator[RestSignal]:
    """Of a channel's usable rows."""
    if not len(rows):
        return
    if rows.dtype == IMU:
        values, named = si.imu(rows, signal), _OF_IMU
    else:
        known = signal is not None and bool(signal.si)
        unit = next((u for u, factor in signal.si.items() if factor == 1.0), b"") if known and signal else b""
        factors = si.factors(rows, signal) if known and signal else np.ones(len(rows))
        values = (si.scalar(rows, signal) * factors)[:, None]
        named = ((name, (unit or rows["unit"][0]).decode("utf-8", "replace")),)
    stated = signal.noise if signal is not None else (None,) * len(named)
    for column, ((what, unit_name), sigma) in enumerate(zip(named, stated, strict=True)):
        yield _signal(what, unit_name, values[:, column], sigma, nominal_hz, len(named))


def _signal(
    name: str, unit: str, values: FloatArray, stated: float | None, nominal_hz: float | None, looks: int
) -> RestSignal:
    """Statistics of one value; ``looks``: values of the device that are judged."""
    at = np.arange(len(values), dtype=np.float64)
    slope = float(np.polyfit(at, values, 1)[0]) if len(values) > 2 else 0.0
    drift, mean = slope * max(len(values) - 1, 0), float(values.mean())
    size = max(FEWEST_SAMPLES, round(WINDOW_S * (nominal_hz or 0.0)))
    windows = len(values) // size
    if windows < 1:
        return RestSignal(name, unit, mean, None, stated, drift, too_loud=False)
    parts = values[: windows * size].reshape(windows, size).T  # (size, windows)
    time = np.arange(size) - 0.5 * (size - 1)
    bent = parts - parts.mean(axis=0) - np.outer(time, (time @ parts) / (time @ time))
    variances = (bent**2).sum(axis=0) / (size - 2)
    variance = float(variances.mean())
    too_loud = False
    if stated is not None and windows >= FEWEST_WINDOWS:
        sigma = float(variances.std(ddof=1)) / windows**0.5
        too_loud = variance - stated**2 > policy.sigmas(policy.of_each(policy.DOUBT, looks)) * sigma
    return RestSignal(name, unit, mean, variance**0.5, stated, drift, too_loud)


def _clock_of(
    vehicle: config.Vehicle, device: BusDevice, check: Check, rows: Rows
) -> tuple[str, float | None, float | None]:
    """In words, and how much faster than stated it is, with 1 sigma, in ppm."""
    spec = device.clocks(check.device, vehicle).get(next(iter(device.channels(check.device))))
    match spec:
        case PolledChannel():
            return "the computer's, between request and answer", None, None
        case FollowerChannel(sync=source):
            return f"that of {source}", None, None
        case (
            SampledChannel(period_ns=period_ns) | MarkedChannel(period_ns=period_ns) | FreeChannel(period_ns=period_ns)
        ):
            pass
        case _:
            return "the computer's", None, None
    ticks, stamps = rows["tick"].astype(np.float64), rows["host_ns"].astype(np.float64)
    polls = len(np.unique(stamps))
    if polls < FEWEST_SAMPLES or ticks[-1] <= ticks[0]:
        return "device's", None, None
    ticks, stamps = ticks - ticks[0], stamps - stamps[0]
    slope, offset = np.polyfit(ticks, stamps, 1)
    left = float((stamps - slope * ticks - offset).std())
    sigma = left * (12.0 / polls) ** 0.5 / float(stamps[-1])  # of a straight line through evenly spaced stamps
    return "device's", 1e6 * (period_ns / float(slope) - 1.0), 1e6 * sigma


def render(test: DeskTest) -> RenderableType:
    """A screen of a device, 80 columns wide."""
    seen = test.seen
    lines = [Text(f"{seen.device}: {seen.kind} on {test.url}", "bold")]
    lines += [Text(f"  {seen.identity}")] if seen.identity else []
    rate = "on change" if seen.nominal_hz is None else f"{seen.rate_hz or 0.0:.5g} Hz of {seen.nominal_hz:.5g}"
    lost = f"{test.lost} lost" + (f", at most {1e3 * test.longest_gap_s:.3g} ms in a row" if test.lost else "")
    lines.append(Text(f"  samples    {seen.rows} in {test.seconds:g} s, {rate}"))
    lines.append(Text(f"  gaps       {lost}; {test.not_usable} samples are not usable"))
    clock = test.clock
    if test.clock_ppm is not None and test.clock_sigma_ppm is not None:
        clock += f", {abs(test.clock_ppm):.0f} ± {2.0 * test.clock_sigma_ppm:.0f} ppm "
        clock += "fast" if test.clock_ppm > 0.0 else "slow"
    clock += "" if seen.time_sigma_us is None else f"; times known to {seen.time_sigma_us:.0f} us"
    clock += "" if seen.marks is None else f"; {seen.marks} sync pulses"
    lines += [Text(f"  clock      {clock}"), Text(f"  self test  {seen.self_test or 'it has none'}")]
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("at rest")
    table.add_column("unit")
    for heading in ("mean", "noise", "stated", "of it", "drift"):
        table.add_column(heading, justify="right", no_wrap=True)
    for one in test.signals:
        ratio = None if one.noise is None or one.stated is None else one.noise / one.stated
        told = ["-" if each is None else f"{each:.3g}" for each in (one.noise, one.stated, ratio)]
        style = "yellow" if one.too_loud else ""
        table.add_row(one.name, one.unit, f"{one.mean:.5g}", *told, f"{one.drift:.2g}", style=style)
    said = [Text(f"  {text}", "yellow") for text in test.warnings]
    said += [Text(f"  {text}", "red") for text in test.problems]
    verdict = Text("good", "bold green")
    if test.problems or test.warnings:
        verdict = Text("not ready", "bold red") if test.problems else Text("look", "bold yellow")
    return Group(*lines, *([table] if test.signals else []), *said, verdict)
