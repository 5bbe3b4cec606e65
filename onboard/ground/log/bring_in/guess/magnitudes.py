"""Units by size, and by what quantities say of each other: a rate is its angle's derivative, gyros turn an attitude.

Where neither name nor numbers decide, the usual unit is taken and the doubt is said.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.ground.log.bring_in.channel_rows import unwrapped
from onboard.ground.log.bring_in.mapping import NS_PER

FloatArray = NDArray[np.float64]
_G = 9.80665
_COUNTS_A_G = (2048, 4096, 8192, 16384)  # of 16 bits over 16, 8, 4, 2 g
_AS_GRAVITY = 0.06  # of it: 60 mg is the zero of the poorest sensors
_STILL = 0.02  # of the size: scatter by axis of what lies still
_SAME = 0.2  # of a ratio that is one
_FASTEST_rad_s = 40.0  # 2000 deg/s and some more: the range of the usual gyros
_SLOW_rad_s = 3.0
_EXACT = 1e12  # counts, of which a float still has three decimals
_TURN = 2.0 * np.pi
_OF_A_TURN = 0.2  # that a joint turns from one sample to the next
_FEWEST_COUNTS, _FEWEST_BITS = 360.0, 10  # of an encoder's: less could be degrees; a turn of 1024
_NEARLY_ALL = 0.99  # of the values; of the rest some may be what a tracker writes where it sees nothing
DEG = 180.0 / np.pi


class Unit(NamedTuple):
    """A unit of a mapping; what it is by; the doubt, or ""; counts in a unit, where values are whole counts."""

    name: str
    why: str
    doubt: str = ""
    counts: float = 1.0

    def beside(self, doubt: str) -> "Unit":
        """With another doubt."""
        return self._replace(doubt="; ".join(one for one in (doubt, self.doubt) if one))


def of_accelerations(values: FloatArray, named: str) -> Unit:
    """Of specific force (n, 3): at rest it is gravity."""
    if named in ("m/s^2", "g", "mg"):
        return Unit(named, "by its name")
    good = values[np.isfinite(values).all(axis=1)]
    whole = bool((good == np.rint(good)).all())
    rest = _at_rest(good)
    if rest is not None:
        for unit, size in (("m/s^2", _G), ("g", 1.0)):
            if abs(rest / size - 1.0) < _AS_GRAVITY and not (whole and unit == "g"):
                return Unit(unit, f"{rest:.4g} at rest")
        if abs(rest / 1000.0 - 1.0) < _AS_GRAVITY:
            return Unit("mg", f"{rest:.4g} at rest")
        for counts in _COUNTS_A_G if whole else ():
            if abs(rest / counts - 1.0) < _AS_GRAVITY:
                return Unit("g", f"{rest:.5g} counts at rest", f"counts: {counts} in a g by their size at rest", counts)
    odd = "it is nowhere at rest" if rest is None else f"{rest:.4g} at rest is neither m/s^2 nor g"
    if whole:
        return Unit("g", "by default", f"{odd}; whole counts: 2048 in a g are those of a range of 16 g", _COUNTS_A_G[0])
    return Unit("m/s^2", "by default", f"{odd}; g is as possible")


def _at_rest(values: FloatArray) -> float | None:
    """Size of vectors (n, 3) in the twentieth of the rows in which they change least; None if they change there too."""
    length = max(2, len(values) // 20)
    parts = [values[k : k + length] for k in range(0, len(values) - length + 1, length)]
    sizes = [float(np.median(np.linalg.norm(part, axis=1))) for part in parts]
    moved = [float(part.std(axis=0).max()) / max(size, 1e-12) for part, size in zip(parts, sizes, strict=True)]
    k = int(np.argmin(moved)) if moved else 0
    return sizes[k] if moved and moved[k] < _STILL else None


def of_rates_of_turn(values: FloatArray, named: str, by_attitude: float | None, beside: str) -> Unit:
    """Of a gyro (n, 3).

    Args:
        values: of it.
        named: unit by the name.
        by_attitude: what it reads for a rad/s, as a quaternion beside it turns; or None.
        beside: unit of the accelerometer: who writes g, writes degrees.
    """
    named = {"rad": "rad/s", "deg": "deg/s"}.get(named, named)
    if named in ("rad/s", "deg/s"):
        return Unit(named, "by its name")
    if by_attitude is not None:
        for unit, size in (("rad/s", 1.0), ("deg/s", DEG)):
            if abs(by_attitude / size - 1.0) < _SAME:
                return Unit(unit, "as the attitude turns")
    largest = float(np.nanmax(np.abs(values), initial=0.0))
    if bool((values == np.rint(values)).all()) and largest > _FASTEST_rad_s:
        return Unit("deg/s", "by default", "whole counts: 16.4 in a deg/s are those of a range of 2000 deg/s", 16.4)
    if largest > _FASTEST_rad_s:
        return Unit("deg/s", f"up to {largest:.3g}, more than gyros read in rad/s")
    if beside in ("g", "mg"):
        return Unit("deg/s", "as accelerations are in g", f"up to {largest:.3g}, and no name: rad/s is as possible")
    doubt = f"up to {largest:.3g}: in deg/s that would be slow, but can be" if largest > _SLOW_rad_s else ""
    return Unit("rad/s", f"up to {largest:.3g}", doubt)


def turned(quaternion: FloatArray, rates: FloatArray, seconds: FloatArray) -> float | None:
    """What a gyro reads for a rad/s that a quaternion (n, 4) turns; None where it does not turn."""
    q = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
    q[1:] *= np.where(np.cumprod(np.where((q[1:] * q[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)) < 0, -1.0, 1.0)[:, None]
    step = _stride(seconds)
    turn = 2.0 * np.linalg.norm(q[step:] - q[:-step], axis=1) / (seconds[step:] - seconds[:-step])
    read = np.linalg.norm(rates, axis=1)
    mean = np.array([read[k : k + step].mean() for k in range(len(turn))])
    good = np.isfinite(turn) & np.isfinite(mean) & (turn > 0.05)
    if good.sum() < 20:
        return None
    return float((mean[good] * turn[good]).sum() / (turn[good] ** 2).sum())


def vertical_of(quaternion: FloatArray) -> str:
    """The recorder's axis, y or z, that a body on a table turns about, by its quaternions (n, 4), w first."""
    q = quaternion[np.isfinite(quaternion).all(axis=1)]
    w, v = q[:, 0], q[:, 1:]
    turned = w[:, None] * -v[:1] + w[0] * v - np.cross(v, v[:1]) if len(q) else np.zeros((0, 3))  # of q times q[0]'
    return "y" if (turned[:, 1] ** 2).sum() > (turned[:, 2] ** 2).sum() else "z"


def slope(angles: FloatArray, rates: FloatArray, seconds: FloatArray) -> float | None:
    """Derivative of angles (n, k) over their rates, by least squares; None where nothing moves, or they differ."""
    step = _stride(seconds)
    lasted = seconds[step:] - seconds[:-step]
    moved = (angles[step:] - angles[:-step]) / lasted[:, None]
    sums = np.cumsum(np.vstack([np.zeros(rates.shape[1]), np.nan_to_num(0.5 * (rates[1:] + rates[:-1]))]), axis=0)
    mean = (sums[step:] - sums[:-step]) / step
    good = np.isfinite(moved) & np.isfinite(mean)
    a, b = moved[good], mean[good]
    if len(a) < 20 or not (a @ a > 0.0 and b @ b > 0.0) or (a @ b) ** 2 < 0.8 * (a @ a) * (b @ b):
        return None
    return float(a @ b / (b @ b))


def _stride(seconds: FloatArray) -> int:
    """Rows between which things move by more than they are rounded to: 50 ms, or one row."""
    return max(1, round(0.05 / max(float(np.nanmedian(np.diff(seconds))), 1e-9))) if len(seconds) > 200 else 1


def turn_of(values: FloatArray) -> float:
    """After how much an angle (n,) starts again: 360, two pi, a power of two of whole counts; 0 where it does not."""
    good = values[np.isfinite(values)]
    steps = np.abs(np.diff(good))
    largest, span = float(steps.max(initial=0.0)), float(np.ptp(good)) if len(good) else 0.0
    turns = [360.0, _TURN]
    if largest > _FEWEST_COUNTS and bool((good == np.rint(good)).all()):
        turns.append(float(2.0 ** np.ceil(np.log2(largest))))
    for turn in turns:
        again = steps > 0.5 * turn
        if again.any() and span <= turn and (steps[again] > (1.0 - _OF_A_TURN) * turn).all():
            return 0.0 if (steps[~again] > _OF_A_TURN * turn).any() else turn
    return 0.0


def going_on(angles: FloatArray) -> FloatArray:
    """Angles (n, k) without the steps of a turn with which they start again."""
    each = [(one, turn_of(one)) for one in angles.T]
    return np.column_stack([unwrapped(one, turn) if turn else one for one, turn in each])


def of_angles(values: FloatArray, named: str) -> Unit:
    """Of joints (n, k)."""
    if named in ("rad", "deg", "rev"):
        return Unit(named, "by its name")
    if values.size and bool((values == np.rint(values)).all()) and float(np.ptp(values)) > _FEWEST_COUNTS:
        counts = float(2.0 ** max(_FEWEST_BITS, np.ceil(np.log2(float(np.abs(values).max())))))
        doubt = f"whole counts: {counts:g} in a turn by their size; what the count is at angle zero is zero_count"
        return Unit("rev", "by default", doubt, counts)
    largest = float(np.nanmax(np.abs(values), initial=0.0))
    told = f"up to {largest:.4g}"
    if largest > 3.0 * _TURN:
        return Unit("deg", f"{told}; in rad only of a motor's shaft")
    if largest > 1.05 * _TURN:
        return Unit("deg", told, f"{told}, more than a turn in rad: rad if joints do that")
    return Unit("rad", f"up to {largest:.3g}")


def of_rates(values: FloatArray, named: str, angles: Unit | None) -> Unit:
    """Of joints (n, k), whose angles are in a unit."""
    named = {"rad": "rad/s", "deg": "deg/s"}.get(named, named)
    if named in ("rad/s", "deg/s", "rev/min"):
        return Unit(named, "by its name")
    unit = "deg/s" if angles is not None and angles.name == "deg" else "rad/s"
    largest = float(np.nanmax(np.abs(values), initial=0.0))
    odd = unit == "rad/s" and largest > _FASTEST_rad_s
    return Unit("deg/s" if odd else unit, f"up to {largest:.3g}", f"up to {largest:.3g} and no name" if odd else "")


def agreed(ratio: float, angle: str, rate: str, time: str, fixed: Sequence[str]) -> tuple[str, str, str] | None:
    """Units of angle, rate and time by which the derivative of an angle is its rate; the nearest to those given.

    Args:
        ratio: of the derivative of the numbers of the angle to those of the rate, time as given.
        angle: unit, as taken.
        rate: likewise.
        time: likewise.
        fixed: which of these are named, and do not change.
    """
    best, changes = None, 4
    for a in {angle} if angle in fixed else ("rad", "deg"):
        for r in {rate} if rate in fixed else ("rad/s", "deg/s"):
            for t in {time} if time in fixed else NS_PER:
                own = ratio * _of(a) / _of(r.removesuffix("/s")) * NS_PER[time] / NS_PER[t]
                count = (a != angle) + (r != rate) + (t != time)
                if abs(own - 1.0) < _SAME and count < changes:
                    best, changes = (a, r, t), count
    return best


def _of(unit: str) -> float:
    return {"deg": 1.0 / DEG, "rev": _TURN}.get(unit, 1.0)


def of_others(kind: str, values: FloatArray, named: str, known: tuple[str, ...], usual: str) -> Unit:
    """Of what is known by its name, or is in its usual unit."""
    if named in known:
        return Unit(named, "by its name")
    largest = float(np.nanmax(np.abs(values), initial=0.0))
    if kind == "position" and float(np.nanquantile(np.abs(values), _NEARLY_ALL)) > 20.0:
        return Unit("mm", f"up to {largest:.4g}", f"up to {largest:.4g}: m if it went so far")
    if kind == "current" and float(np.nanmedian(np.abs(values))) > 100.0:
        return Unit("mA", f"up to {largest:.4g}", f"up to {largest:.4g}: A would be much for an arm")
    return Unit(usual, "as is usual", "")


def count_of(values: FloatArray) -> float:
    """A size of counts that loses nothing: the decimals that are written, and a millionth of the rms or less."""
    good = values[np.isfinite(values)]
    some = good[:: max(1, len(good) // 20_000)]
    common = float(np.quantile(np.abs(some), _NEARLY_ALL)) if len(some) else 0.0
    some = np.clip(some, -common, common) if common > 0.0 else some
    most = float(np.abs(some).max(initial=0.0))
    size = most * float(np.sqrt(np.mean((some / most) ** 2))) if most else 0.0
    if not size > 0.0:
        return 1e-6
    fine = 6 - int(np.floor(np.log10(size)))
    for places in range(fine, 13):
        scaled = some * 10.0**places
        if np.abs(scaled - np.rint(scaled)).max() < 1e-3 and np.abs(scaled).max() < _EXACT:
            return float(f"1e{-places}")
    return float(f"1e{-fine - 2}")
