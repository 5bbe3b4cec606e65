"""Collects the data of a report in two passes over the log, in constant memory."""

import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.progress import Progress

from drivers.records import EVENT, GAP, IMU, SCALAR, Batch, Rows, Severity
from onboard import channels, config
from onboard.devices import si
from onboard.devices.roles import Roles
from onboard.dynamics.model.errors import ModelError
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.arrays import FloatArray
from onboard.flight.estimate.problem.identification import KERNELS_PER_BLOCK, build_online
from onboard.flight.estimate.readings.roles import roles_of
from onboard.ground.log.tables import truth as true
from onboard.ground.log.tables.phases import Phase, phases_of
from onboard.ground.log.tables.progress import reporter
from onboard.ground.log.tables.thin import Envelope, Thinned, Trace
from onboard.ground.log.tables.vehicle_file import vehicle_of
from onboard.ground.log.views.health import HealthSummary, is_health
from onboard.ground.log.views.info import LogInfo, info
from onboard.ground.report.flight.streams import Intervals, Spectrum
from onboard.identification.rows.identifier import Identifier
from onboard.recording.format.texts import printable
from onboard.recording.reader import LogReader

_EVENTS_KEPT = 200
_CHANGES = (b"capture", b"ejection")
_GAPS_KEPT = 2000
_SWEEPS_DETAILED = 8
_PENDING_ROWS = 8192
_SWEEP_BINS = 700
_MOST_BLOCKS = 16
_FEWEST_BLOCKS = 4
_AT_REST = 0.02  # of a joint's range over the flight


@dataclass
class SweepData:
    """One identification phase."""

    phase: Phase
    blocks: int  # number of time blocks taken as independent
    detailed: bool  # shown in detail (a selection, if there are many)
    rows: Rows | None = None  # thinned ROW
    traces: dict[str, Trace] = field(default_factory=dict)  # by channel, SI, unusable samples left out
    before: np.void | None = None  # the last ESTIMATE before it; None when there was none
    states: list[np.void] = field(default_factory=list)  # ESTIMATE, evenly spaced, the last one at its end
    moving: bool = True  # a joint moves in it


@dataclass
class FlightData:
    """Data of a flight for a report; times in s since ``info.start_ns``."""

    info: LogInfo
    vehicle: config.Vehicle | None
    roles: Roles | None
    identifier: Identifier | None
    model: VehicleModel | None
    phases: tuple[Phase, ...]
    sweeps: list[SweepData]
    truth: true.Truth | None
    notes: list[str]  # what could not be shown, with the reason
    traces: dict[str, Trace] = field(default_factory=dict)
    flagged: dict[str, FloatArray] = field(default_factory=dict)  # times of unusable samples, by channel
    spectra: dict[str, Spectrum] = field(default_factory=dict)  # of what changes with time: IMUs, scalars
    intervals: dict[str, Intervals] = field(default_factory=dict)
    quantities: dict[str, Rows] = field(default_factory=dict)
    clocks: dict[str, Rows] = field(default_factory=dict)
    gates: Rows | None = None  # thinned ROW
    gate_counts: dict[int, int] = field(default_factory=dict)
    rows_total: int = 0
    rows_used: int = 0
    events: list[Rows] = field(default_factory=list)
    gaps: list[Rows] = field(default_factory=list)
    health: HealthSummary = field(default_factory=HealthSummary)
    changes: list[tuple[int, str]] = field(default_factory=list)  # changes of payload: host time, capture or ejection

    @property
    def name(self) -> str:
        """Name of the vehicle; of the file if the log names none."""
        return self.info.metadata.get("flight", {}).get("vehicle", self.info.path.stem)

    def seconds(self, at_ns: NDArray[np.int64] | int) -> FloatArray:
        """Host or vehicle time as s since the start."""
        return np.asarray((np.asarray(at_ns, np.int64) - self.info.start_ns) * 1e-9, np.float64)


def gather(path: Path, progress: Progress | None = None, vehicle: config.Vehicle | None = None) -> FlightData:
    """Read ``path``, with ``vehicle``, or the one that the log carries where None.

    Raises:
        LogFormatError: it is no log of ours.
        OSError: it cannot be read.
    """
    log = LogReader(path)
    tell = reporter(progress, f"read {path.name}", 2 * log.size)
    about = info(log)
    tell(log.size)
    flight = _begin(log, about, vehicle)
    reader = _Reader(flight, log)
    for batch in log.batches():
        reader.add(batch)
        tell(log.size + log.position)
    reader.finish()
    return flight


def _begin(log: LogReader, about: LogInfo, given: config.Vehicle | None) -> FlightData:
    notes: list[str] = []
    vehicle, roles, identifier, model = given, None, None, None
    with tempfile.TemporaryDirectory() as directory:
        try:
            vehicle = given or vehicle_of(log, Path(directory))
            online, model = build_online(vehicle)
            identifier = online if isinstance(online, Identifier) else None
        except (config.ConfigError, ModelError, OSError) as error:
            notes.append(f"No vehicle that this version can use is known, so nothing is said of the model: {error}")
    if vehicle is not None:
        roles = roles_of(vehicle)
    phases = phases_of(log, vehicle.file.estimation.phases, about.end_ns) if vehicle else ()
    flown = [phase for phase in phases if phase.sweep]
    shown = set(np.linspace(0, len(flown) - 1, min(len(flown), _SWEEPS_DETAILED)).round().astype(int).tolist())
    if len(flown) > len(shown):
        notes.append(f"{len(shown)} of {len(flown)} sweeps, evenly chosen, are shown in detail.")
    sweeps = [SweepData(phase, _blocks(phase, vehicle), n in shown) for n, phase in enumerate(flown) if vehicle]
    return FlightData(about, vehicle, roles, identifier, model, phases, sweeps, true.read(log.path), notes)


def _blocks(phase: Phase, vehicle: config.Vehicle) -> int:
    settings = vehicle.file.estimation
    block_ns = 1e6 * (settings.block_ms or KERNELS_PER_BLOCK * settings.smoothing_ms)
    return int(np.clip((phase.end_ns - phase.start_ns) // block_ns, _FEWEST_BLOCKS, _MOST_BLOCKS))


class _Reader:
    """Second pass over the log."""

    def __init__(self, flight: FlightData, log: LogReader) -> None:
        self._flight = flight
        self._signals = flight.roles.signals if flight.roles else {}
        self._envelopes: dict[str, Envelope] = {}
        self._flagged: dict[str, Thinned] = {}
        self._sweep_envelopes: dict[tuple[int, str], Envelope] = {}
        self._sweep_rows = [Thinned(1500) for _ in flight.sweeps]
        self._thinned: dict[str, Thinned] = {}
        self._quantities: dict[bytes, Thinned] = {}
        self._clocks: dict[bytes, Thinned] = {}
        self._waiting: dict[str, list[Rows]] = {}
        self._waiting_rows: dict[str, int] = {}
        self._kind = {name: _kind(name, dtype) for name, dtype in log.channels.items()}

    def add(self, batch: Batch) -> None:
        """Add the next rows; a channel's are processed in blocks."""
        waiting = self._waiting.setdefault(batch.channel, [])
        waiting.append(batch.rows)
        self._waiting_rows[batch.channel] = self._waiting_rows.get(batch.channel, 0) + len(batch.rows)
        if self._waiting_rows[batch.channel] >= _PENDING_ROWS:
            self._flush(batch.channel)

    def _flush(self, channel: str) -> None:
        rows = np.concatenate(self._waiting[channel])
        self._waiting[channel], self._waiting_rows[channel] = [], 0
        self._take(Batch(channel, rows))

    def _take(self, batch: Batch) -> None:
        match self._kind[batch.channel]:
            case "signal":
                self._signal(batch)
            case "gap" if sum(map(len, self._flight.gaps)) < _GAPS_KEPT:
                self._flight.gaps.append(batch.rows)
            case "event":
                changes = batch.rows[np.isin(batch.rows["code"], _CHANGES)]
                self._flight.changes += [(int(row["host_ns"]), printable(row["code"])) for row in changes]
                loud = batch.rows[batch.rows["severity"] >= Severity.WARNING]
                if sum(map(len, self._flight.events)) < _EVENTS_KEPT and len(loud):
                    self._flight.events.append(loud)
            case "health":
                self._flight.health.add(batch.rows)
            case "clock":
                _by_name(self._clocks, batch.rows, "channel")
            case "quantity":
                _by_name(self._quantities, batch.rows, "name")
            case "row":
                self._rows(batch.rows)
            case "estimate":
                self._estimates(batch.rows)

    def _signal(self, batch: Batch) -> None:
        name, rows, flight = batch.channel, batch.rows, self._flight
        signal = self._signals.get(name)
        values = si.imu(rows, signal) if rows.dtype == IMU else si.scalar(rows, signal)[:, None]
        bad = ~si.usable(rows)
        if bad.any():
            values[bad] = np.nan
            self._flagged.setdefault(name, Thinned(500)).add(rows[bad][["host_ns"]])
        at_ns = rows["host_ns"]
        if signal is not None or not self._signals:  # not what is said now and then, as a phase is
            flight.intervals.setdefault(name, Intervals()).add(rows)
            flight.spectra.setdefault(name, Spectrum(values.shape[1])).add(rows["sequence"], values)
        if name not in self._envelopes:
            self._envelopes[name] = Envelope(flight.info.start_ns, values.shape[1], 1536)
        self._envelopes[name].add(at_ns, values)
        if rows.dtype != SCALAR:
            return
        for number, sweep in enumerate(flight.sweeps):
            if not sweep.detailed:
                continue
            inside = (at_ns >= sweep.phase.start_ns) & (at_ns < sweep.phase.end_ns)
            if inside.any():
                key = number, name
                if key not in self._sweep_envelopes:
                    self._sweep_envelopes[key] = Envelope(sweep.phase.start_ns, 1, _SWEEP_BINS)
                self._sweep_envelopes[key].add(at_ns[inside], values[inside])

    def _rows(self, rows: Rows) -> None:
        flight = self._flight
        flight.rows_total += rows["gate"].size
        flight.rows_used += int(np.count_nonzero(rows["gate"] == 0))
        for bit in range(32):
            if count := int(np.count_nonzero(rows["gate"] & (1 << bit))):
                flight.gate_counts[1 << bit] = flight.gate_counts.get(1 << bit, 0) + count
        self._thinned.setdefault("row", Thinned(4000)).add(rows)
        at_ns = rows["vehicle_ns"]
        for sweep, thinned in zip(flight.sweeps, self._sweep_rows, strict=True):
            if sweep.detailed:
                thinned.add(rows[(at_ns >= sweep.phase.start_ns) & (at_ns < sweep.phase.end_ns)])

    def _estimates(self, rows: Rows) -> None:
        """Collect the estimator states at the start of, during and at the end of each sweep."""
        at_ns = rows["vehicle_ns"]
        for sweep in self._flight.sweeps:
            first, last = sweep.phase.start_ns, sweep.phase.end_ns
            if at_ns[0] < first:
                sweep.before = rows[np.searchsorted(at_ns, first) - 1].copy()
            while len(sweep.states) < sweep.blocks:
                due_ns = first + (last - first) * (len(sweep.states) + 1) // sweep.blocks
                row = int(np.searchsorted(at_ns, due_ns))
                if row == len(rows):
                    break
                sweep.states.append(rows[row].copy())

    def finish(self) -> None:
        """Process the remaining rows and store the results in the flight's data."""
        for channel in [channel for channel, waiting in self._waiting.items() if waiting]:
            self._flush(channel)
        flight = self._flight
        zero_ns = flight.info.start_ns
        flight.traces = {name: envelope.trace(zero_ns) for name, envelope in self._envelopes.items()}
        for (number, name), envelope in self._sweep_envelopes.items():
            flight.sweeps[number].traces[name] = envelope.trace(zero_ns)
        _name_rests(flight)
        flight.quantities = {printable(name): _kept(thinned) for name, thinned in self._quantities.items()}
        flight.clocks = {printable(name): _kept(thinned) for name, thinned in self._clocks.items()}
        for sweep, thinned in zip(flight.sweeps, self._sweep_rows, strict=True):
            sweep.rows = thinned.rows
        flight.gates = self._thinned["row"].rows if "row" in self._thinned else None
        flight.flagged = {name: flight.seconds(_kept(thinned)["host_ns"]) for name, thinned in self._flagged.items()}


def _name_rests(flight: FlightData) -> None:
    """Call identification phases in which no joint moves ``at rest``, and number the others."""
    joints = [joint for joint in flight.roles.joints if joint.channel in flight.traces] if flight.roles else []
    whole = {joint.channel: _reach(flight.traces[joint.channel]) for joint in joints}
    number = 0
    named: dict[Phase, Phase] = {}
    for sweep in flight.sweeps:
        seen = [(_reach(trace), whole[name]) for name, trace in sweep.traces.items() if name in whole]
        sweep.moving = not seen or any(own > _AT_REST * every for own, every in seen)
        number += sweep.moving
        named[sweep.phase] = sweep.phase._replace(name=f"sweep {number}" if sweep.moving else "at rest")
        sweep.phase = named[sweep.phase]
    flight.phases = tuple(named.get(phase, phase) for phase in flight.phases)


def _reach(trace: Trace) -> float:
    known = trace.mean[np.isfinite(trace.mean)]
    return float(np.ptp(known)) if known.size else 0.0


def _kind(name: str, dtype: np.dtype[np.void]) -> str:
    """Kind of the rows, by the fields used here: records of other versions may carry more fields."""
    fields = set(dtype.names or ())
    known = {
        "signal": dtype in (IMU, SCALAR),
        "gap": dtype == GAP,
        "event": dtype == EVENT,
        "clock": {"period_ns", "sigma_ns", "residual_rms_ns", "state", "channel", "marks", "rejected"} <= fields,
        "quantity": channels.is_quantity(dtype),
        "health": is_health(dtype),
        "row": name == "row" and {"vehicle_ns", "measured", "gate", "joint_rad_s2"} <= fields,
        "estimate": name == "estimate" and {"vehicle_ns", "triangle"} <= fields,
    }
    return next((kind for kind, fits in known.items() if fits), "other")


def _by_name(store: dict[bytes, Thinned], rows: Rows, name: str) -> None:
    for one in np.unique(rows[name]):
        store.setdefault(one, Thinned()).add(rows[rows[name] == one])


def _kept(thinned: Thinned) -> Rows:
    rows = thinned.rows
    assert rows is not None
    return rows
