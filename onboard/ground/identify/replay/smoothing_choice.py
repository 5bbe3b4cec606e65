"""How wide the smoothing of a recorded arm's rows is, where its vehicle file does not say: by its own motion.

What a narrow kernel passes besides the bodies' motion (noise of differentiated angles, gears, friction as it reverses,
flexible joints) is taken for inertia; what a wide one smooths away tells nothing. Rows of every width have the same
parameters, so each half of the recording by each width predicts the rows of the other half by each width: the width
whose parameters predict best, in all of these bands together, is taken.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from onboard import config
from onboard.config.estimation import LAG_OF_WIDTH
from onboard.estimation.arrays import FloatArray
from onboard.estimation.smoothing import CUTS_OFF
from onboard.flight.estimate.estimator import Estimator
from onboard.flight.estimate.readings.roles import roles_of
from onboard.ground.identify.replay.feed import AT_ONCE_s, feed
from onboard.identification.rows.checks.prediction import predicted, reference_of
from onboard.identification.rows.held_out import halves
from onboard.identification.rows.identifier import Identifier
from onboard.recording.reader import LogReader

WIDTHS_ms = (100.0, 200.0, 400.0, 800.0)
FEWEST_SAMPLES = 8  # under a kernel: a spline of order 8 has as many pieces
_ROWS, _ROWS_TRIED = 10.0, 5.0  # in a width: as 100 Hz makes in 100 ms; enough to compare widths, for half the time
_ALIKE = 1.02  # times the least error: as good; the narrowest of those tells most


class WidthChoice(NamedTuple):
    """A width and why."""

    vehicle: config.Vehicle
    said: str


def with_width(vehicle: config.Vehicle, width_ms: float, rows: float = _ROWS) -> config.Vehicle:
    """The same vehicle with another smoothing, rows as far apart as that asks for, and a lag that it fits into."""
    return with_settings(vehicle, width_ms, row_rate_hz=min(100.0, 1e3 * rows / width_ms))


def with_settings(vehicle: config.Vehicle, width_ms: float, **more: float) -> config.Vehicle:
    """The same vehicle with another smoothing, a lag that it fits into, and other settings of its estimation."""
    own = {"smoothing_ms": width_ms, "lag_ms": max(vehicle.file.estimation.lag_ms, LAG_OF_WIDTH * width_ms), **more}
    settings = vehicle.file.estimation.model_copy(update=own)
    return vehicle.model_copy(update={"file": vehicle.file.model_copy(update={"estimation": settings})})


def narrowest(errors: Mapping[float, float]) -> tuple[float, str]:
    """The narrowest width, ms, of those that predict the other half as well as any, and what is said of it.

    Args:
        errors: relative, by width.
    """
    best_ms = next(width_ms for width_ms, error in errors.items() if error <= _ALIKE * min(errors.values()))
    each = ", ".join(f"{error:.1%} by {width_ms:g} ms" for width_ms, error in errors.items())
    band_Hz = 1e3 * CUTS_OFF / best_ms
    return best_ms, (
        f"estimation.smoothing_ms: {best_ms:g}, for motion below {band_Hz:.2g} Hz; left over of the other half: {each}"
    )


def chosen(vehicle: config.Vehicle, log: LogReader) -> WidthChoice | None:
    """The vehicle with the width that its recording asks for; None where it cannot be determined.

    Args:
        vehicle: by rows, of a fixed or carried base, its devices recorded ones.
        log: its recording.
    """
    slowest_s = max(signal.period_s for signal in roles_of(vehicle).signals.values())
    by_width = dict[float, Identifier]()
    for width_ms in WIDTHS_ms:
        if 1e-3 * width_ms < FEWEST_SAMPLES * slowest_s:
            continue
        who = _identified(with_width(vehicle, width_ms, _ROWS_TRIED), log)
        if who is not None:
            by_width[width_ms] = who
    if len(by_width) < 2:
        return None
    errors = {width_ms: _error(who, list(by_width.values())) for width_ms, who in by_width.items()}
    best_ms, said = narrowest(errors)
    return WidthChoice(with_width(vehicle, best_ms), said)


def _identified(vehicle: config.Vehicle, log: LogReader) -> Identifier | None:
    """The estimator after the log; None where its rows cannot be halved."""
    estimator = Estimator(vehicle, at_the_end=True)
    for _ in feed(estimator, log, AT_ONCE_s):
        pass
    return estimator.identifier if halves(estimator.identifier.seen, estimator.identifier) is not None else None


def _error(who: Identifier, others: list[Identifier]) -> float:
    """Geometric mean over all bands of what parameters of one half leave of the other half."""
    by_halves = halves(who.seen, who)
    assert by_halves is not None
    left = list[float]()
    for other in others:
        rows = halves(other.seen, other)
        assert rows is not None
        left += [_left(half.normal, mine.mean, other) for half, mine in zip(rows[::-1], by_halves, strict=True)]
    return float(np.exp(np.mean(np.log(left))))


def _left(normal: FloatArray, mean: FloatArray, other: Identifier) -> float:
    return predicted(normal, mean, reference_of(other.model, other.base, normal)).relative_error
