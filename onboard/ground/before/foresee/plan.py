"""A planned motion, and what is expected of a vehicle that flies it."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard import config
from onboard.dynamics.kinematics import link_motions, turned
from onboard.dynamics.model.inertia import RigidBody, elements
from onboard.dynamics.model.payload import body_of
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.policy import HALF
from onboard.estimation.smoothing import Response, SmoothingWindow
from onboard.flight.estimate.problem.model import build_model
from onboard.flight.estimate.readings.roles import roles_of
from onboard.flight.estimate.readings.signals import CYCLIC_LEFT, kernel_of
from onboard.identification.quantities import BODY, Findings, QuantityEstimate, Useful, sizes
from onboard.identification.standing import Level, standing
from onboard.regressor.rows import BaseMotion

UNDETERMINED = "not determined"
_MOST_TICKS = 20_000  # of which a long motion's rates are taken
_IN_KERNEL, _APART_S = 5, 0.05  # ticks in its width at least, time between two at most
_FEW_ANGLE = 0.03  # of the largest rms rate: about such an axis a link hardly turns


class MotionPlan(NamedTuple):
    """A motion on even ticks, the joints in the order of the model."""

    time_s: FloatArray  # (n,)
    q: FloatArray  # (n, joints)
    dq: FloatArray
    ddq: FloatArray
    phase: NDArray[np.intp]  # (n,)
    held: BoolArray  # (n,) the payload is
    bases: tuple[BaseMotion, ...]  # of a prescribed base: motions that it may make, all as likely
    rate_rad_s: FloatArray  # (3,) of a floating base at the start
    velocity_m_s: FloatArray  # (3,)
    payload: RigidBody | None  # assumed, in its link's frame
    drag: tuple[float, float] = (0.0, 0.0)  # of each puck: N s/m, N

    def part(self, ticks: slice) -> "MotionPlan":
        """Some of the ticks; the base's start is that of all."""
        bases = tuple(BaseMotion(*(signal[ticks] for signal in base)) for base in self.bases)
        kept = {name: getattr(self, name)[ticks] for name in ("time_s", "q", "dq", "ddq", "phase", "held")}
        return self._replace(**kept, bases=bases)

    def moved(self, ticks: slice, motion: FloatArray) -> "MotionPlan":
        """With other angles, rates and accelerations, (3, m, joints), at some of the ticks."""
        signals = np.stack([self.q, self.dq, self.ddq])
        signals[:, ticks] = motion
        return self._replace(q=signals[0], dq=signals[1], ddq=signals[2])

    def few(self, vehicle: config.Vehicle) -> slice:
        """Ticks that tell as much as all where nothing is drawn: all change as slowly as the smoothed motion."""
        apart_s = min(vehicle.file.estimation.smoothing_ms * 1e-3 / _IN_KERNEL, _APART_S)
        return slice(None, None, max(1, int(apart_s / float(self.time_s[1] - self.time_s[0]))))

    def by_base(self) -> "tuple[MotionPlan, ...]":
        """The plan with each of its base's motions alone; itself where it has none or one."""
        return tuple(self._replace(bases=(base,)) for base in self.bases) or (self,)

    def used(self, vehicle: config.Vehicle) -> BoolArray:
        """Ticks in the phases that are identified, (n,)."""
        phases = vehicle.file.estimation.phases
        if phases is None:
            return np.ones(len(self.time_s), np.bool_)
        return np.isin(self.phase, phases.identify)


def plan_of(vehicle: config.Vehicle, planned: Any) -> MotionPlan:
    """A plan in the terms of a vehicle's model.

    Args:
        vehicle: its file.
        planned: by the simulator: the fields of a plan, its columns named by ``joints``, its payload as a body, and
            ``drawn_shape``: whether that has the shape of its link in the URDF, where there is one.

    Raises:
        ConfigError: the plan's joints are not the URDF's.
    """
    model = build_model(vehicle)
    names = [joint.name for joint in model.joints]
    if sorted(names) != sorted(planned.joints):
        raise config.ConfigError(f"the motion is of {', '.join(planned.joints)}, the vehicle has {', '.join(names)}")
    order = [planned.joints.index(name) for name in names]
    payload = None
    if planned.payload is not None:
        shape = RigidBody(planned.payload.mass_kg, planned.payload.centre_of_mass_m, planned.payload.inertia_kg_m2)
        payload = _payload(model, shape, drawn_shape=planned.drawn_shape)
    q, dq, ddq = (signal[:, order] for signal in (planned.q, planned.dq, planned.ddq))
    bases, start = tuple(BaseMotion(*base) for base in planned.bases), (planned.rate_rad_s, planned.velocity_m_s)
    return MotionPlan(planned.time_s, q, dq, ddq, planned.phase, planned.held, bases, *start, payload, planned.drag)


class Expected(NamedTuple):
    """A quantity before the flight."""

    name: str
    unit: str
    value: float  # assumed
    sigma: float  # expected, 1 sigma
    level: Level  # weak: the motion does not determine it, or too wide for its size
    why: str = ""


class Foreseen(NamedTuple):
    """What a motion determines.

    Attributes:
        quantities: those that are answered as numbers with units.
        parameters: base parameters of rows, and drag.
        payload: assumed; None where nothing is held.
        span_s: time of the motion that is used, payload held.
        words: why something is weak, as far as the motion shows it.
    """

    quantities: tuple[Expected, ...]
    parameters: tuple[Expected, ...]
    payload: RigidBody | None
    span_s: float
    words: tuple[str, ...]

    @property
    def answers(self) -> tuple[Expected, ...]:
        """The quantities, or where there are none the base parameters."""
        return self.quantities or self.parameters


def expected(
    answers: Sequence[QuantityEstimate], values: Mapping[str, float], sigmas: Iterable[float], useful: Useful
) -> list[Expected]:
    """Quantities by the rules of the flight: weak where one is not supported, or too wide for its size.

    Args:
        answers: of the estimator along the plan.
        values: assumed, in place of their means, by name.
        sigmas: expected, also of one that is not supported.
        useful: how narrow an interval is that is good.
    """
    quantities = list[Expected]()
    estimates = [
        answer._replace(value=mean, sigma=s, low=mean - HALF * s, high=mean + HALF * s)
        for answer, s, mean in zip(answers, sigmas, [values[answer.name] for answer in answers], strict=True)
    ]
    size = sizes(estimates, useful)
    for estimate in estimates:
        said = standing(estimate, Findings(), size.get(estimate.name))
        why = said.why if estimate.supported else UNDETERMINED
        quantities.append(Expected(*estimate[:4], said.level, why if said.level is Level.WEAK else ""))
    return quantities


def body_values(model: VehicleModel, body: RigidBody | None) -> dict[str, float]:
    """The ten numbers of a payload by the names of the answers; none without one."""
    if body is None:
        return {}
    names = [f"{kind}_{model.spec.payload_link}" for kind in BODY]
    values = [body.mass_kg, *body.centre_of_mass_m.tolist(), *elements(body.inertia_kg_m2).tolist()]
    return dict(zip(names, values, strict=True))


def steady_noise(vehicle: config.Vehicle, channel: str, derivatives: int) -> FloatArray:
    """Noise of a channel smoothed at its nominal rate, and of its derivatives, (derivatives + 1, columns)."""
    signal = roles_of(vehicle).signals[channel]
    width_s = vehicle.file.estimation.smoothing_ms * 1e-3
    reach = int(width_s / signal.period_s) + 2
    times_s = signal.period_s * np.arange(-reach, reach + 1, dtype=np.float64)
    window = SmoothingWindow(times_s, [0.0], width_s, 3.5 * signal.period_s, kernel_of(vehicle))
    noise = np.array(signal.noise)
    return np.stack([window.apply(np.zeros(len(times_s)), k).noise_gain[0] * noise for k in range(derivatives + 1)])


class MotionNoise:
    """Noise of smoothed angles, rates and accelerations of the joints, and what their cyclic errors do.

    Args:
        vehicle: its file.
        model: of it.
    """

    def __init__(self, vehicle: config.Vehicle, model: VehicleModel) -> None:
        roles = roles_of(vehicle)
        self._response = Response(vehicle.file.estimation.smoothing_ms * 1e-3, kernel_of(vehicle))
        by_name = {joint.joint: joint for joint in roles.joints}
        self._steady = np.zeros((3, len(model.joints)))
        self._ripple: list[tuple[int, int, float, float]] = []  # column, lowest order, periods per rad, rms
        for column, joint in enumerate(model.joints):
            role = by_name[joint.name]
            lowest = int(role.is_rate)
            self._steady[lowest:, column] = steady_noise(vehicle, role.channel, 2 - lowest)[:, 0]
            self._ripple += [(column, lowest, *one) for one in roles.signals[role.channel].ripple]

    def at(self, dq: FloatArray) -> FloatArray:
        """At rates (n, joints): (3, n, joints), one sigma."""
        out = np.repeat(self._steady[:, None, :], len(dq), axis=1)
        for column, lowest, periods, rms in self._ripple:
            for order in range(lowest, 3):
                passed = CYCLIC_LEFT * rms * self._response.gain(periods * dq[:, column], order - lowest)
                out[order, :, column] = np.hypot(out[order, :, column], passed)
        return out

    def of_samples(self, dq: FloatArray) -> FloatArray:
        """Share of the squares of :meth:`at` that is of independent samples, (3, n, joints)."""
        steady, whole = self._steady[:, None, :] ** 2, self.at(dq) ** 2
        return np.divide(np.broadcast_to(steady, whole.shape), whole, out=np.ones_like(whole), where=whole > 0.0)

    def cyclic(self, q: FloatArray, dq: FloatArray) -> FloatArray:
        """Cosine and sine of each cyclic error and two derivatives as smoothed at a steady rate, (n, 3, 2 x errors).

        Args:
            q: joint positions, (n, joints).
            dq: joint rates.
        """
        out = np.zeros((len(q), 3, 2 * len(self._ripple)))
        for k, (column, _, periods, _) in enumerate(self._ripple):
            turn, rate = periods * q[:, column], periods * dq[:, column]
            for order in range(3):
                passed = self._response.gain(rate, order) * np.sign(rate) ** order
                ahead = turn + 0.5 * np.pi * order  # a derivative leads by a quarter turn
                out[:, order, 2 * k], out[:, order, 2 * k + 1] = passed * np.cos(ahead), passed * np.sin(ahead)
        return out


def _payload(model: VehicleModel, shape: RigidBody, *, drawn_shape: bool) -> RigidBody:
    """The payload that is assumed: as its link is drawn, at another density; ``shape`` where it is not drawn."""
    drawn = model.chi[model.payload_columns()]
    if not (drawn_shape and drawn.size and drawn[0] > 0.0):
        return shape
    _, centre_m, inertia = body_of(drawn)
    return RigidBody(shape.mass_kg, centre_m, inertia * shape.mass_kg / float(drawn[0]))


def axes_words(model: VehicleModel, plan: MotionPlan, base_rate: FloatArray, used: BoolArray) -> tuple[str, ...]:
    """About which axes of its link the payload hardly turns, in words.

    Args:
        model: with a payload link.
        plan: the motion.
        base_rate: of the base, its axes, (n, 3).
        used: (n,).
    """
    payload = model.spec.payload_link
    if payload is None or not used.any():
        return ()
    some = np.flatnonzero(used)[:: 1 + len(used) // _MOST_TICKS]
    link = link_motions(model, plan.q[some], plan.dq[some], plan.ddq[some])[model.links.index(payload)]
    rate = turned(np.swapaxes(link.R, 1, 2), base_rate[some] + link.w)  # link axes
    rms = np.sqrt(np.mean(rate**2, axis=0))
    if rms.max() == 0.0:
        return (f"{payload} does not turn at all",)
    still = [axis for axis, size in zip("xyz", rms, strict=True) if size < _FEW_ANGLE * rms.max()]
    if not still:
        return ()
    said = f"{payload} hardly turns about {' and '.join(still)} of its link: what only such a motion shows stays weak"
    return (said,)
