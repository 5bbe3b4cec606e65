"""Effect of the noise of the measured motion on the rows, by finite differences (derived here)."""

import numpy as np
from numpy.typing import NDArray

from onboard.estimation.arrays import BoolArray, FloatArray, hat
from onboard.regressor.rows import BaseMotion, RowFold, RowModel
from onboard.regressor.signals import SignalNoise, Signals

_NOISE_TICKS = 8


class RowNoise:
    """Finite differences of a model's rows over one standard deviation of each signal.

    Args:
        model: the rows.
        fold: the base parameters' columns, and last what is known.
        imu_frame: frame in which the noise of the base's motion is given.

    Raises:
        UnknownFrameError: the base does not have that frame.
    """

    def __init__(self, model: RowModel, fold: RowFold, imu_frame: str) -> None:
        self._model, self._fold = model, fold
        self._imu_pose = model.vehicle.pose_in_base(imu_frame)

    def of_joints_and_force(self, noise: SignalNoise, at: NDArray[np.intp]) -> FloatArray:
        """Standard deviations of angles, rates, accelerations, and of the specific force in axes of the base.

        Args:
            noise: of the motion.
            at: ticks wanted, (t,).

        Returns:
            (t, 3 joints + 3); zero where it is not known.
        """
        force = np.sqrt(noise.specific_force[at] ** 2 @ (self._imu_pose[0] ** 2).T)
        return np.asarray(np.nan_to_num(np.hstack([noise.q[at], noise.dq[at], noise.ddq[at], force])), np.float64)

    def changes(
        self, signals: Signals, noise: SignalNoise, at: NDArray[np.intp], attached: BoolArray
    ) -> tuple[FloatArray, NDArray[np.intp]]:
        """Change of the rows and of their left-hand sides per standard deviation of each motion signal.

        Signals change little over a few ticks, so the differences are computed for one tick of each small group.

        Args:
            signals: smoothed.
            noise: of their motion.
            at: ticks wanted, (t,).
            attached: whether the payload is held, at every tick of ``signals``.

        Returns:
            ``(changes, group)``: (groups, rows, s, p + 1), and the group of each tick, (t,).
        """
        ticks: list[np.intp] = []
        group = np.empty(at.size, np.intp)
        for held in (True, False):
            kind = np.flatnonzero(attached[at] == held)
            for first in range(0, kind.size, _NOISE_TICKS):
                mine = kind[first : first + _NOISE_TICKS]
                group[mine] = len(ticks)
                ticks.append(at[mine[mine.size // 2]])
        return self._at(signals, noise, np.array(ticks), attached), group

    def _at(self, signals: Signals, noise: SignalNoise, at: NDArray[np.intp], attached: BoolArray) -> FloatArray:
        """The same at each of some ticks, (t, rows, s, p + 1), by finite differences one standard deviation wide."""
        R_BS, p_BS = self._imu_pose
        nj, n = len(self._model.vehicle.joints), len(at)
        s = 3 * nj + 9
        joints = np.stack([signals.q[at], signals.dq[at], signals.ddq[at]], axis=1)  # (t, 3, nj)
        moved = np.repeat(joints[:, None], s + 1, axis=1)  # (t, s + 1, 3, nj); the last one stays as it is
        spread, source = np.stack([noise.q[at], noise.dq[at], noise.ddq[at]], axis=1), np.arange(3 * nj)
        moved.reshape(n, s + 1, 3 * nj)[:, source, source] += spread.reshape(n, 3 * nj)
        w, dw, f = (np.repeat(v[at][:, None], s + 1, axis=1) for v in signals.motion)  # (t, s + 1, 3) each
        rate, acceleration, force = (slice(3 * nj + 3 * k, 3 * nj + 3 * k + 3) for k in range(3))
        dw_noise, w_noise, f_noise = (  # row k: axis k of the IMU
            (R_BS * of[at][:, None]).swapaxes(1, 2) for of in (noise.acceleration, noise.rate, noise.specific_force)
        )
        # Errors of rate and angular acceleration also enter the lever-arm part of f.
        arm, turning = hat(p_BS), hat(w[:, -1])
        f[:, rate] -= w_noise @ hat(turning @ p_BS) - w_noise @ arm @ turning
        f[:, acceleration] -= dw_noise @ arm
        f[:, force] += f_noise
        w[:, rate] += w_noise
        dw[:, acceleration] += dw_noise
        every = n * (s + 1)
        motion = BaseMotion(*(v.reshape(every, 3) for v in (w, dw, f)))
        q, dq, ddq = (moved[:, :, k].reshape(every, nj) for k in range(3))
        z = None if signals.friction is None else np.repeat(signals.friction[at], s + 1, axis=0)
        held = np.repeat(attached[at], s + 1)
        Y = self._model.regressor(q, dq, ddq, motion, held, False, self._fold, z)
        Y = Y.reshape(n, s + 1, *Y.shape[1:])
        change = (Y[:, :-1] - Y[:, -1:]).transpose(0, 2, 1, 3)
        change[..., -1] *= -1.0  # the known part moves to the other side
        return np.ascontiguousarray(change)
