"""How a body moved before it was captured, from the momentum that it brought.

The fit of the flight tells how the base would have moved on without a capture. Between a tick before the first touch
and one after the grip has closed nothing acts from outside, so what vehicle and payload have together as one, less what
the vehicle alone would have then, is the payload's momentum. Its own inertia makes velocity and rate of that; a light
payload brings little momentum, and what it does not tell, the covariance does. The base's rate is that of the gyro, its
velocity the integral of the accelerometer, whose zero is estimated anew from the half second before.

How long the contact lasts is not known: a grip of 4 Hz needs half a second from the touch, and until it has closed the
payload moves against it. The shortest time from a quarter of a second on is taken that tells the same as all longer
ones; where the longest has no shorter one that agrees, its noise is taken for as much larger as they differ.
"""

from collections.abc import Callable, Sequence
from itertools import accumulate
from typing import Final, NamedTuple

import numpy as np
import pinocchio as pin
from scipy.linalg import block_diag
from scipy.special import chdtri

from onboard.dynamics.mechanics.floating_arm import FloatingArm
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.inertia import symmetric
from onboard.estimation.arrays import FloatArray, cross, gaps, hat
from onboard.estimation.policy import DOUBT
from onboard.identification.free_flyer.guesses import FIRST_TICKS, first_rate
from onboard.identification.free_flyer.prediction.imu_prediction import RATE, ImuPredictor
from onboard.identification.free_flyer.prediction.ticks import Ticks

ANNOUNCED_s: Final = 0.05  # largest distance of the touch from the time of an announced capture
_ZERO_s: Final = 0.5  # before the first touch, from which the accelerometer's zero is estimated
_EARLY_s: Final = 0.03  # before the first time at which the payload may have been touched
_CONTACTS_s: Final = (0.25, 0.35, 0.5)  # after the last one, until the grip has closed
_BESIDE: Final = 12  # ticks on each side that tell the rate there
_RELATIVE: Final = 0.015  # of a push, or of a change of the rate: scale and misalignment of the IMU, delays, links
_STEP: Final = 1e-4  # of a derivative, relative
_UNEXPLAINED: Final = "the motion about the capture cannot be predicted"
_ACTUAL, _FREE = 0, 1  # paths of the base: by the readings, and as it would be without a capture


def margins_s(period_s: float) -> tuple[float, float]:
    """How long before the first time of a touch, and after the last, ticks of a period are needed."""
    beside_s = (_BESIDE + 3) * period_s
    return _ZERO_s + _EARLY_s + beside_s, _CONTACTS_s[-1] + beside_s


class NoBodyError(SignalError):
    """An estimate of a payload is of no body; one that is made later may be."""


class Zeros(NamedTuple):
    """Of the base's IMU at the capture."""

    values: FloatArray  # (6,) gyro, accelerometer; its axes
    covariance: FloatArray  # (6, 6)


class Payload(NamedTuple):
    """Standard parameters of what was caught, as identified."""

    chi: FloatArray  # (10,)
    covariance: FloatArray  # (10, 10)


class BeforeCapture(NamedTuple):
    """Velocity of its centre of mass against the gripper at the touch, and its rate in space; the gripper's axes."""

    velocity_m_s: FloatArray  # (3,)
    rate_rad_s: FloatArray  # (3,)
    covariance: FloatArray  # (6, 6) in this order

    @property
    def sigma(self) -> FloatArray:
        """(6,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)), np.float64)


def before_capture(
    predictor: ImuPredictor,
    state: FloatArray,
    ticks: Ticks,
    zeros: Zeros,
    payload: Payload,
    touched_s: tuple[float, float],
) -> BeforeCapture:
    """Motion of the payload before it was captured.

    Args:
        predictor: of the instruments, the base's IMU first.
        state: (p,) of it with nothing held; without rate and these zeros.
        ticks: about the capture.
        zeros: of the IMU then.
        payload: what is held.
        touched_s: between which times it was touched first.

    Raises:
        NoBodyError: a payload without a mass or inertia.
        SignalError: ticks or readings missing.
    """
    begin_s, end_s = touched_s[0] - _EARLY_s, touched_s[1]
    ends = np.searchsorted(ticks.time_s, [end_s + lasts_s for lasts_s in _CONTACTS_s]).tolist()
    first = int(np.searchsorted(ticks.time_s, begin_s))
    if first < _BESIDE + 1 or ends[-1] + _BESIDE + 1 >= len(ticks.time_s):
        raise SignalError(f"ticks are missing within {_BESIDE * predictor.period_s:g} s of the capture")
    seen = ticks.part(slice(first - _BESIDE - 1, ends[-1] + _BESIDE + 2))
    if (
        gaps(seen.time_s, predictor.period_s).any()
        or not np.isfinite(np.column_stack([seen.measured[:, :6], seen.q, seen.dq])).all()
    ):
        raise SignalError("readings are missing about the capture")
    if not np.linalg.eigvalsh(_spatial(payload.chi)).min() > 0.0:
        raise NoBodyError("the estimated payload has no mass or inertia that a body can have")
    rest = ticks.part(slice(max(0, first - round(_ZERO_s / predictor.period_s)), first))
    try:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            zeros = _told_again(zeros, predictor, state, rest)
            about = _About(predictor, state, seen, zeros, payload, touched_s)
            found = _shortest(about, [_BESIDE + end - first for end in ends])
    except np.linalg.LinAlgError as error:
        raise SignalError(_UNEXPLAINED) from error
    if not (np.isfinite(found.covariance).all() and found.sigma.all()):
        raise SignalError(_UNEXPLAINED)
    return found


def _shortest(about: "_About", ends: Sequence[int]) -> BeforeCapture:
    """By the shortest time that tells the same as all longer ones, which end at these ticks."""
    found: list[_Told] = []
    wider = 1.0
    for end in reversed(ends):
        one = about.until(end)
        away = max((_away(one, longer) for longer in found), default=0.0)
        if away > chdtri(6, DOUBT):
            wider = max(1.0, away / 6.0) if len(found) == 1 else 1.0
            break
        found.append(one)
    best = found[-1]
    return BeforeCapture(best.motion[:3], best.motion[3:], wider * best.noise + best.common)


class _Told(NamedTuple):
    motion: FloatArray  # (6,)
    noise: FloatArray  # (6, 6) covariance by the readings
    common: FloatArray  # by what is the same for every time


class _Path(NamedTuple):
    """Motion of the base, axes and origin of the base at the first tick, which is taken for at rest there."""

    R: FloatArray  # (n, 3, 3)
    velocity_m_s: FloatArray  # (n, 3) of the IMU
    way_m: FloatArray  # (n, 3) of the IMU


def _told_again(zeros: Zeros, predictor: ImuPredictor, state: FloatArray, ticks: Ticks) -> Zeros:
    """Zeros with the accelerometer's by what ticks before the touch read more than they should."""
    finite = np.isfinite(ticks.measured[:, :6]).all(axis=1)
    if len(ticks.time_s) < 2 * _BESIDE or not (finite.all() and np.isfinite([ticks.q, ticks.dq, ticks.ddq]).all()):
        return zeros
    readings, forces = _expected(predictor, state, ticks, zeros)
    left, sigma = (readings - forces)[:, 3:], ticks.sigma[:, 3:6].mean(axis=0)
    own = sigma**2 / len(left) + _RELATIVE**2 * (forces[:, 3:] ** 2).sum(axis=1).mean()
    before = zeros.covariance[3:, 3:]
    gain = np.linalg.solve(before + np.diag(own), before).T
    values, covariance = zeros.values.copy(), zeros.covariance.copy()
    values[3:] += gain @ left.mean(axis=0)
    covariance[3:, 3:] -= gain @ before
    return Zeros(values, covariance)


def _expected(predictor: ImuPredictor, state: FloatArray, ticks: Ticks, zeros: Zeros) -> tuple[FloatArray, FloatArray]:
    """Readings of the base's IMU less its zeros, and as they would be with nothing caught, (n - 2, 6) each."""
    state, ticks = state.copy(), ticks._replace(measured=ticks.measured.copy())
    ticks.measured[:, :6] -= zeros.values
    state[RATE] = first_rate(predictor, ticks, state)
    predicted = predictor.predict(ticks.q, ticks.dq, ticks.ddq, state, ticks.cyclic, ticks.thrust)
    return ticks.measured[1:-1, :6], predicted.values[:, :6]


def _away(short: _Told, long: _Told) -> float:
    """Chi-squared of what two times tell, at most 6 expected: the readings of the shorter are part of the longer's."""
    away = short.motion - long.motion
    return float(away @ np.linalg.solve(long.noise, away))


class _About:
    """Readings about a capture, and what they would be without one; of ticks that all have both neighbours."""

    def __init__(
        self,
        predictor: ImuPredictor,
        state: FloatArray,
        ticks: Ticks,
        zeros: Zeros,
        payload: Payload,
        touched_s: tuple[float, float],
    ) -> None:
        vehicle, self._period_s, self._zeros, self._payload = predictor.vehicle, predictor.period_s, zeros, payload
        self._ticks = ticks.part(slice(1, -1))
        self._sigma = np.asarray(ticks.sigma[:, :6].mean(axis=0), np.float64)
        self._shown = _expected(predictor, state, ticks, zeros)
        self._R_BS, self._p_BS = vehicle.pose_in_base(predictor.imu_frames[0])
        self._paths = tuple(self._travelled(readings) for readings in self._shown)
        self._servicer = FloatingArm(vehicle, str(vehicle.spec.payload_link), predictor.chi(state))
        at = np.searchsorted(self._ticks.time_s, (touched_s[0] - _EARLY_s, touched_s[1]))
        self._touched_ticks = int(at[0]), int(at[1]) + 1
        turn = self._R_BS
        joints = np.eye(len(vehicle.joints))
        self._by_errors = block_diag(np.block([[hat(self._p_BS) @ turn, turn], [turn, np.zeros((3, 3))]]), joints)

    def until(self, last: int) -> _Told:
        """The payload's motion by the momentum in the ticks from one on."""
        n, zeros, ticks = last - _BESIDE, self._zeros, slice(last, last + _BESIDE)
        push = self._period_s * np.abs((self._shown[0] - self._shown[1])[_BESIDE:last, 3:]).sum(axis=0)
        gained = (shown[last, :3] - shown[_BESIDE, :3] for shown in self._shown)
        rate = (1.0 / _BESIDE + 1.0 / FIRST_TICKS) * self._sigma[:3] ** 2
        rate = rate + _RELATIVE**2 * sum(float(one @ one) for one in gained)
        velocity = self._period_s**2 * n * self._sigma[3:] ** 2 + (_RELATIVE * np.linalg.norm(push)) ** 2
        drift = (n * self._period_s) ** 2 * zeros.covariance[3:, 3:]
        joints = (self._ticks.joint_sigma[ticks, 0] ** 2).mean(axis=0) / _BESIDE
        brought, by_motion, by_payload = self._brought(ticks)
        chi, covariance, at = self._payload.chi, self._payload.covariance, sum(self._touched_ticks) // 2
        motion = self._of(brought, chi, at)
        of_brought = _slopes(lambda x: self._of(x, chi, at), brought)
        of_payload = of_brought @ by_payload + _slopes(lambda x: self._of(brought, x, at), chi)
        of_rate, of_velocity, of_joints = np.split(of_brought @ by_motion, [3, 6], axis=1)
        noise = (of_rate * rate) @ of_rate.T + (of_joints * joints) @ of_joints.T
        noise = noise + of_velocity @ (np.diag(velocity) + drift) @ of_velocity.T
        touched = [self._of(brought, chi, tick) for tick in range(*self._touched_ticks)]
        common = of_payload @ covariance @ of_payload.T + np.cov(np.transpose(touched), bias=True)
        return _Told(motion, noise, common)

    def _brought(self, ticks: slice) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The payload's momentum before it was touched, about the origin of the first tick, (6,), and its slopes.

        These are by errors of rate, velocity, IMU axes, and joint rates, (6, 6 + j), and by its parameters, (6, 10).
        """
        brought, by_motion, by_payload = np.zeros(6), np.zeros((6, len(self._by_errors))), np.zeros((6, 10))
        for at in range(ticks.start, ticks.stop):
            q = self._ticks.q[at]
            M, (R_BT, p_BT), twist = self._servicer.mass_matrix(q)[:6], self._tip(at), self._twist(_ACTUAL, at)
            J = np.concatenate([R_BT.T @ half for half in np.split(self._servicer.tip_jacobian(q), 2)])
            X, carried = self._to_first(_ACTUAL, at), _moved(R_BT, p_BT)
            G = X @ (M + carried @ _spatial(self._payload.chi) @ J)
            brought += (G @ twist - self._to_first(_FREE, at) @ (M @ self._twist(_FREE, at))) / _BESIDE
            by_motion += G @ self._by_errors / _BESIDE
            by_payload += X @ carried @ np.stack([one @ (J @ twist) for one in _UNIT_BODIES], axis=1) / _BESIDE
        return brought, by_motion, by_payload

    def _of(self, brought: FloatArray, chi: FloatArray, at: int) -> FloatArray:
        """Motion, (6,), of a payload with a momentum, if it was touched at a tick."""
        linear, c = brought[:3], chi[1:4] / chi[0]
        R, origin = self._base(_FREE, at)
        R_BT, p_BT = self._tip(at)
        R_T, centre = R @ R_BT, origin + R @ (p_BT + R_BT @ c)
        inertia = _spatial(chi)[3:, 3:] + chi[0] * hat(c) @ hat(c)
        spin = np.linalg.solve(inertia, R_T.T @ (brought[3:] - cross(centre, linear)))
        return np.concatenate([R_T.T @ (linear / chi[0] - self._gripper(at, c)), spin])

    def _base(self, path: int, at: int) -> tuple[FloatArray, FloatArray]:
        """Its axes and origin at a tick."""
        R = self._paths[path].R[at]
        return R, self._p_BS + self._paths[path].way_m[at] - R @ self._p_BS

    def _to_first(self, path: int, at: int) -> FloatArray:
        """Of a momentum in the base's axes about its origin to those of the first tick, (6, 6)."""
        return _moved(*self._base(path, at))

    def _tip(self, at: int) -> tuple[FloatArray, FloatArray]:
        return self._servicer.tip_pose(self._ticks.q[at])

    def _twist(self, path: int, at: int) -> FloatArray:
        """Of base and joints at a tick, base axes, (6 + j,)."""
        w = self._R_BS @ self._shown[path][at, :3]
        velocity = self._paths[path].R[at].T @ self._paths[path].velocity_m_s[at]
        return np.concatenate([velocity - cross(w, self._p_BS), w, self._ticks.dq[at]])

    def _gripper(self, at: int, c: FloatArray) -> FloatArray:
        """Velocity of a place of the gripper at a tick, nothing held, (3,)."""
        q, R = self._ticks.q[at], self._paths[_FREE].R[at]
        tip, (R_BT, _) = self._servicer.tip_jacobian(q) @ self._twist(_FREE, at), self._tip(at)
        return np.asarray(R @ (tip[:3] + cross(tip[3:], R_BT @ c)), np.float64)

    def _travelled(self, readings: FloatArray) -> _Path:
        """Way of the base by the readings of its IMU."""
        rate, force = readings[:, :3] @ self._R_BS.T, readings[:, 3:] @ self._R_BS.T
        turns = [pin.exp3(turn) for turn in 0.5 * self._period_s * (rate[1:] + rate[:-1])]
        R = np.array(list(accumulate(turns, np.matmul, initial=np.eye(3))))
        R = R[_BESIDE].T @ R
        velocity = self._summed(np.einsum("kij,kj->ki", R, force))
        return _Path(R, velocity, self._summed(velocity))

    def _summed(self, values: FloatArray) -> FloatArray:
        steps = 0.5 * self._period_s * (values[1:] + values[:-1])
        sums = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
        return np.asarray(sums - sums[_BESIDE], np.float64)


def _slopes(of: Callable[[FloatArray], FloatArray], at: FloatArray) -> FloatArray:
    """Derivative of a function of n numbers, (m, n)."""
    steps, centre = _STEP * np.maximum(np.abs(at), _STEP), of(at)
    return np.stack([(of(at + one) - centre) / one.sum() for one in np.diag(steps)], axis=1)


def _moved(R: FloatArray, p: FloatArray) -> FloatArray:
    """A momentum, linear first, in the axes of a body about its origin, in those that see it so, (6, 6)."""
    out = np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = R
    out[3:, :3] = hat(p) @ R
    return out


def _spatial(chi: FloatArray) -> FloatArray:
    """Spatial inertia about the frame's origin, linear first, (6, 6)."""
    out, moment = np.zeros((6, 6)), hat(chi[1:4])
    out[:3, :3], out[:3, 3:], out[3:, :3] = chi[0] * np.eye(3), -moment, moment
    out[3:, 3:] = symmetric(chi[4:])
    return out


_UNIT_BODIES: Final = tuple(_spatial(unit) for unit in np.eye(10))
