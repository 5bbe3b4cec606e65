"""Effect of the noise of the measured motion on the rows, by finite differences (derived here)."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.regressor.rows import BaseMotion, RowFold, RowModel, skew
from onboard.regressor.signals import SignalNoise, Signals

_NOISE_TICKS = 8


class RowNoise:
    """Finite differences of a model's rows over one standard deviation of each signal.

    Args:
        model: the rows.
        fold: the base parameters' columns, and last what is known.
        scales: row and column of every parameter that is a scale.
        imu_frame: frame in which the noise of the base's motion is given.

    Raises:
        UnknownFrameError: the base does not have that frame.
    """

    def __init__(self, model: RowModel, fold: RowFold, scales: Sequence[tuple[int, int]], imu_frame: str) -> None:
        self._model, self._fold, self._scales = model, fold, tuple(scales)
        self._imu_pose = model.vehicle.pose_in_base(imu_frame)

    def changes(
        self, signals: Signals, noise: SignalNoise, at: NDArray[np.intp], attached: BoolArray, mean: FloatArray | None
    ) -> tuple[FloatArray, NDArray[np.intp]]:
        """Change of the rows and of their left-hand sides per standard deviation of each motion signal.

        Signals change little over a few ticks, so the differences are computed for one tick of each small group.

        Args:
            signals: smoothed.
            noise: of their motion.
            at: ticks wanted, (t,).
            attached: whether the payload is held, at every tick of ``signals``.
            mean: parameters (p,) by which columns of scales are predicted; not needed where there are none.

        Returns:
            ``(changes, group)``: (groups, rows, s, p + 1), and the group of each tick, (t,).
        """
        changes: list[FloatArray] = []
        group = np.empty(at.size, np.intp)
        for held in (True, False):
            kind = np.flatnonzero(attached[at] == held)
            for first in range(0, kind.size, _NOISE_TICKS):
                mine = kind[first : first + _NOISE_TICKS]
                group[mine] = len(changes)
                changes.append(self._at(signals, noise, at[mine[mine.size // 2]], held, mean))
        return np.stack(changes), group

    def _at(
        self, signals: Signals, noise: SignalNoise, tick: np.intp, held: bool, mean: FloatArray | None
    ) -> FloatArray:
        """The same at one tick, (rows, s, p + 1), by finite differences one standard deviation wide."""
        R_BS, p_BS = self._imu_pose
        nj = len(self._model.vehicle.joints)
        s = 3 * nj + 9
        joints = np.stack([signals.q[tick], signals.dq[tick], signals.ddq[tick]])  # (3, nj)
        moved = np.repeat(joints[None], s + 1, axis=0)  # (s + 1, 3, nj); the last one stays as it is
        spread = np.stack([noise.q[tick], noise.dq[tick], noise.ddq[tick]])
        for source in range(3 * nj):
            moved[source].flat[source] += spread.flat[source]
        w, dw, f = (np.repeat(v[tick][None], s + 1, axis=0) for v in signals.motion)  # (s + 1, 3) each
        rate, acceleration, force = (slice(3 * nj + 3 * k, 3 * nj + 3 * k + 3) for k in range(3))
        dw_noise, w_noise = (R_BS * noise.acceleration[tick]).T, (R_BS * noise.rate[tick]).T  # row k: axis k of the IMU
        # Errors of rate and angular acceleration also enter the lever-arm part of f.
        arm, turning = skew(p_BS), skew(w[-1])
        f[rate] -= w_noise @ skew(turning @ p_BS) - w_noise @ arm @ turning
        f[acceleration] -= dw_noise @ arm
        f[force] += (R_BS * noise.specific_force[tick]).T
        w[rate] += w_noise
        dw[acceleration] += dw_noise
        flags, none = np.full(s + 1, held), np.zeros((s + 1, len(self._model.rows)))
        joints_moved = moved[:, 0], moved[:, 1], moved[:, 2]
        z = None if signals.friction is None else np.repeat(signals.friction[tick][None], s + 1, axis=0)
        Y = self._model.regressor(*joints_moved, BaseMotion(w, dw, f), flags, False, none, self._fold, z)
        change = (Y[:-1] - Y[-1]).transpose(1, 0, 2)
        change[..., -1] *= -1.0  # the known part moves to the other side
        if mean is not None:
            predicted = change @ [*mean, -1.0]  # (rows, s)
            for row, column in self._scales:
                change[row, :, column] = predicted[row]
        return np.asarray(change, np.float64)
