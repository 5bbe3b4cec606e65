"""How wide the smoothing of joints on a recorded base that floats is, where its file does not say: by its own motion.

The base IMU is predicted from smoothed joints. What a narrow kernel passes of rounded angles, differentiated twice, is
taken for motion and makes the payload too light; a wide one smooths the motion itself away. What is predicted is the
same by every width, so the width by which one half of the flight best predicts the other is taken.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from onboard import config
from onboard.flight.estimate.readings.roles import roles_of
from onboard.ground.identify.kinds.identified import Identified
from onboard.ground.identify.replay.as_recorded import FEWEST_SAMPLES, WIDTHS_ms, best_width, with_settings
from onboard.recording.reader import LogReader

# Widths are tried in each order until the error grows: a fit of noise takes minutes.
*_NARROWER_ms, _WIDEST_ms = WIDTHS_ms


class ChosenWidth(NamedTuple):
    """A vehicle with the width of its smoothing, what is said of it, and the answer by it where it is known by now."""

    vehicle: config.Vehicle
    said: tuple[str, ...] = ()
    found: Identified | None = None


def with_chosen_width(
    vehicle: config.Vehicle, log: LogReader, identify: Callable[[config.Vehicle, LogReader], Identified] | None
) -> ChosenWidth:
    """A recorded vehicle that floats, with the width of smoothing that its recording asks for.

    As it is, without words, is any other vehicle, one whose file says how wide, and one whose recording does not tell.
    A recording whose mapping has a mistake is answered by the first width: by none it is another.

    Args:
        vehicle: its file.
        log: its recording.
        identify: estimates from it; None where rows do.
    """
    settings = vehicle.file.estimation
    floats = vehicle.prediction in (config.Prediction.FREE, config.Prediction.PLANAR)
    if identify is None or not floats or not vehicle.is_recorded or "smoothing_ms" in settings.model_fields_set:
        return ChosenWidth(vehicle)
    slowest_ms = 1e3 * max(signal.period_s for signal in roles_of(vehicle).signals.values())
    errors, tried = dict[float, float](), dict[float, Identified]()

    def try_in_turn(widths_ms: Sequence[float]) -> None:
        for width_ms in (one for one in widths_ms if one >= FEWEST_SAMPLES * slowest_ms):
            tried[width_ms] = identify(with_settings(vehicle, width_ms), log)
            held_out = tried[width_ms].held_out
            if held_out is None:
                break
            errors[width_ms] = math.sqrt(held_out.later.relative_error * held_out.earlier.relative_error)
            if errors[width_ms] > min(errors.values()):
                break

    try_in_turn(_NARROWER_ms[::-1])
    for width_ms, found in tried.items():
        if found.misread:
            return ChosenWidth(with_settings(vehicle, width_ms), (), found)
    try_in_turn([_WIDEST_ms] if errors else _NARROWER_ms[:-1])  # no fit by the widest: it smooths the motion away
    if not errors:
        return ChosenWidth(vehicle)
    best_ms, said = best_width(dict(sorted(errors.items())))
    return ChosenWidth(with_settings(vehicle, best_ms), (said,), tried[best_ms])
