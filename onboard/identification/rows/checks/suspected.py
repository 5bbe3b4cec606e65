"""What may not be as stated of an arm on a fixed base: a state of all errors, and the suspects in it.

Of each link but the payload, mass and inertia, either, the centre of mass, or all ten parameters may be off, or the
factor and the centre of mass (a part exchanged); of an encoder, or of all, the zero, the scale, the delay; of a cell,
of those of forces, of moments, or of all, the scale and the delay, and of a cell a step of its scale; the cells at a
frame may be turned in their mount, the base not level.
"""

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from scipy.constants import g

from onboard.estimation.arrays import ROUNDING, FloatArray, IndexArray
from onboard.estimation.policy import LIKELY_SIZE, ODDS, ODDS_OF_PART, LIKELY_DELAY_s
from onboard.identification.evidence.bank import Bank, Suspect, Weighed
from onboard.identification.evidence.bodies import ways
from onboard.identification.rows.checks.remade import OF_MOTION, OF_READING, STEPS
from onboard.identification.rows.stated_errors.considered import Considered, Effect
from onboard.identification.rows.stated_errors.equations import RowErrors
from onboard.regressor.base_parameters import BaseParameters
from onboard.regressor.rows import RowModel

_UNSTATED = 1e-5  # of the size of a suspect: sigma of an error of which the file states none
_TURNS: Effect = "accelerometer_misalignment"  # of a base that stands: how far it is from level
_OF_ENCODER: tuple[tuple[Effect, str, float], ...] = (
    ("joint_zero", "zero", LIKELY_SIZE),
    ("joint_scale", "scale", LIKELY_SIZE),
    ("joint_delay", "delay", LIKELY_DELAY_s),
)


def suspected(considered: Sequence[Considered], model: RowModel) -> tuple[Considered, ...]:
    """All errors of instruments that compete: those stated, and those of which nothing is stated, with a tiny sigma."""
    stated = [one for one in considered if one.sigma > 0.0 and one.row and one.effect in (*OF_MOTION, *OF_READING)]
    known = {(one.row, one.effect) for one in stated}
    asked: list[tuple[str, Effect, float, int | None]]
    asked = [(joint.name, effect, size, None) for joint in model.vehicle.joints for effect, _, size in _OF_ENCODER]
    asked += [(row.name, "delay", LIKELY_DELAY_s, None) for row in model.rows]
    asked += [(row.name, "scale", LIKELY_SIZE, None) for row in model.rows]
    asked += [(row.name, "step", LIKELY_SIZE, place) for row in model.rows for place in range(STEPS)]
    for axis in range(3):
        asked += [(frame, "turned", LIKELY_SIZE, axis) for frame in dict.fromkeys(row.frame for row in model.rows)]
    more = [
        Considered(f"{effect} of {row}", row, effect, _UNSTATED * size, axis=axis)
        for row, effect, size, axis in asked
        if (row, effect) not in known
    ]
    return (*stated, *_level(considered, model.vehicle.spec.base_link), *more)


def of_no_key(considered: Sequence[Considered], model: RowModel) -> list[Considered]:
    """Errors of angles, and of the level, of which the file states none: next to none, unless the rows contradict it.

    They have columns in the rows as those that are stated have.
    """
    known = {(one.row, one.effect) for one in considered}
    asked: list[tuple[str, Effect, str, float, int | None]] = [
        (joint.name, effect, what, size, None)
        for joint in model.vehicle.joints
        for effect, what, size in _OF_ENCODER
        if effect != "joint_delay" and (joint.name, effect) not in known
    ]
    if not any(one.effect == _TURNS for one in considered):
        asked += [(model.vehicle.spec.base_link, _TURNS, "level", LIKELY_SIZE, axis) for axis in range(3)]
    return [
        Considered(
            f"{what} of {row}",
            row,
            effect,
            _UNSTATED * size,
            f"{what} of {row}, of which no key says more",
            axis,
            is_stated=False,
        )
        for row, effect, what, size, axis in asked
    ]


def _level(considered: Sequence[Considered], base: str) -> Iterator[Considered]:
    """How far the base may not be level, by axis: as far as an IMU on it may err that is taken for what shows it."""
    of_axes = [one.sigma for one in considered if one.effect == _TURNS]
    of_bias = [one.sigma / g for one in considered if one.effect == "accelerometer_bias"]
    sigma = math.hypot(_UNSTATED * LIKELY_SIZE, max(of_axes, default=0.0), max(of_bias, default=0.0))
    for axis in range(3):
        yield Considered(f"level of {base}", base, "level", sigma, axis=axis)


class ErrorState:
    """Errors of the prior of an arm, ``beta = centre + G L z``, and of its instruments, each over its stated sigma.

    Args:
        model: the rows, of a fixed base.
        base: their base parameters.
        prior_root: L of the prior covariance of the standard parameters, (P, P).
        considered: errors that the recursion considers.
        remade: whether rows are made again about any error; else those that are not considered are left out, but those
            of cells' scales, and delays of encoders are as stated and no suspects.

    Attributes:
        of_instruments: those of instruments, e.
        sigma: of these, (e,).
        columns: places of these among the considered errors; -1 of one that is not considered, (e,).
        parameters: n, those of the prior that the rows show.
        centre: base parameters as drawn, (p,).
        bank: the suspects.
    """

    def __init__(
        self,
        model: RowModel,
        base: BaseParameters,
        prior_root: FloatArray,
        considered: Sequence[Considered],
        remade: bool = True,
    ) -> None:
        every = suspected(considered, model)
        if not remade:
            cells = [one for one in every if one.effect == "scale" and one not in considered]
            every = (*(one for one in considered if one.sigma > 0.0 and one.row), *cells)
        self.of_instruments = every
        self.columns = [considered.index(one) if one in considered else -1 for one in self.of_instruments]
        self._grouping = base.grouping
        self._active = np.flatnonzero((base.grouping @ prior_root).any(axis=0))
        self.parameters, self.centre, self._bodies = len(self._active), base.value(model.chi), base.of_bodies
        self.sigma = np.array([one.sigma for one in self.of_instruments])
        self._each = np.concatenate([np.diag(prior_root)[self._active], self.sigma])
        asked = [*self._links(model, prior_root), *self._instruments(model)]
        self._moving = self._of(lambda one: one.effect in (*OF_MOTION, _TURNS))
        fixed = np.zeros(0, np.intp) if remade else self._of(lambda one: one.effect == "joint_delay")
        asked = [one for one in asked if not np.isin(one.at, fixed).any()]
        suspects = [one for one in asked if len(one.at) and np.abs(one.along).max() < 1.0 / ROUNDING]  # else exact
        self.bank = Bank(suspects, np.ones(len(self._each)))

    def half(self, prior_root: FloatArray) -> FloatArray:
        """``G L``, (p, n), of a prior, L (P, P)."""
        return np.asarray((self._grouping @ prior_root)[:, self._active], np.float64)

    def of(self, half: FloatArray, instruments: Sequence[str]) -> RowErrors:
        """These errors; ``half``: of the prior; ``instruments``: names of rows."""
        reads = [[(one.row, one.effect) == (name, "scale") for name in instruments] for one in self.of_instruments]
        return RowErrors(half, self.centre, self.sigma, self.columns, np.array(reads), self._bodies)

    def moves(self, weighed: Weighed | None) -> bool:
        """Whether by the likeliest hypothesis angles, or the level, are not as stated: rows are not linear in these."""
        suspect = weighed.likeliest.suspect if weighed else None
        return suspect is not None and bool(np.isin(suspect.at, self._moving).any())

    def _links(self, model: RowModel, prior_root: FloatArray) -> Iterator[Suspect]:
        """Links that the rows show and that are not the payload."""
        vehicle = model.vehicle
        for number, link in enumerate(vehicle.links):
            own = slice(10 * number, 10 * number + 10)
            at, half = self._place(np.arange(own.start, own.stop)), prior_root[own, own]
            if link == vehicle.spec.payload_link or len(at) < 10 or np.linalg.matrix_rank(half) < 10:
                continue
            each = ways(model.chi[own], half)
            each += (np.hstack([each[0], each[3]]),)  # a part exchanged
            yield from (Suspect(link, at, way, ODDS_OF_PART / len(each)) for way in each)

    def _instruments(self, model: RowModel) -> Iterator[Suspect]:
        joints = [joint.name for joint in model.vehicle.joints]
        for effect, what, size in _OF_ENCODER:
            odds = ODDS_OF_PART / len(_OF_ENCODER)
            every = [self._places(joint, effect) for joint in joints]
            for joint, at in zip(joints, every, strict=True):
                yield self._alone(f"{what}_{joint}", at, size, odds)
            if len(joints) > 1:
                yield self._alone(f"{what}s of all joints", np.concatenate(every), size, odds)
        base = model.vehicle.spec.base_link
        level = self._of(lambda one: one.effect in ("level", _TURNS))
        yield self._alone(f"level of {base}", level, LIKELY_SIZE, ODDS_OF_PART)
        for frame in dict.fromkeys(row.frame for row in model.rows):
            yield self._alone(f"cells at {frame}", self._places(frame, "turned"), LIKELY_SIZE, ODDS_OF_PART)
        yield from self._cells(model)

    def _cells(self, model: RowModel) -> Iterator[Suspect]:
        names = [row.name for row in model.rows]
        scales = [self._places(name, "scale") for name in names]
        odds = 1.0 / len(names)
        for name, scale in zip(names, scales, strict=True):
            yield self._scaled(name, scale, ODDS * odds)
            yield self._alone(name, self._places(name, "delay"), LIKELY_DELAY_s, ODDS_OF_PART * odds)
            for place in self._places(name, "step"):
                yield self._alone(f"a step of {name}", place[None], LIKELY_SIZE, ODDS * odds / STEPS)
        forces = np.array([any(row.projection[:3]) for row in model.rows])
        groups = {"all forces": forces, "all moments": ~forces} if 0 < forces.sum() < len(forces) else {}
        for name, some in {**groups, "all cells": np.full(len(forces), True)}.items():
            which = np.flatnonzero(some)
            if len(which) > 1:
                yield self._scaled(name, np.concatenate([scales[k] for k in which]), ODDS_OF_PART)
                delays = np.concatenate([self._places(names[k], "delay") for k in which])
                yield self._alone(name, delays, LIKELY_DELAY_s, ODDS_OF_PART, together=True)

    def _place(self, columns: Sequence[int] | IndexArray) -> IndexArray:
        """Of standard parameters in the state."""
        return np.flatnonzero(np.isin(self._active, columns))

    def _places(self, row: str, effect: Effect) -> IndexArray:
        """Of the errors of an instrument in the state."""
        return self._of(lambda one: (one.row, one.effect) == (row, effect))

    def _of(self, which: Callable[[Considered], bool]) -> IndexArray:
        """Places of some errors of instruments in the state."""
        return self.parameters + np.flatnonzero([which(one) for one in self.of_instruments])

    def _scaled(self, name: str, at: IndexArray, odds: float) -> Suspect:
        """Scales of cells, by one factor."""
        return Suspect(name, at, LIKELY_SIZE / self._each[at, None], odds)

    def _alone(self, name: str, at: IndexArray, size: float, odds: float, together: bool = False) -> Suspect:
        """Errors of instruments, each by itself or all by one value."""
        along = size / self.sigma[at - self.parameters]
        return Suspect(name, at, along[:, None] if together else np.diag(along), odds)
