"""Torque constants that a controller used: of the currents and torques that it asked for, both in a recording.

A controller that computes torques by a model asks its motors for the current that makes each, and that friction takes:

    i = tau / K + Fc sign(dq) / K + Fv dq / K + i0

is solved for 1 / K of each joint by least squares. Two blocks of columns are those currents and torques where the one
is about as large as what was measured, and the other explains it of every joint, better than any other pair does.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from onboard.estimation.policy import HALF
from onboard.ground.log.bring_in.guess.groups import ColumnGroup, Group
from onboard.ground.log.bring_in.guess.magnitudes import FloatArray

_LEAST_N_m_A = 2.0  # of a motor with its gear; two kinds of torques make about one
_EXPLAINED = 0.9  # of the variance of each joint's current, friction as simple as this
# of a ratio of one, between the currents that were asked for and those measured: friction is a third
_AS_MEASURED = 0.3


def controllers(one: ColumnGroup, measured: Group, rates: Group | None) -> tuple[FloatArray, str] | None:
    """N m in an A of each joint, and the columns they are of; None where no columns are of this kind.

    Args:
        one: the table.
        measured: currents of the motors, joint by joint.
        rates: of the joints.
    """
    if rates is None or len(rates.columns) != len(measured.columns):
        return None
    own, moved = measured.values, rates.values
    best = None
    some = list(_blocks(one, measured, rates))
    for wanted, current in some:
        if not _alike(current, own):
            continue
        for named, torque in some:
            found = _constants(current, torque, moved) if named != wanted else None
            if found is not None and (best is None or found[1] > best[1]):
                best = found[0], found[1], f"{named} over {wanted}"
    return None if best is None else (best[0], best[2])


def doubt(found: tuple[FloatArray, str] | None, stated: Sequence[tuple[float, float]]) -> str:
    """What differs from torque constants that are stated, each with its relative sigma; "" where nothing does."""
    if found is None:
        return ""
    made, columns = found
    text = ",".join(f"{one:.3g}" for one in made)
    said = f"by the controller's columns {columns}, friction aside, an A of each motor makes {text} N m"
    if len(stated) != len(made):
        return f"{said}: heft init --gains {text}"
    away = [abs(one / gain - 1.0) / max(sigma, 1e-9) for one, (gain, sigma) in zip(made, stated, strict=True)]
    if max(away) < HALF:
        return ""
    by_file = ",".join(f"{gain:g}" for gain, _ in stated)
    return f"{said}; the vehicle file says {by_file}: heft init --gains {text}, if you have none from a calibration"


def _blocks(one: ColumnGroup, measured: Group, rates: Group) -> Iterator[tuple[str, FloatArray]]:
    """Columns of as many joints, with what they are called: of a name each, or of numbers in succession."""
    count, used = len(measured.columns), {*measured.called, *rates.called}
    for group in one.groups:
        if len(group.columns) == count and used.isdisjoint(group.called):
            yield f"{group.called[0]} to {group.called[-1]}", group.values
    rest = [column for column in one.rest if column.name.isdigit()]
    while len(rest) >= count:
        block, rest = rest[:count], rest[count:]
        if int(block[-1].name) - int(block[0].name) == count - 1:
            values = np.column_stack([column.values for column in block]).astype(np.float64)
            yield f"{block[0].name} to {block[-1].name}", values


def _alike(current: FloatArray, measured: FloatArray) -> bool:
    good = np.isfinite(current).all(axis=1) & np.isfinite(measured).all(axis=1)
    squares = (current[good] ** 2).sum(axis=0)
    if not (squares > 0.0).all():
        return False
    ratio = (current[good] * measured[good]).sum(axis=0) / squares
    return abs(float(np.median(ratio)) - 1.0) < _AS_MEASURED


def _constants(current: FloatArray, torque: FloatArray, rates: FloatArray) -> tuple[FloatArray, float] | None:
    """Of each joint, and the least share of a joint's current that they explain."""
    made, shares = np.zeros(current.shape[1]), np.zeros(current.shape[1])
    for j, (i, tau, dq) in enumerate(zip(current.T, torque.T, rates.T, strict=True)):
        moving = np.isfinite(i) & np.isfinite(tau) & np.isfinite(dq) & (dq != 0.0)
        if moving.sum() < 50 or not np.ptp(i[moving]) > 0.0 or not np.ptp(tau[moving]) > 0.0:
            return None
        A = np.column_stack([tau, np.sign(dq), dq, np.ones(len(dq))])[moving]
        x, *_ = np.linalg.lstsq(A, i[moving], rcond=None)
        shares[j] = 1.0 - float(np.var(i[moving] - A @ x) / np.var(i[moving]))
        if not (0.0 < x[0] < 1.0 / _LEAST_N_m_A and shares[j] > _EXPLAINED):
            return None
        made[j] = 1.0 / x[0]
    return made, float(shares.min())
