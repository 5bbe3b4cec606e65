"""Motion of a free base with joints that give way, from all unknowns of a flight; with stiff ones: :mod:`.core`."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from onboard.dynamics.compliance import Bend, BentVehicle
from onboard.dynamics.free_flight import BasePrediction, Push, bodies_from_rate, predict_base_from_rate
from onboard.dynamics.joint_errors import PER_JOINT, EncoderReadings, JointErrors
from onboard.dynamics.kinematics import chain_motion
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.dynamics.spatial import Columns
from onboard.estimation.arrays import FloatArray
from onboard.identification.free_flyer.prediction.flexible import FlexibleJoints
from onboard.identification.free_flyer.prediction.further import Thruster
from onboard.identification.free_flyer.prediction.parameters import UncertainLinks, UnknownLayout


class MovingBase:
    """Predicts the base.

    Args:
        vehicle: the model.
        layout: of all unknowns.
        links: the uncertain ones.
        columns: of payload and links.
        joint_errors: of the joints.
        flexible: joints that give way.
        thrusters: whose forces are known.
    """

    def __init__(
        self,
        vehicle: VehicleModel,
        layout: UnknownLayout,
        links: UncertainLinks,
        columns: Columns,
        joint_errors: JointErrors,
        flexible: FlexibleJoints,
        thrusters: Sequence[Thruster],
    ) -> None:
        self._vehicle, self._layout, self._links = vehicle, layout, links
        self._columns, self._joint_errors, self._flexible = columns, joint_errors, flexible
        self._disturbed = layout.estimated("disturbance").size > 0
        self._wrenches = np.array([one.wrench for one in thrusters]).reshape(-1, 6).T  # (6, k)

    def predict(
        self, readings: EncoderReadings, x: FloatArray, period_s: float, thrust: FloatArray | None = None
    ) -> tuple[BasePrediction, Bend]:
        """With all unknowns (every one, :meth:`Layout.whole`) as they are estimated; and bends of the joints.

        Args:
            readings: of the encoders, with the functions of :meth:`functions`.
            x: all unknowns.
            period_s: between ticks.
            thrust: forces of the thrusters, (n, k) N; None: zero.
        """
        vehicle, at, flexible = self._vehicle, self._layout, self._flexible
        rate, push = x[at["start"]], None
        if self._wrenches.size:
            forces = np.zeros((len(readings.q), self._wrenches.shape[1])) if thrust is None else thrust
            push = Push(forces[:, None] * self._wrenches, 1.0 + x[at["thrusters"]])
        if self._disturbed:
            unknown = Push(_steady_and_growing(len(readings.q), period_s), x[at["disturbance"]])
            push = unknown if push is None else push.and_too(unknown)
        chi = self._links.chi(x[at["payload"]], self._links.basis @ x[at["links"]])
        own = x[at["joints"]].reshape(-1, PER_JOINT)
        told = readings.corrected(own, x[at["cyclic"]], self._joint_errors.of_cyclic)

        def bent(bend: Bend) -> BentVehicle:
            chain = chain_motion(vehicle, *flexible.compliance.added(told[:3], bend), own[:, :3])
            return BentVehicle(bodies_from_rate(chain.links, period_s, chi, rate, push), chain.screws)

        bend = flexible.compliance.follow(x[at["bends"]], flexible.springs(x), period_s, len(readings.q), bent)
        corrected = flexible.compliance.added(told[:3], bend)
        chain = chain_motion(vehicle, *corrected, own[:, :3])
        errors = self._joint_errors.along(chain, told.functions, len(flexible.compliance.functions))
        return predict_base_from_rate(chain.links, period_s, chi, rate, self._columns, errors, push), bend

    def functions(self, ticks: int, cyclic: FloatArray | None) -> FloatArray:
        """Of the joints' errors that vary in time, (n, 3, m): cyclic ones, zero for None, then those of bends."""
        count = len(self._joint_errors.of_cyclic)
        own = self._flexible.compliance.unit_functions(ticks)
        plain = np.zeros((ticks, 3, count - own.shape[2])) if cyclic is None else cyclic
        return np.concatenate([plain, own], axis=2)


@lru_cache(maxsize=16)
def _steady_and_growing(ticks: int, period_s: float) -> FloatArray:
    """A unit of each component of a wrench, constant, then growing from the first tick on, (n, 6, 12)."""
    growth = np.ones((ticks, 1, 2, 1))
    growth[:, 0, 1, 0] = period_s * np.arange(ticks)
    found = np.asarray(growth * np.eye(6)[:, None], np.float64).reshape(ticks, 6, 12)
    found.setflags(write=False)
    return found
