"""Rows of kept ticks made again about any estimate, of an arm on a fixed base: readings, and their derivatives.

The recursion's rows are linear in the base parameters, made of the motion as it was read. Here angles, rates and
accelerations are first corrected for errors of the encoders, and readings for those of the cells:

    q' = (q - zero - cyclic) / (1 + scale) + delay dq + delay^2 ddq / 2,
    reading = (1 + gain) (Y(q', dq', ddq') chi + bias)

with the specific force turned by how far the base is from level, and the wrench by how far the cells are turned in
their mount. Derivatives by errors of motion are differences.

Ticks are kept in constant memory.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.linalg import hadamard

from onboard.estimation.arrays import ROUNDING, BoolArray, FloatArray
from onboard.estimation.smoothing import jerk_factor
from onboard.identification.rows.stated_errors.considered import Considered
from onboard.regressor.base_parameters import BaseParameters
from onboard.regressor.rows import BaseMotion, RowModel

MOST_TICKS = 400  # of signals smoothed over 0.2 s, what is independent in 80 s


class SmoothedTicks(NamedTuple):
    """Smoothed signals at t ticks of an arm on a fixed base with j joints, and m rows of each."""

    time_s: FloatArray  # (t,)
    q: FloatArray  # (t, j)
    dq: FloatArray  # (t, j)
    ddq: FloatArray  # (t, j)
    jerk: FloatArray  # (t, j)
    cyclic: FloatArray  # (t, 3, c) functions of the encoders' cyclic errors, and two derivatives
    friction: FloatArray  # (t, motors) Coulomb friction of each over its level
    force: FloatArray  # (t, 3) specific force of the base, m/s^2
    attached: BoolArray  # (t,) whether the payload is held
    measured: FloatArray  # (t, m), 0 where a row was not used
    rate: FloatArray  # (t, m) of what is measured
    weight: FloatArray  # (t, m) one over the variance of each row; 0 where it was not used
    noise: FloatArray  # (t, 3 j + 3) standard deviations of angles, rates, accelerations, and of the force by axis

    def at(self, which: slice | BoolArray) -> "SmoothedTicks":
        """Some of them."""
        return _of(part[which] for part in self)

    @property
    def noisier(self) -> "SmoothedTicks":
        """The same with one standard deviation of noise more in each signal.

        Of ticks that follow each other the signs of all signals are rows of a Hadamard matrix: over as many as it has,
        the noise of no two is alike. That of the jerk is made of those of rates and accelerations as a smoothed white
        noise has it (:func:`.jerk_factor`).
        """
        (count, joints), ends = self.q.shape, np.cumsum([self.q.shape[1]] * 3)
        signs = hadamard(1 << (self.noise.shape[1] + joints - 1).bit_length())[:, : self.noise.shape[1] + joints]
        signs = signs[np.arange(count) % len(signs)]
        q, dq, ddq, force = np.split(self.noise * signs[:, joints:], ends, axis=1)
        rate, acceleration = self.noise[:, joints : 2 * joints], self.noise[:, 2 * joints : 3 * joints]
        largest = np.divide(acceleration**2, rate, out=np.zeros_like(rate), where=rate > 0.0)
        jerk = largest * np.sqrt(jerk_factor() - 1.0) * signs[:, :joints]
        jerk -= largest * signs[:, 2 * joints : 3 * joints]
        moved = {"q": self.q + q, "dq": self.dq + dq, "ddq": self.ddq + ddq, "jerk": self.jerk + jerk}
        return self._replace(force=self.force + force, **moved)


def _of(parts: Iterable[NDArray[Any]]) -> SmoothedTicks:
    return SmoothedTicks(*parts)


class KeptTicks:
    """Every n-th of the ticks given, n doubled whenever more than :data:`MOST_TICKS` would be kept.

    Attributes:
        every: n.
        ticks: those kept, if any.
    """

    def __init__(self) -> None:
        self.every, self._given = 1, 0
        self.ticks: SmoothedTicks | None = None

    def add(self, ticks: SmoothedTicks) -> None:
        """Takes further ticks in, later than all before."""
        given = self._given + np.arange(len(ticks.time_s))
        self._given += len(given)
        more = ticks.at(np.asarray(given % self.every == 0))
        if self.ticks is not None:
            more = _of(np.concatenate(pair) for pair in zip(self.ticks, more, strict=True))
        while len(more.time_s) > MOST_TICKS:
            more, self.every = more.at(slice(None, None, 2)), 2 * self.every
        self.ticks = more


_STEP = 1e-6  # rad, relative or s, of a difference
STEPS = 6  # places at which a cell's scale may step, each a seventh of the ticks from the next
OF_MOTION = ("joint_zero", "joint_scale", "joint_delay", "joint_cyclic", "level")
MOVING = (*OF_MOTION, "accelerometer_misalignment")  # the level, by an IMU on a base that stands
OF_READING = ("scale", "delay", "drift", "step", "turned")


class RemadeRows(NamedTuple):
    """Rows of all ticks about an estimate."""

    reading: FloatArray  # (t, m) as predicted
    slope: FloatArray  # (t, m, p + k) by base parameters and errors


class RowsRemade:
    """Prediction of one model's rows.

    Args:
        model: the rows, their base fixed.
        base: their base parameters, p.
        errors: k of them, of instruments and of how these are mounted.
    """

    def __init__(self, model: RowModel, base: BaseParameters, errors: Sequence[Considered]) -> None:
        self._model, self._errors, self._p = model, tuple(errors), len(base.names)
        names = [row.name for row in model.rows]
        self._joints = [joint.name for joint in model.vehicle.joints]
        self._row = [names.index(one.row) if one.effect in OF_READING and one.row in names else 0 for one in errors]
        self._known, self._independent = np.where(base.grouping.any(axis=0), 0.0, model.chi), base.independent
        self._fold = model.fold(np.column_stack([np.eye(len(model.names))[:, base.independent], self._known]))
        self._scaled = {k: names.index(one.row) for k, one in enumerate(errors) if one.effect == "scale"}
        self._level = {k: self._axis(one) for k, one in enumerate(errors) if one.effect in MOVING[-2:]}
        self._turned = {k: turned(model, one) for k, one in enumerate(errors) if one.effect == "turned"}

    def at(self, ticks: SmoothedTicks, beta: FloatArray, errors: FloatArray) -> RemadeRows:
        """Readings and their derivatives about base parameters (p,) and errors (k,)."""
        moving = [k for k, one in enumerate(self._errors) if one.effect in MOVING]
        Y = self._rows(ticks, errors)
        wrench = Y @ [*beta, 1.0]  # (t, m) before gains
        mix = np.eye(wrench.shape[1]) + sum(errors[k] * T for k, T in self._turned.items())
        mixed = wrench @ mix.T
        gain = np.ones(mixed.shape)
        for k, row in self._scaled.items():
            gain[:, row] += errors[k]
        steps = np.ones_like(gain)
        for k, later in self._later(len(gain)):
            steps[:, self._row[k]] += errors[k] * later
        slope = np.zeros((*gain.shape, self._p + len(errors)))
        slope[..., : self._p] = (gain * steps)[..., None] * (mix @ Y[..., :-1])
        for k, row in self._scaled.items():
            slope[:, row, self._p + k] = steps[:, row] * mixed[:, row]
        for k, change in zip(moving, self._changes(ticks, beta, errors, moving), strict=True):
            slope[..., self._p + k] = gain * steps * (change @ mix.T)
        for k, T in self._turned.items():
            slope[..., self._p + k] = gain * steps * (wrench @ T.T)
        for k, later in self._later(len(gain)):
            slope[:, self._row[k], self._p + k] = (gain * mixed)[:, self._row[k]] * later
        reading = gain * steps * mixed
        for k, one in enumerate(self._errors):
            if one.effect in ("delay", "drift"):
                row = self._row[k]
                slope[:, row, self._p + k] = ticks.time_s if one.effect == "drift" else -ticks.rate[:, row]
                reading[:, row] += errors[k] * slope[:, row, self._p + k]
        return RemadeRows(reading, slope)

    def moved(self, ticks: SmoothedTicks, beta: FloatArray, errors: FloatArray) -> FloatArray:
        """Readings alone, (t, m), of cells without errors; of others see :meth:`at`."""
        return np.asarray(self._rows(ticks, errors) @ [*beta, 1.0], np.float64)

    def _axis(self, error: Considered) -> FloatArray:
        """Direction that gravity is turned about, in axes of the base."""
        axes = np.eye(3) if error.effect == "level" else self._model.vehicle.pose_in_base(error.row)[0]
        return np.asarray(axes[:, error.axis or 0], np.float64)

    def _later(self, ticks: int) -> Iterator[tuple[int, FloatArray]]:
        """Each error that is a step, and whether a tick comes after it, (t,)."""
        for k, one in enumerate(self._errors):
            if one.effect == "step":
                yield k, (np.arange(ticks) * (STEPS + 1) >= ticks * (1 + (one.axis or 0))).astype(np.float64)

    def _rows(self, ticks: SmoothedTicks, errors: FloatArray) -> FloatArray:
        """Rows of the corrected motion, (t, m, p + 1); what is known last."""
        q, dq, ddq, force = self._corrected(ticks, errors)
        still = np.zeros_like(force)
        motion = BaseMotion(still, still, force)
        return self._model.regressor(q, dq, ddq, motion, ticks.attached, fold=self._fold, friction=ticks.friction)

    def _changes(self, ticks: SmoothedTicks, beta: FloatArray, errors: FloatArray, moving: Sequence[int]) -> FloatArray:
        """Derivatives of the wrenches before gains by errors of the motion, (s, t, m)."""
        chi = self._known.copy()
        chi[self._independent] += beta
        cases = [errors, *(errors + _STEP * np.eye(len(errors))[moving])]
        motions = zip(*(self._corrected(ticks, by) for by in cases), strict=True)
        q, dq, ddq, force = (np.concatenate(parts) for parts in motions)
        held, friction = np.tile(ticks.attached, len(cases)), np.tile(ticks.friction, (len(cases), 1))
        read = self._model.readings(chi, q, dq, ddq, force, held, friction)
        about, *changed = read.reshape(len(cases), len(ticks.attached), -1)
        return (np.array(changed) - about) / _STEP

    def _corrected(
        self, ticks: SmoothedTicks, errors: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Motion without the errors of its sensors: angles, rates, accelerations, specific force."""
        zero, scale, delay = np.zeros((3, len(self._joints)))
        off, tilt = np.zeros((len(ticks.q), 3, len(zero))), np.zeros(3)
        for k, (one, error) in enumerate(zip(self._errors, errors.tolist(), strict=True)):
            if k in self._level:
                tilt += error * self._level[k]
            elif one.effect == "joint_cyclic":
                off[:, :, self._joints.index(one.row)] += error * ticks.cyclic[:, :, one.axis or 0]
            elif one.effect in OF_MOTION:
                kind = {"joint_zero": zero, "joint_scale": scale, "joint_delay": delay}[one.effect]
                kind[self._joints.index(one.row)] = error
        over = 1.0 / (1.0 + scale)
        q = (ticks.q - zero - off[:, 0]) * over + delay * ticks.dq + 0.5 * delay**2 * ticks.ddq
        dq = (ticks.dq - off[:, 1]) * over + delay * ticks.ddq + 0.5 * delay**2 * ticks.jerk
        ddq = (ticks.ddq - off[:, 2]) * over + delay * ticks.jerk
        return q, dq, ddq, ticks.force @ pin.exp3(tilt).T


def turned(model: RowModel, error: Considered) -> FloatArray:
    """What a small turn of all cells at a frame adds to each reading, by the others, (m, m); per rad.

    Args:
        model: the rows.
        error: frame and axis.

    Returns:
        Zeros where other components of the wrench than the cells measure would be read.
    """
    T = np.zeros((len(model.rows), len(model.rows)))
    axis = np.eye(3)[error.axis or 0]
    at = [k for k, row in enumerate(model.rows) if row.frame == error.row]
    every = np.array([model.rows[k].projection for k in at]).T  # (6, rows)
    for k in at:
        own = np.array(model.rows[k].projection)
        rotated = np.concatenate([np.cross(axis, own[:3]), np.cross(axis, own[3:])])
        by = np.linalg.lstsq(every, rotated, rcond=None)[0]
        if np.abs(every @ by - rotated).max() > ROUNDING * np.abs(own).max():
            return np.zeros_like(T)
        T[k, at] = by
    return T
