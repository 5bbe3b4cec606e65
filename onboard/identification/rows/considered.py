"""Consider parameters (Schmidt): scales and delays with a known sigma, not estimated, part of the intervals.

One of a load cell changes its reading. One of a joint's sensor or of the base's IMU changes the regressor; its
effect is the change of the predicted rows at the present estimate.
"""

from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.dynamics.errors import SignalError, UnknownFrameError
from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.regressor.rows import BaseMotion, RowModel
from onboard.regressor.signals import Signals

Effect = Literal["scale", "delay", "joint_scale", "gyro_scale", "accelerometer_scale"]
_STEP = 1e-3  # relative, of a scale: rows are quadratic in the rates at most


class Considered(NamedTuple):
    """An error common to all readings of one instrument, with a known sigma."""

    name: str
    row: str  # of a load cell; of a joint, its name; of the IMU, anything
    effect: Effect
    sigma: float  # relative for a scale, s for a delay


def check(considered: Sequence[Considered], model: RowModel) -> None:
    """Checks that the model has each named row, joint or IMU.

    Raises:
        UnknownFrameError: it does not.
    """
    rows, joints = [row.name for row in model.rows], [joint.name for joint in model.vehicle.joints]
    for cause in considered:
        if cause.effect in ("scale", "delay") and cause.row not in rows:
            raise UnknownFrameError(f"considered {cause.name!r} names row {cause.row!r}; there are {rows}")
        if cause.effect == "joint_scale" and cause.row not in joints:
            raise UnknownFrameError(f"considered {cause.name!r} names joint {cause.row!r}; there are {joints}")


def columns(
    considered: Sequence[Considered],
    model: RowModel,
    signals: Signals,
    at: NDArray[np.intp],
    use: BoolArray,
    expected: Callable[[Signals], FloatArray],
) -> FloatArray | None:
    """``d y / d c``, (r, k), at the ticks ``at`` (t,), of the rows in use (t, rows); differences for joints and IMU.

    Args:
        considered: k causes.
        model: the rows.
        signals: all of them.
        at: ticks.
        use: which rows.
        expected: what the rows at these ticks should read, (t, rows), of the estimate so far and these signals.

    Raises:
        SignalError: a delay, and no rate of the measured rows.
    """
    if not considered:
        return None
    names = [row.name for row in model.rows]
    C = np.zeros((*use.shape, len(considered)))
    before: FloatArray | None = None
    for k, cause in enumerate(considered):
        if cause.effect == "scale":
            C[:, names.index(cause.row), k] = signals.measured[at, names.index(cause.row)]
        elif cause.effect == "delay":
            if signals.measured_rate is None:
                raise SignalError(f"{cause.name!r} is a delay; give the rate of the measured rows")
            C[:, names.index(cause.row), k] = -signals.measured_rate[at, names.index(cause.row)]
        elif cause.sigma > 0.0:
            before = expected(signals) if before is None else before
            C[..., k] = (before - expected(_scaled(signals, cause, model))) / _STEP
    return C[use]


def _scaled(signals: Signals, cause: Considered, model: RowModel) -> Signals:
    """The signals as they would be if one instrument read a little more."""
    if cause.effect == "joint_scale":
        joints = [joint.name for joint in model.vehicle.joints]
        factor = 1.0 + _STEP * np.array([name == cause.row for name in joints])
        return signals._replace(q=signals.q * factor, dq=signals.dq * factor, ddq=signals.ddq * factor)
    rate, acceleration, force = signals.motion
    more = 1.0 + _STEP
    if cause.effect == "gyro_scale":
        return signals._replace(motion=BaseMotion(more * rate, more * acceleration, force))
    return signals._replace(motion=BaseMotion(rate, acceleration, more * force))
