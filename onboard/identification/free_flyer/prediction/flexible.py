"""Joints that give way, as unknowns: stiffness and damping of each, and its bend at the first tick.

Stiffness and damping are constants, known to the sigmas that the vehicle file states. Bend and rate of it change from
tick to tick (:mod:`onboard.dynamics.compliance`); nothing is known of them where a window begins.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from onboard.dynamics.compliance import Bend, Compliance, Springs, StateColumns
from onboard.dynamics.free_flight import BasePrediction
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.arrays import FloatArray, IndexArray
from onboard.identification.free_flyer.prediction.parameters import GeometryPrior, SpringPrior, UnknownLayout, Unknowns

_DAMPING_RATIO = 0.02  # of a joint's swing alone, unladen, where no damping is stated
_SOFTEST_Hz = 9.0  # of a joint's swing alone, unladen: rehearsed flights of softer joints gave wrong numbers
_STIFFEST_Hz = 25.0  # of the same: of 40 Hz a flight was refused for its damping, of 2 kHz no motion is found
_COLOURED = 10.0  # variance of the errors of joint accelerations over that of their noise, where joints swing
_TORQUE_N_m = 5.0  # 1 sigma of the torque that bends a joint at the start
_LARGEST = 1.0  # sigma of a bend, rad, and of its rate, rad/s


class BendAlong(NamedTuple):
    """Bends along a motion of the base, and what they add to derivatives."""

    bend: Bend
    by_all: FloatArray  # (n, 3 f + 3, p), and of the momentum that they turn
    base: BasePrediction
    told: StateColumns

    def added(self, by_motion: FloatArray) -> FloatArray:
        """What a derivative by the columns of the base's motion, (n, m, columns), adds to that by all, (n, m, p)."""
        of_both, base = self.by_all, self.base
        out = np.concatenate([by_motion[..., base.local], by_motion[..., base.of_momentum]], axis=2) @ of_both
        out[..., self.told.bends] += by_motion[..., base.at_first][..., : len(self.told.bends)]
        return np.asarray(out, np.float64)

    def carry(self, transition: FloatArray, state: FloatArray) -> None:
        """Put bends and their rates at the last tick but one into what is carried on, with their derivatives.

        Args:
            transition: of what changes, rows of the base's rate first, of the bends last, (c, p); changed.
            state: (p,); changed.
        """
        at = self.told.bends
        transition[:3] += self.added(self.base.d_rate)[-2]
        transition[-len(at) :] = self.by_all[-2, : len(at)]
        state[at] = np.concatenate([self.bend.b[-2], self.bend.db[-2]])


class FlexibleJoints:
    """The joints of a vehicle that give way.

    Args:
        vehicle: the model.
        springs: by the joints' places in the vehicle's.
        free: links whose columns the base's prediction has.
        cyclic: the joint of each function of a cyclic error.

    Attributes:
        compliance: of the joints.
        bends: where angles and rates of the bends stand in the state, (2 f,).
        swings_Hz: of each joint alone with nothing held, where it turns most.
    """

    @staticmethod
    def of(vehicle: VehicleModel, geometry: GeometryPrior, free: tuple[int, ...]) -> "FlexibleJoints | None":
        """Those that are said to be flexible; None without any."""
        springs = geometry.springs(vehicle)
        return FlexibleJoints(vehicle, springs, free, geometry.cyclic_joints(vehicle)) if springs else None

    def __init__(
        self, vehicle: VehicleModel, springs: Mapping[int, SpringPrior], free: tuple[int, ...], cyclic: list[int]
    ) -> None:
        self._cyclic = cyclic
        self.compliance = Compliance(vehicle, list(springs), free, cyclic)
        self._names, self._priors = [vehicle.joints[k].name for k in springs], tuple(springs.values())
        chi = vehicle.chi.copy()
        chi[vehicle.payload_columns()] = 0.0
        inertia = self.compliance.largest(chi)
        stiffness, damping = np.array(
            [
                (one.stiffness_N_m_rad, np.nan if one.damping_N_m_s_rad is None else one.damping_N_m_s_rad)
                for one in self._priors
            ]
        ).T
        swing = 2.0 * _DAMPING_RATIO * np.sqrt(stiffness * inertia)
        self.swings_Hz = dict(zip(self._names, np.sqrt(stiffness / inertia) / (2.0 * np.pi), strict=True))
        self._stated = Springs(stiffness, np.where(np.isnan(damping), swing, damping))
        angle = np.minimum(_TORQUE_N_m / stiffness, _LARGEST)
        self._sigma = np.concatenate([angle, np.minimum(angle * np.sqrt(stiffness / inertia), _LARGEST)])
        self.bends: IndexArray = np.zeros(0, np.intp)

    def blocks(self) -> dict[str, Unknowns]:
        """Blocks of unknowns: ``stiffness`` and ``damping``, relative, (f,) each, ``bends``, (2 f,)."""
        stiffness, damping = np.array([(one.stiffness_relative, one.damping_relative) for one in self._priors]).T
        names = {kind: tuple(f"{kind}_{name}" for name in self._names) for kind in ("stiffness", "damping")}
        bends = tuple(f"{kind}_{name}" for kind in ("bend", "bend_rate") for name in self._names)
        return {
            "stiffness": Unknowns(names["stiffness"], stiffness),
            "damping": Unknowns(names["damping"], damping),
            "bends": Unknowns(bends, self._sigma),
        }

    def placed(self, layout: UnknownLayout) -> list[int]:
        """Take in where the unknowns stand; the joint of each function of an error that varies in time."""
        self._layout = layout
        self.bends = layout.estimated("bends")
        return [*self._cyclic, *self.compliance.functions]

    @property
    def places(self) -> tuple[IndexArray, IndexArray]:
        """In the state: of the bends and their rates, of stiffness and damping."""
        return self.bends, self._layout.estimated("stiffness", "damping")

    def driven(self, joint_sigma: FloatArray, period_s: float) -> FloatArray:
        """What the noise of the joints' accelerations as they are read adds to variances of the bends' rates, (f,).

        Args:
            joint_sigma: of joint rates and accelerations, (n, 2, joints).
            period_s: between ticks.
        """
        each = joint_sigma[:, 1, self.compliance.joints]
        return np.asarray(_COLOURED * period_s**2 * (each**2).sum(axis=0), np.float64)

    def springs(self, x: FloatArray) -> Springs:
        """With the errors among all unknowns."""
        stated, at = self._stated, self._layout
        return Springs(stated.stiffness * (1.0 + x[at["stiffness"]]), stated.damping * (1.0 + x[at["damping"]]))

    def along(
        self,
        base: BasePrediction,
        bend: Bend,
        x: FloatArray,
        period_s: float,
        of_motion: list[tuple[slice | IndexArray, slice | IndexArray]],
        size: int,
    ) -> BendAlong:
        """What the bends add to derivatives.

        Args:
            base: its motion with these bends.
            bend: these.
            x: all unknowns.
            period_s: between ticks.
            of_motion: places in the state, and among the columns of the base's motion.
            size: of the state.
        """
        layout = self._layout
        told = StateColumns(of_motion, layout.estimated("stiffness"), layout.estimated("damping"), self.bends, size)
        by_all = self.compliance.derivatives(base, bend, self.springs(x), self._stated, period_s, told)
        return BendAlong(bend, by_all, base, told)


def require_stiff(vehicle: VehicleModel, geometry: GeometryPrior) -> None:
    """Check that no flexible joint is softer or stiffer than those whose answers held.

    Raises:
        SignalError: one is.
    """
    flexible = FlexibleJoints.of(vehicle, geometry, ())
    for name, swings_Hz in ({} if flexible is None else flexible.swings_Hz).items():
        if not _SOFTEST_Hz <= swings_Hz <= _STIFFEST_Hz:
            why = "such an arm gets no answer without" if swings_Hz < _SOFTEST_Hz else "it is taken for stiff then"
            raise SignalError(
                f"joint {name}: by its stiffness it swings with nothing held at {swings_Hz:.2g} Hz; "
                f"answers hold from {_SOFTEST_Hz:g} to {_STIFFEST_Hz:g} Hz, so take the stiffness out: {why}"
            )
