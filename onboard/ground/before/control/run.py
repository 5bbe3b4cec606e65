"""All trials of one run: the drives identified with an empty gripper, the capture, and what the controller makes of it.

What the controller knows is the URDF, or the URDF with the payload that was identified (``adopted``). ``model_error``
makes it wrong on purpose: all masses and inertias of its model are ``1 + model_error`` times what they are.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np

from drivers.records import Batch
from onboard import config
from onboard.config.driving import joint_ranges
from onboard.control import watch
from onboard.control.drives import Drives, identified
from onboard.control.laws import ComputedTorque, FeedForward, Gains, Law, SyncedMotion, feed_forward, free_inertia
from onboard.control.learning import Learning, LearningLaw, contraction
from onboard.control.motion import CYCLES, JointLimits, Motion, fitted
from onboard.devices.base import JointDevice
from onboard.devices.driven import DrivenDevice
from onboard.dynamics.mechanics.floating_arm import FloatingArm
from onboard.dynamics.mechanics.joint_space import JointSpace
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.arrays import FloatArray
from onboard.flight.estimate.problem.model import build_model
from onboard.flight.trials import PERIOD_MS, ArmOnBus, FlownTrial, Trials, Wire

PERIOD_S: Final = 1e-3 * PERIOD_MS
_COUNTS: Final = 500_000  # in a revolution of a joint that no device of the file measures
_FRICTION: Final = 0.02  # of the effort: Coulomb, and viscous at 1 rad/s, as long as nothing better is known
_LEAST_INERTIA: Final = 1e-3  # kg m^2 for each N m of effort: gains of the first trial, when rotors are not known
_PILOTS: Final = 2  # trials with an empty gripper; a joint may stick in the first, on friction that is guessed
_FREQUENCIES: Final = 60  # at which the convergence is computed
COMPUTED: Final = "computed_torque"


class TrialSetup(StrEnum):
    """What a trial is flown with."""

    EMPTY = "gripper empty, model as drawn"
    BEFORE = "payload held, model without it"
    AFTER = "payload held, model with it"
    LEARNING = "learning"


class Trial(NamedTuple):
    """One trial: its number within its stage, from 1, what was flown, and how far the tip was off."""

    stage: TrialSetup
    number: int
    flown: FlownTrial
    tip_m: FloatArray  # (m,) distance of the tip from where it should be, the base's motion left out

    @property
    def tip_rms_m(self) -> float:
        """Over the trial."""
        return float(np.sqrt(np.mean(self.tip_m**2))) if len(self.tip_m) else float("nan")

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        error, none = self.flown.error, not len(self.flown.error)
        return {
            "stage": self.stage.name.lower(),
            "trial": self.number,
            "joint_rms_rad": None if none else self.flown.rms_rad,
            "joint_largest_rad": None if none else float(np.abs(error).max()),
            "joints_rms_rad": None if none else np.sqrt((error**2).mean(axis=0)).tolist(),
            "tip_rms_m": None if none else self.tip_rms_m,
            "tip_largest_m": None if none else float(self.tip_m.max()),
            "saturated": self.flown.saturated,
            "missed_syncs": self.flown.missed,
            "stopped": self.flown.stopped,
        }


@dataclass
class TrialSeries:
    """A run."""

    vehicle: str
    controller: str
    joints: tuple[str, ...]
    model_error: float
    noise_rad: float
    factor: float
    drives: Drives
    trials: list[Trial] = field(default_factory=list)
    predicted: FloatArray | None = None  # (f, 2): frequency, Hz, and what a trial leaves of the error there
    stopped: str = ""

    def of(self, stage: TrialSetup) -> list[Trial]:
        """The trials of a stage."""
        return [trial for trial in self.trials if trial.stage is stage]

    @property
    def errors(self) -> list[float]:
        """Rms of the joints' errors of the controller's trials, rad."""
        last = TrialSetup.AFTER if self.controller == COMPUTED else TrialSetup.LEARNING
        return [trial.flown.rms_rad for trial in self.of(last) if not trial.flown.stopped]

    @property
    def gain(self) -> float | None:
        """How many times smaller the error of the tip is once the payload is adopted; None where it was not."""
        before = self.of(TrialSetup.BEFORE)
        after = [trial for trial in self.of(TrialSetup.AFTER) if not trial.flown.stopped]
        return before[0].tip_rms_m / after[0].tip_rms_m if before and after else None

    @property
    def rate(self) -> float | None:
        """What a trial leaves of the error, geometric mean until it no longer falls by a tenth; None of one trial."""
        errors = self.errors if self.controller != COMPUTED else []
        falls = next((k for k, (a, b) in enumerate(pairwise(errors)) if b > 0.9 * a), len(errors) - 1)
        return float((errors[falls] / errors[0]) ** (1.0 / falls)) if falls > 0 else None

    def as_json(self) -> dict[str, Any]:
        """Plain values, SI units."""
        return {
            "vehicle": self.vehicle,
            "controller": self.controller,
            "joints": list(self.joints),
            "model_error": self.model_error,
            "noise_rad": self.noise_rad,
            "gain_factor": self.factor,
            "drives": {name: values.tolist() for name, values in self.drives._asdict().items()},
            "trials": [trial.as_json() for trial in self.trials],
            "rate": self.rate,
            "predicted": None if self.predicted is None else self.predicted.tolist(),
            "tip_error_before_over_after": self.gain,
            "stopped": self.stopped,
        }


class TrialRequest(NamedTuple):
    """What is asked for.

    Attributes:
        controller: a value of :class:`LearningLaw`, or :data:`COMPUTED`.
        trials: of the controller.
        adopted: URDF with the payload identified; None where there is none.
        model_error: relative.
        noise_rad: that the bench's encoders have; for the record.
        factor: of all learning gains.
        duration_s: of the motion of a trial.
        rest_s: after it.
    """

    controller: str
    trials: int
    adopted: str | None = None
    model_error: float = 0.0
    noise_rad: float = 0.0
    factor: float = 1.0
    duration_s: float = 4.0
    rest_s: float = 1.0


def wires(vehicle: config.Vehicle, joints: tuple[str, ...]) -> list[Wire]:
    """The drives of all joints: those that the file has, and a drive at each other joint, counting as its encoder does.

    Raises:
        ValueError: a joint that slides.
    """
    devices = vehicle.file.device.items()
    measured = {device.joint: (name, device) for name, device in devices if isinstance(device, JointDevice)}
    drives = {name: device.settings(name) for name, device in devices if isinstance(device, DrivenDevice)}
    nodes = {drive.node for drive in drives.values()}
    free = iter(sorted(set(range(1, 127)) - nodes))
    found = []
    for joint in joints:
        name, device = measured.get(joint, (joint, None))
        if name in drives:
            found.append(_wire(name, joint, drives[name].node, device)._replace(gear_ratio=drives[name].gear_ratio))
        else:
            found.append(_wire(name, joint, next(free), device))
    return found


def _wire(name: str, joint: str, node: int, device: JointDevice | None) -> Wire:
    if device is None:
        return Wire(name, joint, node, _COUNTS)
    return Wire(name, joint, node, device.counts_per_revolution, device.zero_count, device.gain < 0.0)


def run(
    vehicle: config.Vehicle,
    bench: ArmOnBus,
    asked: TrialRequest,
    told: Callable[[Trial], None] = lambda _: None,
    record: Callable[[Sequence[Batch]], None] = lambda _: None,
) -> TrialSeries:
    """Fly all trials.

    Args:
        vehicle: whose arm it is.
        bench: the arm on its bus, its gripper empty.
        asked: for what.
        told: called with each trial, when it was flown.
        record: called with all that goes to and comes from the drives.

    Raises:
        ValueError: a vehicle whose arm cannot be controlled.
        RuntimeError: the drives cannot be enabled.
    """
    model = build_model(vehicle)
    space = joint_space(model, asked.model_error)
    names = tuple(joint.name for joint in model.joints)
    wired, limits = wires(vehicle, names), joint_limits(vehicle, model)
    effort = limits.effort
    if asked.adopted is not None and VehicleModel(asked.adopted, model.spec).joints != model.joints:
        raise ValueError("the URDF that was identified has other joints than the vehicle's; give that of this vehicle")
    guessed = Drives(_LEAST_INERTIA * effort, _FRICTION * effort, _FRICTION * effort)
    made = TrialSeries(
        vehicle.file.vehicle.name, asked.controller, names, asked.model_error, asked.noise_rad, asked.factor, guessed
    )
    with Trials(
        bench, wired, limits, lambda q: space.inertia(q) + np.diag(guessed.rotor_kg_m2), space.at_rest, record
    ) as trials:
        pilot = _Pilot(made, trials, told)
        inertia = space.inertia(trials.posture) + np.diag(guessed.rotor_kg_m2)
        motion = fitted(trials.posture, limits, inertia, asked.duration_s, asked.rest_s)
        reference = SyncedMotion.of(motion, PERIOD_S)
        assert trials.gains is not None
        for _ in range(_PILOTS):
            law = FeedForward(feed_forward(space, made.drives, reference), trials.gains)
            if not pilot.fly(TrialSetup.EMPTY, law, space, reference):
                return made
            made.drives = identified(space, *_together(made.trials[-1].flown), PERIOD_S)
            inertia = space.inertia(trials.posture) + np.diag(made.drives.rotor_kg_m2)
            trials.gains = Gains.of(inertia)
        bench.capture()
        _controlled(model, asked, pilot, space, reference, motion, inertia)
    return made


def _together(flown: FlownTrial) -> tuple[FloatArray, FloatArray]:
    """Positions and the torques in force at the same SYNCs: half of them from each of the two sent before."""
    in_force = 0.5 * (flown.torques[1:-1] + flown.torques[:-2])  # from SYNC i - 1 to i, and from i to i + 1
    return flown.measured[2:], in_force


class _Pilot:
    """Flies a trial and keeps it."""

    def __init__(self, made: TrialSeries, trials: Trials, told: Callable[[Trial], None]) -> None:
        self.made, self.trials, self._told = made, trials, told

    def fly(self, stage: TrialSetup, law: Law, space: JointSpace, reference: SyncedMotion) -> bool:
        """Whether it was flown to its end."""
        flown = self.trials.fly(law, reference)
        wanted = reference.q[: len(flown.error)]
        pairs = zip(wanted, flown.measured, strict=True)
        tip = np.array([np.linalg.norm(space.arm.tip_pose(a)[1] - space.arm.tip_pose(b)[1]) for a, b in pairs])
        self.made.trials.append(Trial(stage, len(self.made.of(stage)) + 1, flown, tip))
        self._told(self.made.trials[-1])
        self.made.stopped = flown.stopped
        return not flown.stopped


def _controlled(
    model: VehicleModel,
    asked: TrialRequest,
    pilot: _Pilot,
    space: JointSpace,
    reference: SyncedMotion,
    motion: Motion,
    inertia: FloatArray,
) -> None:
    """The trials after the capture."""
    made, drives = pilot.made, pilot.made.drives
    compares = asked.controller == COMPUTED or asked.adopted is not None
    if compares and not pilot.fly(TrialSetup.BEFORE, ComputedTorque(space, drives, reference), space, reference):
        return
    best = space
    if asked.adopted is not None:
        best = adopted = joint_space(VehicleModel(asked.adopted, model.spec), asked.model_error)
        for _ in range(asked.trials if asked.controller == COMPUTED else 1):
            if not pilot.fly(TrialSetup.AFTER, ComputedTorque(adopted, drives, reference), space, reference):
                return
    if asked.controller == COMPUTED:
        return
    assert pilot.trials.gains is not None
    gains = pilot.trials.gains
    learning = Learning.of(LearningLaw(asked.controller), gains, free_inertia(inertia), asked.factor)
    fastest = (2.0 * max(CYCLES[: len(made.joints)]) + 2.0) / (2.0 * motion.duration_s)
    band = np.geomspace(0.5 / motion.duration_s, max(4.0 * fastest, learning.low_pass_hz), _FREQUENCIES)
    whole = best.inertia(motion.start_rad) + np.diag(drives.rotor_kg_m2)
    left = contraction(learning, gains, whole, drives.viscous_n_m_s, band)
    made.predicted = np.stack([band, left], 1)
    torques = first = feed_forward(space, drives, reference)
    for _ in range(asked.trials):
        if not pilot.fly(TrialSetup.LEARNING, FeedForward(torques, gains), space, reference):
            return
        if why := watch.diverges(made.errors):
            made.stopped = why
            return
        torques = learning.next(torques, first, made.trials[-1].flown.error, PERIOD_S)


def joint_space(model: VehicleModel, model_error: float = 0.0) -> JointSpace:
    """Dynamics of a model whose masses and inertias are ``1 + model_error`` times what it says.

    Raises:
        ValueError: a prescribed base.
    """
    spec = model.spec
    if spec.base.moves and not spec.base.follows:
        raise ValueError("the base moves as prescribed, whatever the arm does: computed torque does not know how")
    tip = spec.payload_link if spec.payload_link is not None else model.links[-1]
    return JointSpace(FloatingArm(model, tip, (1.0 + model_error) * model.chi))


def joint_limits(vehicle: config.Vehicle, model: VehicleModel) -> JointLimits:
    """Of all joints, by the URDF.

    Raises:
        ValueError: a joint that slides, or has no range, speed or effort.
    """
    ranges, rows = joint_ranges(vehicle.urdf_text), []
    for joint in model.joints:
        found, effort = ranges.get(joint.name), float(model.model.effortLimit[joint.v_index])
        bounded = found is not None and np.isfinite([*found, effort]).all() and min(found.rate, effort) > 0.0
        if found is None or not bounded or not joint.revolute:
            raise ValueError(
                f"joint {joint.name!r}: it has to be revolute, with lower, upper, velocity and effort in <limit>"
            )
        rows.append((*found, effort))
    return JointLimits(*(np.array(column) for column in zip(*rows, strict=True)))
