"""What stays identifiable when something is lost: the same bound of the same motion, of the vehicle without it.

- A joint (its motor, or its encoder: then it may not move either) is parked where the motion begins.
- An IMU or a load cell is taken out of the vehicle file.
- The sync pulse: every stream that marks pulses is known in time by its arrival only, which is uniform within a poll,
  or within a sample where it is not polled: 1 sigma of its period over the square root of twelve.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from onboard import config
from onboard.config.estimation import JointKeys
from onboard.devices.base import BusDevice, ImuDevice
from onboard.devices.roles import LoadCellKeys
from onboard.dynamics.model.errors import UnknownFrameError
from onboard.flight.estimate.problem.model import build_model
from onboard.flight.estimate.readings.roles import roles_of
from onboard.ground.before.foresee.foresee import foresee
from onboard.ground.before.foresee.kept import kept
from onboard.ground.before.foresee.plan import UNDETERMINED, Expected, Foreseen, MotionPlan
from onboard.identification.standing import Level

PULSE, CELL = "pulse", "cell"
_UNIFORM = 12.0**-0.5


class Contingency(NamedTuple):
    """A motion with everything, and without what is lost."""

    lost: tuple[str, ...]
    words: tuple[str, ...]  # what each loss means here
    whole: Foreseen
    left: Foreseen | None  # None: nothing can be determined
    why: str  # where nothing can be

    def pairs(self) -> list[tuple[Expected, Expected | None]]:
        """Each quantity as planned, and without; None where it is gone."""
        left = {} if self.left is None else {one.name: one for one in (*self.left.quantities, *self.left.parameters)}
        return [(one, left.get(one.name)) for one in (*self.whole.quantities, *self.whole.parameters)]

    @property
    def useful(self) -> bool:
        """Whether anything stays determined."""
        return any(one is not None and one.level is Level.GOOD for _, one in self.pairs())

    def as_json(self) -> dict[str, Any]:
        """Plain values, SI; no interval where nothing is determined."""
        return {
            "lost": list(self.lost),
            "words": list(self.words),
            "why_nothing": self.why,
            "quantities": [
                {
                    "name": whole.name,
                    "unit": whole.unit,
                    "assumed": whole.value,
                    "sigma": _sigma(whole),
                    "level": str(whole.level),
                    "sigma_without": None if left is None else _sigma(left),
                    "level_without": "gone" if left is None else str(left.level),
                    "why_without": self.why if left is None else left.why,
                }
                for whole, left in self.pairs()
            ],
        }


def _sigma(one: Expected) -> float | None:
    return one.sigma if np.isfinite(one.sigma) and one.why != UNDETERMINED else None


def foresee_without(vehicle: config.Vehicle, plan: MotionPlan, lost: Sequence[str]) -> Contingency:
    """What a planned motion determines with everything, and without what is lost.

    Args:
        vehicle: its file.
        plan: the motion, at the estimator's ticks.
        lost: names of joints or devices, ``cell`` for every load cell, ``pulse``.

    Raises:
        ValueError: a name that is none of these.
        ConfigError, SignalError, EstimationError: the motion with everything determines nothing, as :func:`foresee`.
    """
    words: list[str] = []
    less, parked, why = vehicle, plan, ""
    for name in lost:
        less, parked, said = _without(less, parked, name)
        words.append(said)
    whole = kept(vehicle, plan, lambda: foresee(vehicle, plan))
    left: Foreseen | None = None
    try:
        _require_measured(less)
        left = kept(less, parked, lambda: foresee(less, parked))
    except ValueError as error:  # of configuration, model or estimation: with what is left there is no estimator
        why = str(error)
    return Contingency(tuple(lost), tuple(words), whole, left, why)


def _without(vehicle: config.Vehicle, plan: MotionPlan, name: str) -> tuple[config.Vehicle, MotionPlan, str]:
    """Vehicle and motion without one thing, and what that means in words."""
    roles, devices = roles_of(vehicle), vehicle.file.device
    joints = [joint.name for joint in build_model(vehicle).joints]
    of_device = {role.channel: role.joint for role in roles.joints}
    joint = name if name in joints else of_device.get(name)
    if joint is not None:
        at = joints.index(joint)
        return vehicle, _parked(plan, at), f"{joint} is parked at {np.degrees(plan.q[0, at]):.1f} deg"
    if name in devices and not _is_pulse(vehicle, name):
        less = _less(vehicle, {name})
        before, after = (own.imus[0].channels[0] if own.imus else "" for own in (roles, roles_of(less)))
        instead = f"; {after} measures the base, good to the stated imu_prior" if after and after != before else ""
        return less, plan, f"{name} is not read{instead}"
    cells = {cell.name for cell in roles.cells if isinstance(cell.keys, LoadCellKeys)} & set(devices)
    if name == CELL and cells:
        return _less(vehicle, cells), plan, f"{', '.join(sorted(cells))} is not read"
    if name == PULSE or _is_pulse(vehicle, name):
        less, told = _by_arrival(vehicle)
        return less, plan, f"no pulse: times by arrival, 1 sigma {told or 'as stated, for nothing marks pulses'}"
    known = ", ".join(dict.fromkeys([*joints, *devices, *([CELL] if cells else []), PULSE]))
    raise ValueError(f"--without {name}: there are {known}")


def _parked(plan: MotionPlan, joint: int) -> MotionPlan:
    q, dq, ddq = (np.array(part) for part in (plan.q, plan.dq, plan.ddq))
    q[:, joint], dq[:, joint], ddq[:, joint] = q[0, joint], 0.0, 0.0
    return plan._replace(q=q, dq=dq, ddq=ddq)


def _less(vehicle: config.Vehicle, names: set[str]) -> config.Vehicle:
    kept = {name: device for name, device in vehicle.file.device.items() if name not in names}
    settings = vehicle.file.estimation
    columns = {f"bias_{name}" for name in names}  # that its row had
    absolute = {name: sigma for name, sigma in settings.prior.absolute.items() if name not in columns}
    prior = settings.prior.model_copy(update={"absolute": absolute})
    nuisance = [name for name in settings.nuisance if name not in columns]
    estimation = settings.model_copy(update={"prior": prior, "nuisance": nuisance})
    return vehicle.with_sections(device=kept, estimation=estimation)


def _is_pulse(vehicle: config.Vehicle, name: str) -> bool:
    device = vehicle.file.device.get(name)
    line = None if device is None else device.sync_line(name)
    return line is not None and line.coded


def _by_arrival(vehicle: config.Vehicle) -> tuple[config.Vehicle, str]:
    """The vehicle whose streams with marks are known in time by their arrival, and how well, in words."""
    late = {
        name: 1e-3 * _UNIFORM * getattr(device, "poll_period_ms", 1e3 / vehicle.rate_hz(name))
        for name, device in vehicle.file.device.items()
        if isinstance(device, BusDevice) and type(device).marks is not BusDevice.marks
    }
    settings, devices = vehicle.file.estimation, dict(vehicle.file.device)
    prior, imu_prior = settings.prior, settings.imu_prior
    base_imu = next((name for name, device in devices.items() if isinstance(device, ImuDevice)), None)
    for name, sigma_s in late.items():
        device = devices[name]
        if hasattr(device, "delay_sigma_ms"):
            wider = float(np.hypot(device.delay_sigma_ms, 1e3 * sigma_s))
            devices[name] = device.model_copy(update={"delay_sigma_ms": wider})
        if name == base_imu:
            imu_prior = imu_prior.model_copy(update={"delay_s": float(np.hypot(imu_prior.delay_s, sigma_s))})
    of_joints = {role.joint: late[role.channel] for role in roles_of(vehicle).joints if role.channel in late}
    if of_joints:
        known = {joint: prior.joint.get(joint, JointKeys()) for joint in of_joints}
        wide = {
            joint: one.model_copy(update={"delay_s": float(np.hypot(one.delay_s, of_joints[joint]))})
            for joint, one in known.items()
        }
        prior = prior.model_copy(update={"joint": {**prior.joint, **wide}})
    estimation = settings.model_copy(update={"imu_prior": imu_prior, "prior": prior})
    told = ", ".join(f"{name} {1e3 * sigma_s:.2g} ms" for name, sigma_s in late.items())
    return vehicle.with_sections(device=devices, estimation=estimation), told


def _require_measured(vehicle: config.Vehicle) -> None:
    """Check that a force, and a base which moves, are still measured.

    Raises:
        ValueError: one is not.
    """
    base, roles, settings = vehicle.file.vehicle.base_kind, roles_of(vehicle), vehicle.file.estimation
    imus = roles.imus
    if not settings.predicts and not roles.cells and not settings.base_rows:
        raise ValueError("no load cell, torque or base wrench is left to make a row of")
    if not base.moves:
        return
    if not imus:
        raise ValueError("no IMU is left, and the base moves")
    try:
        build_model(vehicle).pose_in_base(imus[0].frame)
    except UnknownFrameError as error:
        raise ValueError(
            f"{imus[0].frame} is no frame of the base: what is left does not measure its motion"
        ) from error
