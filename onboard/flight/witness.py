"""Instruments that the estimator does not use, compared with what it does use: a second IMU, a load cell.

Both sides of a comparison must be proportional with slope one: the rates of two IMUs on one body, a cell's reading and
what the identified payload makes of the measured motion. The slope of one on the other, both about their means (biases
drop out), is compared with one in blocks of a second or three. Two or three blocks of motion in a row outside what is
allowed are a contradiction: which side is wrong is not known, so no answer is used from then on.
"""

import numpy as np
from numpy.typing import NDArray

from onboard.devices.roles import ImuRole, LoadCellKeys
from onboard.dynamics.vehicle import VehicleModel
from onboard.estimation.arrays import FloatArray
from onboard.flight.signals import SignalSmoother
from onboard.identification.quantities import Estimate
from onboard.regressor.rows import BaseMotion, RowModel, base_motion, load_cell_row
from onboard.timebase.timebase import Timebase

_BLOCK_S, _CONTRADICTIONS = 1.0, 3  # rates: length of a block, blocks of motion in a row that contradict
_CELL_BLOCK_S, _CELL_CONTRADICTIONS = 3.0, 2  # a cell: the angular acceleration that predicts it is noisier
_LEAST = 0.05  # always allowed, of the slope
_LEAST_BY_MODEL = 0.15  # the same where one side is computed from link parameters as drawn
_SIGMAS = 6.0
_MOVING = 30.0  # times the noise: motion in a block that is judged
_KNOWN = 0.05  # relative sigma of the payload's mass from which on it predicts a cell


class _Slope:
    """Slope of one signal on another, block by block.

    Args:
        blocks: in a row that are a contradiction.
        alike: both have as little noise, so what one slope leaves over contradicts too.

    Attributes:
        slope: of the last block that was judged.
    """

    def __init__(self, blocks: int, *, alike: bool) -> None:
        self._blocks, self._alike = blocks, alike
        self._pending: list[tuple[FloatArray, FloatArray]] = []
        self._noise = 0.0
        self._bad = 0
        self.slope = np.nan

    def forget(self) -> None:
        """Begin a new block; earlier contradictions do not count."""
        self._pending, self._noise, self._bad = [], 0.0, 0

    def add(self, first: FloatArray, second: FloatArray, noise: float, allowed: float, ticks: int) -> bool:
        """Add ticks, (n, k) each; True when so many blocks in a row contradict a slope of one.

        Args:
            first: the one that is predicted.
            second: the one with less noise.
            noise: sigma of ``second``.
            allowed: of the slope, from one.
            ticks: in a block.
        """
        whole = np.isfinite(np.hstack([first, second])).all(axis=1)
        self._pending.append((first[whole], second[whole]))
        self._noise = max(self._noise, noise)
        if sum(len(part) for part, _ in self._pending) < ticks:
            return False
        x, y = (np.concatenate(side) for side in zip(*self._pending, strict=True))
        self._pending = []
        return self._judge(x - x.mean(axis=0), y - y.mean(axis=0), allowed)

    def _judge(self, first: FloatArray, second: FloatArray, allowed: float) -> bool:
        moved = float((second * second).sum())
        if moved < (_MOVING * self._noise) ** 2 * len(second) or self._noise == 0.0:
            return False
        self.slope = float((first * second).sum()) / moved
        left = float(np.sqrt(((first - self.slope * second) ** 2).sum() / moved))  # over the motion
        spread = left / np.sqrt(len(second) - 1.0)  # standard error of the slope
        bad = abs(self.slope - 1.0) > allowed + _SIGMAS * spread or (self._alike and left > allowed + 2.0 / _MOVING)
        self._bad = self._bad + 1 if bad else 0
        return self._bad >= self._blocks


class RateWitness:
    """Compares the rates of two IMUs on the base.

    Args:
        model: of the vehicle, for the axes of both.
        imus: the one that is used, and the witness.
        scale_sigma: of either one's gyro, relative.
    """

    def __init__(self, model: VehicleModel, imus: tuple[ImuRole, ImuRole], scale_sigma: float) -> None:
        self._imus = imus
        self._axes = tuple(model.pose_in_base(imu.frame)[0] for imu in imus)
        self._allowed = max(_LEAST, _SIGMAS * np.sqrt(2.0) * scale_sigma)
        self._slope = _Slope(_CONTRADICTIONS, alike=True)
        self.contradiction = ""

    def check(self, signals: SignalSmoother, timebase: Timebase, at_ns: NDArray[np.int64], period_ns: int) -> bool:
        """Look at new ticks; True when they begin to contradict each other."""
        if self.contradiction:
            return False
        rates, noise = [], 0.0
        for imu, axes in zip(self._imus, self._axes, strict=True):
            means = signals.means(imu.channels, timebase, at_ns, period_ns)
            rates.append(means.derivatives[0][:, :3] @ axes.T)
            noise = max(noise, float(np.nan_to_num(means.sigma[0][:, :3]).max(initial=0.0)))
        if not self._slope.add(rates[0], rates[1], noise, self._allowed, round(_BLOCK_S * 1e9 / period_ns)):
            return False
        used, other = (imu.channels[0] for imu in self._imus)
        share = f"{used} turns by {self._slope.slope:.0%} of {other}"
        self.contradiction = f"{used} and {other} contradict each other: {share}"
        return True


class CellWitness:
    """Compares a load cell with what the identified payload makes of the measured motion of base and joints.

    Args:
        model: of the vehicle; links but the payload as drawn.
        name: of the load cell.
        channel: its own.
        keys: what it measures.
        imu_frame: of the IMU on the base.
    """

    def __init__(self, model: VehicleModel, name: str, channel: str, keys: LoadCellKeys, imu_frame: str) -> None:
        self._name, self._channel, self._imu_frame, self._model = name, channel, imu_frame, model
        row = load_cell_row(name, keys.frame, keys.axis, keys.measures, keys.lever_m, bias=False)
        self._rows = RowModel(model, [row])
        self._scale = float(np.hypot(keys.scale_sigma, keys.lever_sigma_m / keys.lever_m))
        self._slope = _Slope(_CELL_CONTRADICTIONS, alike=False)
        self.contradiction = ""

    def check(
        self,
        signals: SignalSmoother,
        timebase: Timebase,
        at_ns: NDArray[np.int64],
        period_ns: int,
        joints: FloatArray,
        imu: FloatArray,
        estimate: Estimate,
    ) -> bool:
        """Look at new ticks; True when the cell begins to contradict the estimate.

        Args:
            signals: the smoothed channels.
            timebase: of their clocks.
            at_ns: ticks, (n,).
            period_ns: between them.
            joints: positions, rates and accelerations, (3, n, joints).
            imu: rate and specific force of the base IMU, means over the ticks, (n, 6).
            estimate: the payload's standard parameters come first.
        """
        mass, sigma = float(estimate.mean[0]), float(estimate.sigma[0])
        if self.contradiction or len(at_ns) < 3:
            return False
        if not (np.isfinite(mass) and sigma < _KNOWN * mass):
            self._slope.forget()
            return False
        cell = signals.means((self._channel,), timebase, at_ns, period_ns)
        read, noise = cell.derivatives[0][:, :1], float(np.nan_to_num(cell.sigma[0]).max(initial=0.0))
        acceleration = np.gradient(imu[:, :3], period_ns * 1e-9, axis=0)
        motion = base_motion(self._model, self._imu_frame, imu[:, :3], acceleration, imu[:, 3:])
        chi = self._model.chi.copy()
        chi[self._model.payload_columns()] = estimate.mean[:10]
        known = np.isfinite(np.concatenate([*joints, imu, acceleration], axis=1)).all(axis=1)
        predicted = np.full_like(read, np.nan)
        q, dq, ddq = (x[known] for x in joints)
        Y = self._rows.regressor(q, dq, ddq, BaseMotion(*(x[known] for x in motion)))  # (n, 1, columns)
        predicted[known] = Y[:, :, : chi.size] @ chi
        allowed = max(_LEAST_BY_MODEL, _SIGMAS * float(np.hypot(self._scale, sigma / mass)))
        if not self._slope.add(predicted, read, noise, allowed, round(_CELL_BLOCK_S * 1e9 / period_ns)):
            return False
        self.contradiction = (
            f"{self._name} contradicts the payload: by the estimate its readings should be "
            f"{self._slope.slope:.0%} of what they are"
        )
        return True
