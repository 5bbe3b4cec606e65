"""Whether the yaw of a body on a table is in rad or in degrees: by where its thrusters push it.

A body on a table may turn as often as it likes, or hold its heading within a few degrees: the size of the numbers does
not tell their unit. That it goes along its own thrusters does, whatever its mass, and whichever way the axes count.
"""

import numpy as np
from numpy.typing import NDArray

from onboard.estimation.arrays import BoolArray
from onboard.estimation.policy import ODDS
from onboard.ground.log.bring_in.guess.magnitudes import DEG, FloatArray, going_on

_STEP_s, _SPAN_s = 0.02, 0.3  # of the integrals; of the second differences
_LONGEST_s = 120.0
_DELAYS_s = np.arange(-0.1, 0.75, 0.05)


def unit_of(time_s: FloatArray, place: FloatArray, yaw: FloatArray, levels: FloatArray) -> str:
    """``rad`` or ``deg``, by which the commands explain the way of the body; "" where neither is 100 times likelier.

    Args:
        time_s: (n,).
        place: (n, 2) of what is tracked, in any unit of length.
        yaw: (n,) as recorded.
        levels: (n, j) of the thrusters, in any unit.
    """
    good: BoolArray = np.asarray(np.isfinite(np.column_stack([time_s, place, yaw, levels])).all(axis=1), np.bool_)
    good[good] &= np.append(True, np.diff(time_s[good]) > 0.0)
    if good.sum() < 2:
        return ""
    t = np.asarray(time_s[good] - time_s[good][0], np.float64)
    grid = np.arange(0.0, min(float(t[-1]), _LONGEST_s), _STEP_s)
    x, y = (np.interp(grid, t, one) for one in place[good].T)
    own = np.interp(grid, t, going_on(yaw[good][:, None])[:, 0])
    apart = round(_SPAN_s / _STEP_s)
    rows, columns = (len(grid) - 2 * apart) // (apart // 2), 2 * (levels.shape[1] + 2)
    if rows <= columns:
        return ""
    went = _twice(np.asarray(x + 1j * y, np.complex128), apart)
    either_way = np.stack([went, went.conj()], axis=1)  # as recorded, and if one axis, or the yaw, counts the other way
    left = {"rad": np.inf, "deg": np.inf}
    for delay_s in _DELAYS_s:
        at = np.clip(np.searchsorted(t, grid - delay_s, side="right") - 1, 0, len(t) - 1)
        pushed = levels[good][at]
        for unit, angle in (("rad", own), ("deg", own / DEG)):
            turned = np.asarray(np.exp(1j * angle), np.complex128)
            way: NDArray[np.complex128] = np.cumsum(np.cumsum(turned[:, None] * pushed, axis=0), axis=0) * _STEP_s**2
            A = np.column_stack([_twice(way, apart), _twice(turned, apart), np.ones(len(went))])
            rest = either_way - A @ np.linalg.lstsq(A, either_way, rcond=None)[0]
            left[unit] = min(left[unit], float((np.abs(rest) ** 2).sum(axis=0).min()))
    best = min(left, key=lambda unit: left[unit])
    nats = rows * abs(np.log(left["rad"] / left["deg"])) if min(left.values()) > 0.0 else 0.0
    return best if nats > -np.log(ODDS) else ""


def _twice(values: NDArray[np.complex128], apart: int) -> NDArray[np.complex128]:
    """Second differences over ``apart`` rows, each half as far from the next."""
    found = values[2 * apart :] - 2.0 * values[apart:-apart] + values[: -2 * apart]
    return np.asarray(found[:: apart // 2], np.complex128)
