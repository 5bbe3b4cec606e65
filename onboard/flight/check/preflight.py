"""Preflight check of every device: presence, identity, rate and sync marks against the vehicle file.

Every bus is opened as in flight, every device runs for a few seconds, and its data are compared with the vehicle file.
Nothing is recorded. The IMUs' self tests run first, with the vehicle at rest. The URDF is loaded as in flight, the
disk is measured and the system clock asked (``host``), and the samples' times are fitted as in flight: how well they
are known, with the sync pulses that came or without.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from drivers.device import Device, SelfTesting
from drivers.errors import ConfigurationError, DriverError
from drivers.records import EVENT, PULSE, Batch, Rows, Severity
from onboard import config
from onboard.devices.base import BusDevice
from onboard.flight.acquire.devices import OpenDevices, open_devices
from onboard.flight.check.host import Host, look_over, unsynchronised
from onboard.flight.clocks import sync_line, timebase_of
from onboard.flight.estimate.estimator import Estimator

SECONDS = 4.0
LONGEST_SECONDS = 30.0
PUMP_S = 1e-3
FEWEST_ROWS = 5
TICK_TOLERANCE = 0.1
LOSS_TOLERANCE = 0.05  # a QSB loses 2 % while it reports pulses
SILENT_S = 1.0
FLIGHT_S = 3600.0
STEP_NS = 50_000_000  # in which rows go to the clocks
IDENTITY = (b"identified", b"described", b"scale", b"started")  # events that say who it is, the best first

Clock = Callable[[], int]
Wait = Callable[[float], object]
RunDevices = Callable[[OpenDevices, float], list[Batch]]


class Check(NamedTuple):
    """What was seen of a device.

    Attributes:
        device: its name.
        kind: its kind.
        bus: its bus.
        identity: who it says it is.
        rows: of its first channel.
        nominal_hz: what its rate should be; None: it reports changes only.
        rate_hz: of its first channel, lost samples included; None: too few rows to tell.
        marks: sync pulses seen in its own stream; None: it has no input for them.
        time_sigma_us: 1 sigma of its samples' times, a constant delay aside; None: not known (yet), or it has no clock.
        self_test: how its own test came out; empty where it has none.
        problems: why it is not ready, with the remedy.
        warnings: what it said and can be flown with.
    """

    device: str
    kind: str
    bus: str
    identity: str
    rows: int
    nominal_hz: float | None
    rate_hz: float | None
    marks: int | None
    time_sigma_us: float | None
    self_test: str
    problems: tuple[str, ...]
    warnings: tuple[str, ...]


class Looked(NamedTuple):
    """Devices that ran for some seconds: what was seen of each, problems of buses and lines, rows by channel."""

    checks: tuple[Check, ...]
    problems: tuple[str, ...]
    rows: dict[str, Rows]


class Preflight(NamedTuple):
    """The vehicle as it was found.

    Attributes:
        checks: by device, in the order of the file.
        problems: of buses and of the host, with the remedy.
        warnings: of the host and of the sync line.
        host: what the computer offers.
    """

    checks: tuple[Check, ...]
    problems: tuple[str, ...]
    warnings: tuple[str, ...]
    host: Host

    @property
    def ready(self) -> bool:
        """Nothing stands against flying."""
        return not self.problems and not any(check.problems for check in self.checks)


def preflight(
    vehicle: config.Vehicle,
    clock: Clock,
    wait: Wait,
    run: RunDevices | None = None,
    seconds: float | None = None,
    flight_s: float = FLIGHT_S,
    estimator: Estimator | None = None,
    wall_s: float | None = None,
    told: Callable[[str], object] = lambda text: None,
) -> Preflight:
    """Look a vehicle over.

    Args:
        vehicle: its file.
        clock: CLOCK_MONOTONIC, ns.
        wait: lets that many seconds pass (``time.sleep``).
        run: runs open devices for so many seconds and gives what they said (``workers.run_for``); in turn, on this
            thread, where not given.
        seconds: how long its devices run; by their rates where not given.
        flight_s: how long the flight is to last.
        estimator: that flies with it, and whose answers are recorded too.
        wall_s: what the system clock says, Unix time; None: it is not looked at.
        told: called with what is done next.

    Raises:
        ConfigError: a vehicle of recorded data, without a device on a bus.
    """
    require_devices(vehicle)
    slowest_hz = min(vehicle.rate_hz(name) for name, _ in _on_buses(vehicle))
    run_s = seconds or min(max(SECONDS, FEWEST_ROWS / slowest_hz), LONGEST_SECONDS)
    checks, problems, _ = look_at_devices(vehicle, clock, wait, run, run_s, told)
    computer = look_over(vehicle, estimator, flight_s, clock, wall_s, unsynchronised())
    warnings = [*computer.warnings, *_without_pulses(vehicle, checks)]
    return Preflight(checks, (*problems, *computer.problems), tuple(warnings), computer)


def look_at_devices(
    vehicle: config.Vehicle,
    clock: Clock,
    wait: Wait,
    run: RunDevices | None,
    run_s: float,
    told: Callable[[str], object] = lambda text: None,
) -> Looked:
    """Run all devices of a vehicle for ``run_s``, behind their self tests; the others as of :func:`preflight`."""
    told("self tests")
    self_tests = _self_tests(vehicle, clock, wait)
    told(f"the devices run for {run_s:.2g} s")
    opened = open_devices(vehicle, clock)
    try:
        said_by_devices = run(opened, run_s) if run else run_in_turn(opened.devices, clock, wait, run_s)
        batches = [*opened.problems, *said_by_devices]
    finally:
        opened.close()
    end_ns = clock()
    rows = _rows(batches)
    said = rows.get("event", np.zeros(0, EVENT))
    known = _time_sigmas_us(vehicle, rows)
    checks = tuple(
        _check(vehicle, name, device, rows, said, self_tests.get(name, ("", "")), device.bus in opened.by_bus, end_ns)
        for name, device in _on_buses(vehicle)
    )
    others = ~np.isin(said["source"], [name.encode() for name in vehicle.file.device])
    problems = [f"{e['source'].decode()}: {_text(e)}" for e in said[others & (said["severity"] >= Severity.ERROR)]]
    timed = tuple(check._replace(time_sigma_us=known.get(check.device)) for check in checks)
    return Looked(timed, tuple(dict.fromkeys(problems)), rows)


def require_devices(vehicle: config.Vehicle) -> None:
    """Check that there is a device to look at.

    Raises:
        ConfigError: a vehicle of recorded data, without a device on a bus.
    """
    if not _on_buses(vehicle):
        raise config.ConfigError(
            f"{vehicle.label}: no device is on a bus, its data are imported; name a vehicle that flies"
        )


def _on_buses(vehicle: config.Vehicle) -> list[tuple[str, BusDevice]]:
    return [(name, device) for name, device in vehicle.file.device.items() if isinstance(device, BusDevice)]


def _self_tests(vehicle: config.Vehicle, clock: Clock, wait: Wait) -> dict[str, tuple[str, str]]:
    """Of every device that has one: how it came out, and the problem if there is one.

    The buses are opened for them alone, or what the others say in that time would wait and look late.
    """
    opened = open_devices(vehicle, clock)
    try:
        return {device.name: _self_test(device, wait) for device in opened.devices if isinstance(device, SelfTesting)}
    finally:
        opened.close()


def _self_test(device: SelfTesting, wait: Wait) -> tuple[str, str]:
    try:
        result = device.self_test(wait)
    except ConfigurationError as error:  # a clone, whose factory trim is unknown
        return f"not made: {error}", ""
    except DriverError as error:
        return "failed", str(error)
    return f"passed, {100 * result.worst:.0f} % off", ""


def run_in_turn(devices: Iterable[Device], clock: Clock, wait: Wait, seconds: float) -> list[Batch]:
    """What the devices say in so many seconds, but for what they say when stopped."""
    running = list(devices)
    batches = [batch for device in running for batch in device.start(clock())]
    due_ns = dict.fromkeys((device.name for device in running), 0)
    end_ns = clock() + round(seconds * 1e9)
    while (now_ns := clock()) < end_ns:
        for device in running:
            if now_ns >= due_ns[device.name]:
                batches += device.pump(clock())
                due_ns[device.name] = now_ns + device.period_ns
        wait(PUMP_S)
    for device in running:
        device.stop(clock())
    return batches


def _rows(batches: Iterable[Batch]) -> dict[str, Rows]:
    by_channel: dict[str, list[Rows]] = defaultdict(list)
    for channel, rows in batches:
        by_channel[channel].append(rows)
    joined = {channel: bytearray().join(rows.tobytes() for rows in parts) for channel, parts in by_channel.items()}
    return {channel: np.frombuffer(joined[channel], parts[0].dtype) for channel, parts in by_channel.items()}


def _check(
    vehicle: config.Vehicle,
    name: str,
    device: BusDevice,
    rows: dict[str, Rows],
    said: Rows,
    self_test: tuple[str, str],
    is_open: bool,
    end_ns: int,
) -> Check:
    mine = said[said["source"] == name.encode()]
    nominal_hz = None if device.tells_changes else vehicle.rate_hz(name)
    channel = next(iter(device.channels(name)))
    stamps = _stamps(rows.get(channel))
    span_s = float(stamps[-1] - stamps[0]) * 1e-9 if len(stamps) > 1 else 0.0
    made, lost = _made(rows, channel)
    rate_hz = (made - 1) / span_s if span_s > 0.0 else None
    outcome, failed = self_test
    problems = [failed] if failed else []
    problems += dict.fromkeys(_text(e) for e in mine[mine["severity"] >= Severity.ERROR])
    if not is_open:
        problems.append(f"bus {device.bus} could not be opened")
    elif not len(stamps):
        problems += [] if problems else ["no data: check its power and wiring"]
    elif nominal_hz is not None:
        problems += _rate_problems(device, rate_hz, nominal_hz, (end_ns - int(stamps[-1])) * 1e-9)
    if device.tick_rate_hz is not None and span_s > 0.0:
        ticks = rows[channel]["tick"]
        problems += _clock_problems(device.tick_rate_hz, (float(ticks[-1]) - float(ticks[0])) / span_s)
    warnings = list(dict.fromkeys(_text(e) for e in mine[mine["severity"] == Severity.WARNING]))
    if lost > LOSS_TOLERANCE * made:
        warnings.append(f"{lost} of {made} samples were lost: the computer is overloaded, or the link too slow")
    marks = _marks(vehicle, name, device, rows) if len(stamps) else None
    if marks == 0:
        if device.marks_at_rest:
            problems.append("no sync pulse in its samples: check the sync line to it")
        else:
            warnings.append("no sync pulse in its stream: few are reported while the joint rests; move it and repeat")
    return Check(
        *(name, device.kind, device.bus, _identity(mine), len(stamps), nominal_hz, rate_hz, marks, None, outcome),
        *(tuple(problems), tuple(warnings)),
    )


def _made(rows: dict[str, Rows], channel: str) -> tuple[int, int]:
    """Samples that a channel's device made from the first row to the last, and how many of them were lost."""
    numbers = rows[channel]["sequence"] if channel in rows else np.zeros(0, np.uint64)
    made = int(numbers[-1] - numbers[0]) + 1 if len(numbers) else 0
    return made, made - len(numbers)


def _stamps(rows: Rows | None) -> NDArray[np.int64]:
    """When samples came in; edges by the kernel, for they may have waited to be read."""
    if rows is None:
        return np.zeros(0, np.int64)
    stamps: NDArray[np.int64] = rows["edge_ns" if rows.dtype == PULSE else "host_ns"]
    return stamps


def _rate_problems(device: BusDevice, rate_hz: float | None, nominal_hz: float, silent_s: float) -> list[str]:
    if rate_hz is None:
        return ["a single row: repeat with a longer time"]
    if silent_s > max(SILENT_S, 5.0 / nominal_hz):
        return [f"no data for the last {silent_s:.1f} s: check its power and wiring"]
    if abs(rate_hz / nominal_hz - 1.0) > device.rate_tolerance:
        return [f"{rate_hz:.4g} Hz where the vehicle file has {nominal_hz:.4g} Hz: correct the file, or the device"]
    return []


def _clock_problems(nominal_hz: float, tick_hz: float) -> list[str]:
    if abs(tick_hz / nominal_hz - 1.0) <= TICK_TOLERANCE:
        return []
    return [f"its clock makes {tick_hz:.4g} ticks/s, tick_hz is {nominal_hz:.4g}: correct the file, or the node"]


def _marks(vehicle: config.Vehicle, name: str, device: BusDevice, rows: dict[str, Rows]) -> int | None:
    """Sync pulses in its own stream; None where it has no input for them, or where there is no coded sync line."""
    lines = [each.sync_line(other) for other, each in _on_buses(vehicle)]
    return device.marks(name, rows) if any(line is not None and line.coded for line in lines) else None


def _identity(mine: Rows) -> str:
    found = [_text(e) for code in IDENTITY for e in mine[mine["code"] == code]]
    return found[0] if found else ""


def _text(event: np.void) -> str:
    return str(event["text"].decode("utf-8", "replace"))


def _time_sigmas_us(vehicle: config.Vehicle, rows: dict[str, Rows]) -> dict[str, float]:
    """How well the times of each device's samples are known at the end, 1 sigma, us: of its first channel."""
    stamps = [part["host_ns"] for part in rows.values() if len(part)]
    if not stamps:
        return {}
    timebase = timebase_of(vehicle)
    until_ns = int(max(part.max() for part in stamps))
    for now_ns in range(int(min(part.min() for part in stamps)), until_ns + STEP_NS, STEP_NS):
        fresh = {n: r[(r["host_ns"] >= now_ns) & (r["host_ns"] < now_ns + STEP_NS)] for n, r in rows.items()}
        timebase.update(now_ns + STEP_NS, {name: part for name, part in fresh.items() if len(part)})
    found = {}
    for name, device in _on_buses(vehicle):
        channel = next(iter(device.channels(name)))
        if channel in timebase.channels and np.isfinite(sigma_ns := timebase.sigma_ns(channel, until_ns)):
            found[name] = 1e-3 * sigma_ns
    return found


def _without_pulses(vehicle: config.Vehicle, checks: Iterable[Check]) -> list[str]:
    """What it costs that no sync line is wired."""
    if sync_line(vehicle) is not None:
        return []
    known = {check.device: check.time_sigma_us for check in checks if check.time_sigma_us is not None}
    each = ", ".join(f"{name} {sigma:.0f} us" for name, sigma in known.items()) or "not known yet"
    return [
        f"no sync pulse is wired: times come from arrival, 1 sigma {each}, and delays of the buses remain in them; "
        "a pulse line to a GPIO and to each device brings them to some us (docs/sync_pulse.md)"
    ]


def render(found: Preflight) -> RenderableType:
    """The vehicle as a table, what stands against flying under it."""
    table = Table(box=SIMPLE_HEAD, show_edge=False, pad_edge=False)
    for heading in ("device", "kind", "is"):
        table.add_column(heading)
    for heading in ("Hz", "nominal", "sync", "time, us"):
        table.add_column(heading, justify="right")
    table.add_column()
    for check in found.checks:
        identity = "; ".join(filter(None, (check.identity, check.self_test and f"self test {check.self_test}")))
        rate = "" if check.rate_hz is None or check.nominal_hz is None else f"{check.rate_hz:.1f}"
        verdict = (
            ("not ready", "red") if check.problems else ("look", "yellow") if check.warnings else ("ready", "green")
        )
        table.add_row(
            *(check.device, check.kind, Text(identity), rate if check.nominal_hz else f"{check.rows} rows"),
            "" if check.nominal_hz is None else f"{check.nominal_hz:.1f}",
            "" if check.marks is None else str(check.marks),
            "" if check.time_sigma_us is None else f"{check.time_sigma_us:.0f}",
            Text(*verdict),
        )
    lines = [Text(f"{check.device}: {text}", "yellow") for check in found.checks for text in check.warnings]
    lines += [Text(f"{check.device}: {text}", "red") for check in found.checks for text in check.problems]
    lines += [Text(text, "yellow") for text in found.warnings]
    lines += [Text(text, "red") for text in found.problems]
    host = found.host
    hours = host.free_bytes / host.bytes_per_s / 3600.0
    room = (
        f"records {3.6 * host.bytes_per_s / 1e3:.0f} MB an hour, room for {hours:.1f} hours "
        f"({host.free_bytes / 1e9:.1f} GB); the disk takes {host.write_bytes_s / 1e6:.0f} MB/s"
    )
    end = Text("ready", "bold green") if found.ready else Text("not ready", "bold red")
    return Group(table, *lines, Text(room), end)
