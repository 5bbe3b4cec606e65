"""What columns of a free-flyer's recording may be taken for: axes and units of its IMU, signs and places of its joints.

Each way to read it competes with the file as stated by what the wrench on the whole vehicle leaves, which is zero in
free flight and linear in the payload (:mod:`onboard.regressor.free_rows`): the share of what the known links alone make
of it that no payload explains. A payload has no negative mass; where the least squares make it one, there is none.
Of pairs, those compete in which a joint or a unit takes part: two axes of the IMU are mostly those of all of it.
"""

import re
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from onboard.dynamics.kinematics import Bodies, Frames, LinkMotion, chain_motion, motions_of, wrench_columns
from onboard.dynamics.model.vehicle import STANDARD_GRAVITY_M_S2, VehicleModel
from onboard.dynamics.ticks import FlightSignals
from onboard.estimation.arrays import FloatArray
from onboard.estimation.maximum_likelihood import ROUNDS
from onboard.estimation.policy import MISFIT_REFUSED, MOSTLY
from onboard.identification.free_flyer.guesses import ROUGH_WIDTH_s, WIDEST_s
from onboard.identification.free_flyer.prediction.imu_prediction import ImuPredictor
from onboard.identification.free_flyer.prediction.ticks import Ticks
from onboard.identification.misread import AXES, JointReading, axes_text, exchanged, score, turned
from onboard.identification.rows.checks.agreement import MOST_UNEXPLAINED
from onboard.identification.rows.checks.remade import MOST_TICKS
from onboard.regressor.free_rows import BaseSignals, base_of, smoothed_imu

_UNKNOWN = 10 + 3  # of a payload and of the accelerometer's zero
_FEWEST = 2 + np.ceil(_UNKNOWN / 6)  # widths in a recording: both ends are cut off, and each tells six lines anew
_MOST_SAID = 3
_NOISE_SEED = 1
_UNITS = (  # of gyro and accelerometer, and what they are to be multiplied by
    (np.pi / 180.0, 1.0, "the gyro is in deg/s"),
    (180.0 / np.pi, 1.0, "the gyro is in rad/s, and not in deg/s"),
    (1.0, STANDARD_GRAVITY_M_S2, "the accelerometer is in g"),
    (1.0, 1e-3 * STANDARD_GRAVITY_M_S2, "the accelerometer is in mg"),
    (1.0, 1.0 / STANDARD_GRAVITY_M_S2, "the accelerometer is in m/s^2, and not in g"),
)


class FlightReading(NamedTuple):
    """A way to read a recording: as stated, or with some mistakes in the mapping made good."""

    said: tuple[str, ...]  # what is otherwise than stated
    gyro: FloatArray  # (3, 3) of the rates as stated
    accelerometer: FloatArray  # (3, 3)
    angles: JointReading
    mistakes: int = 0

    def also(self, said: str, mistakes: int = 1, **change: Any) -> "FlightReading":
        """With another mistake."""
        return self._replace(said=(*self.said, said), mistakes=self.mistakes + mistakes, **change)

    @staticmethod
    def stated(joints: int) -> "FlightReading":
        """As the file says."""
        return FlightReading((), np.eye(3), np.eye(3), JointReading.stated(joints))


class Misread(NamedTuple):
    """A way to read a recording that leaves much less of it than as stated."""

    ways: tuple[FlightReading, ...]  # the likeliest first, then others that are about as likely
    stated: float  # of the wrench that the known links make, left over by any payload as stated
    left: float  # by the likeliest of them

    @property
    def text(self) -> str:
        """Sentence without an end."""
        said = ", or if ".join(" and ".join(way.said) for way in self.ways)
        return (
            f"of what moves base and arm {self.stated:.0%} is left over by any payload, and {self.left:.0%} if {said}: "
            "correct the mapping, or the URDF"
        )


class _Weighed(NamedTuple):
    left: float
    way: FlightReading

    @property
    def score(self) -> float:
        return score(self.left, self.way.mistakes)


class _Links(NamedTuple):
    """Motion of the links, and what hangs on it alone."""

    frames: Frames
    payload: LinkMotion
    of_zero: FloatArray  # (n, 6, 3) wrench by the accelerometer's zero, where nothing is held


class _Recording:
    """Some ticks of a recording, and what each way to read it leaves of them."""

    def __init__(self, vehicle: VehicleModel, frame: str, ticks: Ticks, period_s: float, width_s: float) -> None:
        self._vehicle, self._frame = vehicle, frame
        flight = ticks.flight(period_s, 1)
        imu, noise = smoothed_imu(flight, width_s), smoothed_imu(_noise(flight), width_s)
        known = [np.isfinite(one).all(axis=1) for one in (*imu, ticks.q, ticks.dq, ticks.ddq)]
        edge = round(width_s / period_s)
        whole = np.flatnonzero(np.logical_and.reduce(known))
        whole = whole[(whole >= edge) & (whole < len(ticks.time_s) - edge)]
        some = whole[:: max(1, len(whole) // MOST_TICKS)]
        self.ticks = len(some)
        self._imu, self._noise = (BaseSignals(*(one[some] for one in of)) for of in (imu, noise))
        self._joints = ticks.q[some], ticks.dq[some], ticks.ddq[some]
        self._links: tuple[tuple[object, ...], _Links] | None = None
        self._known = vehicle.chi.copy()
        self._known[vehicle.payload_columns()] = 0.0
        self._by_noise = np.zeros(2)  # of the stated ones: forces, moments
        self._by_noise = self.by_noise(FlightReading.stated(len(vehicle.joints)))

    def left(self, way: FlightReading, rounds: int = 1) -> float:
        """What no payload explains of the wrench that the known links make, as a share of its squares; of 2.

        Args:
            way: to read it.
            rounds: of Gauss-Newton: the accelerometer's zero acts on the payload's mass, too.
        """
        links, base = self._links_of(way), self._base(self._imu, way)
        of_zero, chi, zero, left = links.of_zero, self._known.copy(), np.zeros(3), np.inf
        for at in range(rounds):
            if at:
                of_zero = _of_zero(links.frames, chi)
            moved = base._replace(specific_force=base.specific_force - zero)
            # as :func:`onboard.regressor.free_rows.zero_wrench_rows`, by the motion of the links
            Y = wrench_columns(links.payload, moved.rate, moved.specific_force, moved.acceleration)
            y = self._known_wrench(links, moved)
            size = _sizes(y, of_zero)
            if not min(size) > 0.0:
                return np.inf
            weight = np.repeat(1.0 / np.sqrt(size * (MOST_UNEXPLAINED**2 + self._by_noise)), 3)
            rows = (np.concatenate([Y, of_zero], axis=2) * weight[:, None]).reshape(-1, 13)
            aim = (y * weight).ravel()
            solution = np.linalg.lstsq(rows, aim)[0]
            if not solution[0] > 0.0:
                solution = np.concatenate([np.zeros(10), np.linalg.lstsq(rows[:, 10:], aim)[0]])
            over = ((aim - rows @ solution).reshape(-1, 6) / weight) ** 2
            left = float(over[:, :3].sum() / size[0] + over[:, 3:].sum() / size[1])
            chi[self._vehicle.payload_columns()], zero = solution[:10], zero + solution[10:]
        return left

    def explained(self, way: FlightReading) -> float:
        """What a payload may leave: what the verdict allows, and what comes of the IMU's noise."""
        return 2.0 * MOST_UNEXPLAINED**2 + MISFIT_REFUSED * float(self.by_noise(way).sum())

    def by_noise(self, way: FlightReading) -> FloatArray:
        """Share of the squares that the IMU's noise makes, of forces and of moments, (2,)."""
        links = self._links_of(way)
        imu = BaseSignals(*(one + noise for one, noise in zip(self._imu, self._noise, strict=True)))
        y, noisy = (self._known_wrench(links, self._base(one, way)) for one in (self._imu, imu))
        size = _sizes(y, -links.of_zero)
        over = (noisy - y) ** 2
        return np.array([over[:, :3].sum(), over[:, 3:].sum()]) / np.where(size > 0.0, size, np.inf)

    def _known_wrench(self, links: _Links, base: BaseSignals) -> FloatArray:
        """What moves the known links, (n, 6), the other way."""
        twist = np.hstack([np.zeros_like(base.rate), base.rate])
        thrust = np.hstack([base.specific_force, base.acceleration])
        bodies = Bodies.of(links.frames, self._known, twist, thrust)
        return -bodies.sums(np.ones((1, links.frames.p.shape[1]))).wrench[:, 0]

    def _links_of(self, way: FlightReading) -> _Links:
        key = (way.angles.order, *way.angles.factor.tolist(), *way.angles.shift_rad.tolist())
        if self._links is None or self._links[0] != key:
            frames = chain_motion(self._vehicle, *way.angles.joints(*self._joints)).links
            held = self._vehicle.payload_columns().start // 10
            [payload] = motions_of(Frames(*(part[:, held : held + 1] for part in frames)))
            self._links = key, _Links(frames, payload, _of_zero(frames, self._known))
        return self._links[1]

    def _base(self, imu: BaseSignals, way: FlightReading) -> BaseSignals:
        rate, acceleration, force = imu
        read = BaseSignals(rate @ way.gyro.T, acceleration @ way.gyro.T, force @ way.accelerometer.T)
        return base_of(self._vehicle, self._frame, read)


def _of_zero(links: Frames, chi: FloatArray) -> FloatArray:
    """Wrench on all links by the accelerometer's zero, (n, 6, 3)."""
    return -Bodies.of(links, chi).composite[:, :, :3]


def _sizes(y: FloatArray, of_zero: FloatArray) -> FloatArray:
    """Squares of forces and of moments, (2,), without what a constant zero of the accelerometer makes of them.

    Args:
        y: (n, 6).
        of_zero: by that zero, (n, 6, 3).
    """
    found = []
    for own in (slice(0, 3), slice(3, 6)):
        rows, aim = of_zero[:, own].reshape(-1, 3), y[:, own].ravel()
        found.append(float(((aim - rows @ np.linalg.lstsq(rows, aim)[0]) ** 2).sum()))
    return np.array(found)


def mistaken(predictor: ImuPredictor, ticks: Ticks, period_s: float, smoothing_s: float) -> str:
    """What :func:`misread` says of a predictor's vehicle and first IMU; empty: nothing.

    Noise hides a slow motion, and a wide kernel a fast one: two widths are tried.
    """
    for width_s in (WIDEST_s, max(ROUGH_WIDTH_s, smoothing_s)):
        found = misread(predictor.vehicle, predictor.imu_frames[0], ticks, period_s, width_s)
        if found is not None:
            return found.text
    return ""


def misread(vehicle: VehicleModel, frame: str, ticks: Ticks, period_s: float, width_s: float) -> Misread | None:
    """The likeliest mistakes of a mapping, one or two; None where none explain the motion, or it is as stated.

    Args:
        vehicle: with a payload link, which is held in all ticks.
        frame: of the IMU on its base.
        ticks: in succession, lines 0 to 5 that IMU's.
        period_s: between them.
        width_s: of the kernel that smooths the IMU.
    """
    if np.isfinite(ticks.measured[:, :6]).all(axis=1).sum() * period_s < _FEWEST * width_s:
        return None
    recording = _Recording(vehicle, frame, ticks, period_s, width_s)
    names = [joint.name for joint in vehicle.joints]
    stated = FlightReading.stated(len(names))
    if not recording.ticks or (least := recording.left(stated, ROUNDS)) <= recording.explained(stated):
        return None
    if least == np.inf:  # nothing moves, however it is read
        return None
    of_imu, of_joints = [*_of_imu(stated)], [*_of_joints(stated, names)]
    zeros = [stated.also(said, 2, angles=other) for said, other in stated.angles.from_other_zeros(names)]
    ways = sorted(
        (_Weighed(recording.left(way), way) for way in (*of_imu, *of_joints, *zeros)), key=lambda one: one.score
    )
    if ways[0].left > recording.explained(ways[0].way):
        pairs = [two for way in of_joints for two in (*_of_imu(way), *_of_joints(way, names))]
        pairs += [two for way in _of_units(stated) for two in _of_imu(way)]
        ways = sorted([*ways, *(_Weighed(recording.left(way), way) for way in pairs)], key=lambda one: one.score)
    best = ways[0]._replace(left=recording.left(ways[0].way, ROUNDS))
    by_noise, of_best = (float(recording.by_noise(way).sum()) for way in (stated, best.way))
    if of_best > MOSTLY or best.left > recording.explained(best.way):
        return None
    if score(max(best.left - of_best, 2.0 * MOST_UNEXPLAINED**2), best.way.mistakes) >= least - by_noise:
        return None
    near = [one.way for one in ways if one.score / MISFIT_REFUSED < ways[0].score]
    # of zeros beside each other, and of a pair in either order, a single one
    each = {re.sub(r"[-+]\d+", "", " ".join(sorted(way.said))): way for way in reversed(near)}
    shares = (min(1.0, float(np.sqrt(0.5 * left))) for left in (least, best.left))
    return Misread(tuple(reversed(each.values()))[:_MOST_SAID], *shares)


def _noise(flight: FlightSignals) -> FlightSignals:
    """Readings of nothing but white noise, as much as the IMU's change of change from tick to tick shows."""
    rng = np.random.default_rng(_NOISE_SEED)
    drawn = []
    for one in (flight.rate, flight.specific_force):
        size = np.sqrt(np.nanmean(np.diff(one, 2, axis=0) ** 2, axis=0) / 6.0)  # 1, -2, 1: six times the variance
        drawn.append(np.where(np.isfinite(one), size * rng.standard_normal(one.shape), np.nan))
    return flight._replace(rate=drawn[0], specific_force=drawn[1])


def _of_imu(now: FlightReading) -> Iterator[FlightReading]:
    """With one mistake more in how the IMU is read."""
    for by in AXES[1:]:
        said = axes_text(by)
        yield now.also(f"the gyro's {said}", gyro=by @ now.gyro)
        yield now.also(f"the accelerometer's {said}", accelerometer=by @ now.accelerometer)
        yield now.also(f"the IMU's {said}", gyro=by @ now.gyro, accelerometer=by @ now.accelerometer)
    yield from _of_units(now)


def _of_units(now: FlightReading) -> Iterator[FlightReading]:
    """With one mistake more in the units of the IMU."""
    for rate, force, said in _UNITS:
        yield now.also(said, gyro=rate * now.gyro, accelerometer=force * now.accelerometer)


def _of_joints(now: FlightReading, names: Sequence[str]) -> Iterator[FlightReading]:
    """With one mistake more in how the joints are read."""
    angles = now.angles
    for name, factor in zip(names, turned(len(names)), strict=True):
        yield now.also(f"{name} counts the other way", angles=angles._replace(factor=angles.factor * factor))
    for pair, order in exchanged(angles.order, names):
        yield now.also(f"{pair} are exchanged", angles=angles._replace(order=order))
    yield from (now.also(said, angles=other) for said, other in angles.in_other_units())
