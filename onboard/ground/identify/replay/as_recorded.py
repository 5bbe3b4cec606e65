"""What a recording says of itself, where the vehicle file of a recorded arm leaves it open or contradicts it.

A vehicle file by ``heft init`` states the usual, and recorders differ: how far apart samples are, to how much readings
are rounded, whether they are written more than once, in which recording of several the payload is held. That is in the
log, and an estimate by another number is wrong or refused. What is found is said with the answer.

Where the vehicle file does not say how widely the rows of a recorded arm are smoothed, the recording decides. What a
narrow kernel passes besides the bodies' motion (noise of differentiated angles, gears, friction that reverses, flexible
joints) is taken for inertia; what a wide one smooths away tells nothing. Rows of every width have the same parameters,
so each half of the recording by each width predicts the rows of the other half by each width: the width whose
parameters predict best, in all of these bands together, is taken.
"""

import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard import config
from onboard.config.estimation import LAG_OF_WIDTH, Phases
from onboard.devices.base import ImuDevice
from onboard.devices.recorded import RecordedDevice
from onboard.devices.registry import DEVICES
from onboard.estimation.arrays import FloatArray
from onboard.estimation.policy import LIKELY_SIZE, MOST_CONTRADICTED, MOSTLY
from onboard.estimation.smoothing import CUTS_OFF
from onboard.estimation.stuck import StuckReadings
from onboard.flight.estimate.estimator import Estimator
from onboard.flight.estimate.readings.roles import roles_of
from onboard.ground.identify.replay.feed import AT_ONCE_s, fed, same_unit
from onboard.identification.free_flyer.guesses import WIDEST_s
from onboard.identification.rows.checks.prediction import predicted, reference_of
from onboard.identification.rows.held_out import Half, halves
from onboard.identification.rows.identifier import Identifier
from onboard.identification.windows import SHORTEST
from onboard.recording.reader import LogReader

WIDTHS_ms = tuple(1e3 * WIDEST_s / 2**k for k in (3, 2, 1, 0))
FEWEST_SAMPLES = 8  # under a kernel: a spline of order 8 has as many pieces
_ROWS = 10.0  # in a width: as 100 Hz makes in 100 ms; half are enough to compare widths, for half the time
IN_TURN = "recording"
"""Channel of ``heft merge --in-turn recording``: 1, 2, ... by the recording that rows are of; or, in one recording, of
a column that says by 0 and 1 whether the payload is held."""
_WHOLE = 0.05  # by which what is a whole number may differ from it: steps in quanta, besides what is rounded; samples


class RecordedVehicle(NamedTuple):
    """A vehicle as its recording says."""

    vehicle: config.Vehicle
    said: tuple[str, ...]  # what differs from its file


def with_width(vehicle: config.Vehicle, width_ms: float, rows: float = _ROWS) -> config.Vehicle:
    """The same vehicle with another smoothing, rows as far apart as that asks for, and a lag that it fits into."""
    return with_settings(vehicle, width_ms, row_rate_hz=min(100.0, 1e3 * rows / width_ms))


def with_settings(vehicle: config.Vehicle, width_ms: float, **more: float) -> config.Vehicle:
    """The same vehicle with another smoothing, a lag that it fits into, and other settings of its estimation."""
    own = {"smoothing_ms": width_ms, "lag_ms": max(vehicle.file.estimation.lag_ms, LAG_OF_WIDTH * width_ms), **more}
    return vehicle.with_sections(estimation=vehicle.file.estimation.model_copy(update=own))


def best_width(errors: Mapping[float, float]) -> tuple[float, str]:
    """The width, ms, that predicts the other half best, and what is said of it.

    Args:
        errors: relative, by width.
    """
    best_ms = min(errors, key=errors.__getitem__)
    each = ", ".join(f"{error:.1%} by {width_ms:g} ms" for width_ms, error in errors.items())
    band_Hz = 1e3 * CUTS_OFF / best_ms
    return best_ms, (
        f"estimation.smoothing_ms: {best_ms:g}, for motion below {band_Hz:.2g} Hz; left over of the other half: {each}"
    )


def chosen(vehicle: config.Vehicle, log: LogReader) -> RecordedVehicle | None:
    """The vehicle with the width that its recording asks for; None where it cannot be determined.

    Args:
        vehicle: by rows, of a fixed or carried base, its devices recorded ones.
        log: its recording.
    """
    slowest_s = max(signal.period_s for signal in roles_of(vehicle).signals.values())
    by_width = dict[float, tuple[Identifier, tuple[Half, Half]]]()
    for width_ms in (one for one in WIDTHS_ms if 1e-3 * one >= FEWEST_SAMPLES * slowest_s):
        estimator = Estimator(with_width(vehicle, width_ms, 0.5 * _ROWS), at_the_end=True)
        who = fed(estimator, log, AT_ONCE_s).identifier
        if (by_halves := halves(who)) is not None:
            by_width[width_ms] = who, by_halves
    if len(by_width) < 2:
        return None
    errors = {width_ms: _error(own, by_width.values()) for width_ms, (_, own) in by_width.items()}
    best_ms, said = best_width(errors)
    return RecordedVehicle(with_width(vehicle, best_ms), (said,))


def _error(own: tuple[Half, Half], bands: Iterable[tuple[Identifier, tuple[Half, Half]]]) -> float:
    """Geometric mean over all bands of what parameters of one half leave of the other half."""
    left = [
        predicted(half.normal, mine.mean, reference_of(who.model, who.base, half.normal)).relative_error
        for who, rows in bands
        for half, mine in zip(rows[::-1], own, strict=True)
    ]
    return float(np.exp(np.mean(np.log(left))))


def as_recorded(vehicle: config.Vehicle, log: LogReader) -> RecordedVehicle:
    """The vehicle whose devices are all recorded ones, an arm's or one that floats, turns or is thrown; others as is.

    Args:
        vehicle: its file.
        log: a recording of it.
    """
    devices, settings = dict(vehicle.file.device), vehicle.file.estimation
    carried = not vehicle.file.vehicle.base_kind.follows and settings.method == "rows"
    turns = vehicle.prediction is config.Prediction.PIVOT
    free = turns or vehicle.prediction in (config.Prediction.FREE, config.Prediction.PLANAR)
    thrown = vehicle.prediction is config.Prediction.ROWS and vehicle.file.free_body is not None
    if not (carried or free or thrown) or not vehicle.is_recorded:
        return RecordedVehicle(vehicle, ())
    found = dict[str, list[str]]()  # devices, by what the log says of them
    for name, device in devices.items():
        if isinstance(device, RecordedDevice) and name in log.channels:
            devices[name], more = _device(name, device, log)
            for one in more:
                found.setdefault(one, []).append(name)
    said = [f"{text} ({', '.join(f'device.{name}' for name in names)})" for text, names in found.items()]
    held = _held(vehicle, log) if carried or turns else None
    if free and (slower := _ticks(devices, settings.row_rate_hz, whole=turns)) < settings.row_rate_hz:
        settings = settings.model_copy(update={"row_rate_hz": slower})
        samples = "a whole number of samples of the" if turns else "two samples of the slowest"
        said.append(f"estimation.row_rate_hz: {slower:.6g}, {samples} IMU to a row")
    recorded = {name: device for name, device in devices.items() if isinstance(device, RecordedDevice)}
    wheels = [one.period_ms for name, one in recorded.items() if any(it.is_rate for it in one.roles(name, 1.0).joints)]
    width_ms = FEWEST_SAMPLES * max(wheels, default=0.0)
    if turns and width_ms > settings.smoothing_ms:
        settings = settings.model_copy(update={"smoothing_ms": width_ms})
        said.append(f"estimation.smoothing_ms: {width_ms:g}, {FEWEST_SAMPLES} samples of the slowest wheel")
    if held is not None:
        devices[IN_TURN] = DEVICES["recorded_value"].model_validate({"kind": "recorded_value", "period_ms": 100.0})
        settings = settings.model_copy(update={"phases": held})
        begins = f"the payload is held from {held.payload_taken} on in channel {IN_TURN!r}"
        said.append(f"{begins}: [estimation.phases]")
    found_so_far = vehicle.with_sections(device=devices, estimation=settings)
    if free or thrown or "smoothing_ms" in settings.model_fields_set or (choice := chosen(found_so_far, log)) is None:
        return RecordedVehicle(found_so_far if said else vehicle, tuple(said))
    return RecordedVehicle(choice.vehicle, (*said, *choice.said))


def _ticks(devices: Mapping[str, object], rate_Hz: float, *, whole: bool) -> float:
    """Rate of the rows, or the highest with two samples of every IMU to a row, where that is lower [Hz].

    ``whole``: with a whole number of samples, as means of two and of three in turn are late by turns.
    """
    slowest_ms = max(
        (one.period_ms for one in devices.values() if isinstance(one, RecordedDevice) and isinstance(one, ImuDevice)),
        default=0.0,
    )
    if not slowest_ms:
        return rate_Hz
    least = 1e3 / (slowest_ms * rate_Hz)  # samples to a row
    return min(rate_Hz, 1e3 / (slowest_ms * max(2.0, np.ceil(least - _WHOLE) if whole else least)))


def _device(name: str, device: RecordedDevice, log: LogReader) -> tuple[RecordedDevice, list[str]]:
    """A device by its rows, and what differs from its table."""
    rows, said, found = log.read(name), list[str](), dict[str, object]()
    if len(rows) < SHORTEST:
        return device, said
    period_ms = 1e-6 * float(np.median(np.diff(rows["host_ns"])))
    ratio = period_ms / device.period_ms
    if abs(ratio - 1.0) > LIKELY_SIZE and same_unit(ratio):
        found["period_ms"] = period_ms
        said.append(f"period_ms: samples are {period_ms:.4g} ms apart, not {device.period_ms:g}")
    stated = device.model_dump()
    if "quantum_counts" not in stated:
        return device.model_copy(update=found), said
    raw = rows["value_raw"].astype(np.float64)
    if (quantum := quantum_of(raw)) > stated["quantum_counts"]:
        found["quantum_counts"] = quantum
        rounding = quantum * float(rows["scale"][0]) / 12.0**0.5
        if rounding > stated.get("noise_rad", np.inf):
            found["noise_rad"] = rounding
            said.append(f"noise_rad: angles are rounded, {rounding:.2g} rad rms, not {stated['noise_rad']:g}")
    if not stated.get("repeats", True) and "noise_rad" in stated and _repeats(raw / quantum):
        found["repeats"] = True
        said.append("repeats: the recorder writes readings more than once, true")
    return device.model_copy(update=found), said


def quantum_of(raw: NDArray[np.floating]) -> float:
    """Counts that all steps between readings are whole numbers of, by those of few; 1 where there is no such number.

    Readings may be rounded twice, by the instrument and by the digits that were written: steps are then of the
    instrument's quantum but for a digit.

    Args:
        raw: readings, counts, (n,).
    """
    steps = np.abs(np.diff(raw))
    steps = steps[steps > 0.0]
    if len(steps) < SHORTEST:
        return 1.0
    digit, least = float(np.gcd.reduce(np.rint(steps).astype(np.int64))), float(steps.min())
    few = steps[2.0 * digit * steps < least**2]  # of which rounding leaves open no number of the least ones
    if len(few) < SHORTEST:
        return digit
    quantum = float(few.sum() / np.rint(few / least).sum())
    apart = digit / quantum + _WHOLE  # two roundings of half a digit each
    if 2.0 * apart > MOSTLY:  # of steps of any size, so many are as near to whole numbers
        return digit
    split = np.abs(few / quantum - np.rint(few / quantum)) > apart
    return quantum if split.mean() < MOST_CONTRADICTED else digit


def _repeats(raw: FloatArray) -> bool:
    """Whether readings of a joint that moves are equal so often, and for as long, that it is the recorder's way."""
    stuck, _ = StuckReadings(1, math.inf, travels=True).watch(raw[:, None], np.ones(len(raw), np.bool_))
    begins = np.flatnonzero(np.append(True, np.diff(raw) != 0.0))
    lengths = np.diff(np.append(begins, len(raw)))[stuck[begins]]
    return len(lengths) >= SHORTEST and bool(np.median(lengths) > MOSTLY * lengths.max())


def _held(vehicle: config.Vehicle, log: LogReader) -> Phases | None:
    """The phases of recordings that were merged in turn, where the vehicle file says nothing of any."""
    silent = vehicle.file.estimation.phases is None and IN_TURN not in vehicle.file.device
    if not silent or vehicle.file.vehicle.payload_link is None or IN_TURN not in log.channels:
        return None
    rows = log.read(IN_TURN)
    numbers = sorted(set(np.rint(rows["value_raw"] * rows["scale"]).astype(int).tolist()))
    return Phases(channel=IN_TURN, identify=numbers, payload_taken=numbers[1]) if len(numbers) > 1 else None
