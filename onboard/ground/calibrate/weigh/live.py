"""Poses from a wrist sensor while it is read: a pose is taken when the wrist has turned and rests.

At rest the means of four quarters of a window agree, of each cell and of what tells the orientation. Rows are put in
windows by when they came; what was recorded is all in the log.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from drivers.records import IMU, Rows
from onboard.devices import si
from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.calibration import wrist
from onboard.estimation.errors import CalibrationError
from onboard.estimation.policy import DOUBT, sigmas
from onboard.ground.calibrate.place import Gravity
from onboard.ground.calibrate.weigh.changed import PART
from onboard.ground.calibrate.weigh.columns import ONE_G, Meaning
from onboard.ground.calibrate.weigh.conventions import Known, Said
from onboard.ground.calibrate.weigh.errors import PosesError
from onboard.ground.calibrate.weigh.further import further
from onboard.ground.calibrate.weigh.weigh import Answer, weigh
from onboard.ground.calibrate.weigh.wrist_sensor import WristSensor

REST_s = 2.0
MOST = 60  # poses
_QUARTERS, _ROWS = 4, 8
_SILENT_s, _RESTLESS_s = 3.0, 15.0
_STILL_rad = np.deg2rad(0.1)  # of a joint, of gravity: 0.2 % of the weight across
_TURNED_rad = np.deg2rad(5.0)


@dataclass
class _Window:
    """The last readings of a channel, SI."""

    time_s: FloatArray
    values: FloatArray  # (n, k)
    usable: BoolArray
    last_s: float = -np.inf

    def quarters(self, since_s: float) -> FloatArray | None:
        """Means of quarters, (4, k); None where there are too few readings yet."""
        if len(self.values) < _ROWS or self.time_s[0] > since_s:
            return None
        kept = self.values[self.time_s >= since_s]
        return None if len(kept) < _ROWS else np.array([p.mean(axis=0) for p in np.array_split(kept, _QUARTERS)])


@dataclass
class Session:
    """Takes poses.

    Args:
        sensor: that is read.
        place: gravity.
        down: gravity's direction in base axes, where joints tell the orientation.
        scale: 1 sigma of an axis, relative.
        tilt_rad: 1 sigma of the base's tilt.
        until: half of the mass' interval over the mass, at which it is done.
        said: conventions that a person gave.
        tell: is given what happens, a sentence at a time.
    """

    sensor: WristSensor
    place: Gravity
    down: tuple[float, float, float]
    scale: float
    tilt_rad: float
    until: float
    said: Said
    tell: Callable[[str], None]
    answer: Answer | None = None
    done: str = ""  # why it ended
    R: list[FloatArray] = field(default_factory=list)
    wrench: list[FloatArray] = field(default_factory=list)
    _windows: dict[str, _Window] = field(default_factory=dict)
    _begun_s: float = np.nan
    _looked_s: float = -np.inf
    _since_s: float = np.nan  # when it last moved, took a pose or said why it does not
    _urgent: str = ""  # channel that was reported at once

    @property
    def channels(self) -> tuple[str, ...]:
        """That it reads."""
        return self.sensor.channels

    def feed(self, channel: str, rows: Rows) -> None:
        """Add rows of a channel, any number of them.

        Raises:
            CalibrationError: rows in a unit that the channel does not have.
        """
        if not len(rows):
            return
        signal = self.sensor.signals[channel]
        if rows.dtype == IMU:
            values = si.imu(rows, signal)[:, 3:]
        else:
            plain = signal._replace(corrections=())  # zeros are what is looked for
            factor = si.factors(rows, plain)
            if np.isnan(factor).any():
                unit, known = rows["unit"][0].decode("ascii", "replace"), ", ".join(u.decode() for u in signal.si)
                raise CalibrationError(f"readings of {channel} are in {unit!r}, which is none of {known}")
            values = (si.scalar(rows, plain) * factor)[:, None]
        time_s = rows["host_ns"] * 1e-9
        usable = si.usable(rows) & np.isfinite(values).all(axis=1) & (np.abs(values) < signal.limit).all(axis=1)
        own = self._windows.get(channel)
        if own is not None:
            kept = own.time_s >= time_s[-1] - 2.0 * self._rest_s
            time_s = np.concatenate([own.time_s[kept], time_s])
            values = np.concatenate([own.values[kept], values])
            usable = np.concatenate([own.usable[kept], usable])
        self._windows[channel] = _Window(time_s, values, usable, float(time_s[-1]))

    def step(self, now_s: float) -> None:
        """Look whether the wrist rests in a new pose; take it.

        Raises:
            CalibrationError: a channel is silent.
        """
        if np.isnan(self._begun_s):
            self._begun_s = self._since_s = now_s
            self.tell(f"orientation by {self.sensor.told_by}; hold the wrist still in the first pose")
        for channel in self.sensor.channels:
            own = self._windows.get(channel)
            if now_s - max(self._begun_s, -np.inf if own is None else own.last_s) > max(_SILENT_s, self._rest_s):
                raise CalibrationError(f"nothing came from {channel} for {_SILENT_s:g} s; check its power and its bus")
        if now_s - self._looked_s < 0.1 * self._rest_s:
            return
        self._looked_s = now_s
        why, at_once = self._taken(now_s)
        if not why:
            self._since_s, self._urgent = now_s, ""
        elif (at_once and at_once != self._urgent) or now_s - self._since_s > _RESTLESS_s:
            self._since_s = now_s
            self._urgent = at_once or self._urgent
            self.tell(why)

    @property
    def _rest_s(self) -> float:
        return max(REST_s, 2.0 * _ROWS * max(self.sensor.signals[name].period_s for name in self.sensor.channels))

    def _taken(self, now_s: float) -> tuple[str, str]:
        """Take a pose; why not, where it should, and the channel of which that is reported at once."""
        means: dict[str, FloatArray] = {}
        last_s = min((own.last_s for own in self._windows.values()), default=now_s)
        first_s = last_s - self._rest_s
        turning = (*self.sensor.joints, *filter(None, [self.sensor.imu]))
        for channel in (*turning, *(cell.channel for cell in self.sensor.cells)):
            own = self._windows.get(channel)
            parts = None if own is None else own.quarters(first_s)
            if own is None or parts is None:
                return f"waiting for readings of {channel}", ""
            moves = self._moves(channel, parts)
            if moves and channel in self.sensor.joints:
                return "", ""  # the wrist is on its way
            if not own.usable[own.time_s >= first_s].all():
                return f"{channel} is overloaded or says that its reading is not valid: no pose", channel
            if moves:
                return moves, ""
            means[channel] = parts.mean(axis=0)
        if self.sensor.imu:
            turned = means[self.sensor.imu]
        else:
            turned = np.array([means[channel][0] for channel in self.sensor.joints])
        R = self.sensor.rotation(turned)
        if self.R and self._angle(R, self.R[-1]) < _TURNED_rad:
            return f"the wrist rests where it was: turn it, by {np.rad2deg(_TURNED_rad):.0f} deg or more", ""
        self.R.append(R)
        self.wrench.append(self.sensor.wrench({cell.channel: means[cell.channel][0] for cell in self.sensor.cells}))
        self._weigh()
        return "", ""

    def _moves(self, channel: str, parts: FloatArray) -> str:
        """Why a channel is not at rest; empty if it is."""
        signal = self.sensor.signals[channel]
        if channel == self.sensor.imu:
            size = np.linalg.norm(parts, axis=1)
            g = self.place.gravity_m_s2
            if np.abs(size - g).max() > ONE_G * g:
                return (
                    f"{channel} reads {size.mean():.2f} m/s^2 and not {g:.2f}: the wrist moves, or it is not calibrated"
                )
            ways = parts / size[:, None]
            noise = max(signal.noise[3:]) / g / np.sqrt(0.25 * self._rest_s / signal.period_s)
            if np.linalg.norm(ways - ways.mean(axis=0), axis=1).max() > _STILL_rad + sigmas(DOUBT) * noise:
                return f"the wrist turns, by {channel}: hold it still"
            return ""
        spread = float(np.ptp(parts, axis=0).max())
        if channel in self.sensor.joints:
            return f"{channel} turns" if spread > _STILL_rad else ""
        if spread > sigmas(DOUBT) * signal.noise[0]:
            return f"{channel} moves by {spread:.2g} N: let the tool come to rest, or correct noise_N of the cell"
        return ""

    def _angle(self, one: FloatArray, other: FloatArray) -> float:
        """Between gravity in the sensor's axes in two poses."""
        down = np.array((0.0, 0.0, -1.0) if self.sensor.imu else self.down)
        a, b = one.T @ down, other.T @ down
        return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))

    @property
    def known(self) -> Known:
        """What is known besides the poses."""
        known = Known(self.place, self.down, self.scale, self.tilt_rad, self.said)
        return known.by_up if self.sensor.imu else known

    def _weigh(self) -> None:
        n = len(self.R)
        if n < wrist.FEWEST:
            self.tell(f"pose {n} taken; turn the wrist to the next pose")
            return
        meaning = Meaning("matrix", np.array(self.R).reshape(n, 9), np.array(self.wrench), ())
        try:
            self.answer = weigh(meaning, self.known)
        except PosesError as error:
            self.tell(f"pose {n} taken: {error}")
            return
        mass = self.answer.quantities[0]
        more = further(self.answer)
        if not mass.supported:
            told = "the mass is not known yet"
        else:
            half = 0.5 * (mass.high - mass.low) / abs(mass.value)
            told = f"{mass.value:.4g} kg +- {100.0 * half:.2g} %"
            if n >= PART and half <= self.until:
                self.done = f"the mass is known to {100.0 * half:.2g} %"
            elif n >= 2 * PART and not more:
                self.done = "no further pose would tell much: the rest is how well the sensor is calibrated"
        if n >= MOST:
            self.done = self.done or f"{MOST} poses"
        after = f"done, {self.done}" if self.done else f"turn the wrist to the next pose; most tells {_next(more)}"
        self.tell(f"pose {n} taken: {told}; {after}")

    def summary(self) -> Mapping[str, object]:
        """For programs: the poses, and why it ended."""
        return {"rotations": self.R, "wrenches": self.wrench, "ended": self.done, "orientation": self.sensor.told_by}


def _next(more: tuple[object, ...]) -> str:
    return getattr(more[0], "text", "") if more else "none in particular"
