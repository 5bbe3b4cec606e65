"""Bound of base parameters by rows: the identifier that flies takes in the rows of the planned motion.

Rows ``y = Y chi`` are made by the vehicle's own regressor at nominal parameters, with noise of the stated sigmas behind
the smoothing kernel on every signal, and go to a fresh identifier. What it then reports as sigma has noise, regressor
noise, prior and considered calibrations in it; the draw of the noise moves the values, which are not used, and hardly
the sigmas.

Where rows are filtered (:mod:`onboard.identification.rows.whitening`), coarse ticks stand for the many that fit between
them: their noise is white, smaller by that number, and without what differentiated samples add.
"""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from onboard import config
from onboard.devices.roles import TorqueKeys
from onboard.dynamics.free_flight import predict_base_from_rate
from onboard.dynamics.kinematics import link_motions
from onboard.dynamics.payload import standard_of
from onboard.dynamics.vehicle import BaseKind, VehicleModel
from onboard.estimation.arrays import FloatArray
from onboard.estimation.gates import GateReason, reasons
from onboard.estimation.smoothing import Kernel, SmoothingWindow, correlation_inflation
from onboard.flight.estimate.answers import useful_of
from onboard.flight.estimate.identification import build_identifier
from onboard.flight.estimate.roles import roles_of
from onboard.flight.estimate.signals import kernel_of
from onboard.identification.rows.identifier import Identifier
from onboard.identification.verdict import Level
from onboard.offline.foresee.plan import (
    UNDETERMINED,
    Expected,
    Foreseen,
    JointNoise,
    Plan,
    axes_words,
    body_values,
    expected,
    steady_noise,
)
from onboard.regressor.friction import CoulombFriction
from onboard.regressor.rows import BaseMotion, standing
from onboard.regressor.signals import OfSamples, SignalNoise, Signals, noise_of_joints, orders_of

_SEED = 1
_MOST_TICKS = 20_000  # whose rows are made at a time: 0.2 GB
_FINE = 20  # steps, or more, in a kernel's width


def foresee_rows(
    vehicle: config.Vehicle, plan: Plan, *, coarse: bool = False, drawn: "dict[bytes, Noises] | None" = None
) -> Foreseen:
    """Expected intervals of base parameters and quantities of a vehicle whose method is rows.

    Args:
        vehicle: its file.
        plan: the motion, at the estimator's ticks; of a prescribed base the first of its motions.
        coarse: at fewer, each for as many.
        drawn: noise that other motions of the same base were given, by its times; more is put there.

    Raises:
        ConfigError: the estimation section does not fit the URDF or the devices.
        SignalError: a motion with which the rows cannot be made.
    """
    identifier, model = build_identifier(vehicle)
    row_model = identifier.model
    chi = row_model.chi.copy()
    if plan.payload is not None:
        chi[model.payload_columns()] = standard_of(plan.payload)
    motion = _base_motion(model, plan, chi)
    excluded = reasons(~plan.used(vehicle), GateReason.PHASE)
    edges = np.linspace(0, len(excluded), 1 + -(-len(excluded) // _MOST_TICKS)).astype(np.intp)
    for first, last in pairwise(edges.tolist()):
        part = slice(first, last)
        own = BaseMotion(*(signal[part] for signal in motion))
        signals = _signals(vehicle, identifier, plan.part(part), own, chi, coarse=coarse, drawn=drawn)
        identifier.update(signals, plan.held[part], excluded[part])
    found = identifier.stated_estimate()  # nothing is suspected of readings that were made up
    beta = identifier.base.value(chi)
    at = {quantity.name: float(quantity.weights @ beta) for quantity in identifier.quantities}
    at |= body_values(model, plan.payload)
    quantities = expected(found.quantities, at, [one.sigma for one in found.quantities], useful_of(vehicle))
    hidden = set(vehicle.file.estimation.nuisance)
    parameters = [
        Expected(name, "", value, sigma, Level.GOOD if fine else Level.WEAK, "" if fine else UNDETERMINED)
        for name, value, sigma, fine in zip(
            found.names, beta.tolist(), found.sigma.tolist(), found.supported.tolist(), strict=True
        )
        if name not in hidden
    ]
    used = excluded == 0
    words = axes_words(model, plan, motion.rate_rad_s, used & plan.held)
    period_s = 1.0 / vehicle.file.estimation.row_rate_hz
    return Foreseen(tuple(quantities), tuple(parameters), plan.payload, float(used.sum() * period_s), words)


def _base_motion(model: VehicleModel, plan: Plan, chi: FloatArray) -> BaseMotion:
    """What the base does: as planned, nothing, or what the joints make of a free one."""
    if plan.bases:
        return plan.bases[0]
    n = len(plan.time_s)
    if model.spec.base is not BaseKind.FREE:
        return standing(model, n)
    period_s, rate = float(plan.time_s[1] - plan.time_s[0]), plan.rate_rad_s
    parts, edges = [], [0, *(np.flatnonzero(np.diff(plan.held)) + 1), n]
    for first, last in pairwise(edges):
        part = slice(first, last)
        own = chi[: model.chi.size].copy()
        if not plan.held[first]:
            own[model.payload_columns()] = 0.0
        links = link_motions(model, plan.q[part], plan.dq[part], plan.ddq[part])
        base = predict_base_from_rate(links, period_s, own, rate, ())
        parts.append(BaseMotion(base.rate, base.acceleration, base.specific_force))
        rate = base.rate[-1]
    return BaseMotion(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def _signals(
    vehicle: config.Vehicle,
    identifier: Identifier,
    plan: Plan,
    motion: BaseMotion,
    chi: FloatArray,
    *,
    coarse: bool,
    drawn: "dict[bytes, Noises] | None" = None,
) -> Signals:
    """Smoothed signals of the motion as the estimator makes them of noisy instruments."""
    settings, roles, n = vehicle.file.estimation, roles_of(vehicle), len(plan.time_s)
    row_model, width_s, period_s = identifier.model, settings.smoothing_ms * 1e-3, 1.0 / settings.row_rate_hz
    filtered = identifier.whitening is not None
    drawn = {} if drawn is None else drawn
    if (key := plan.time_s.tobytes()) not in drawn:
        drawn[key] = Noises(plan.time_s, width_s, kernel_of(vehicle), coarse=coarse and filtered)
    noises = drawn[key]
    names = [joint.name for joint in row_model.vehicle.joints]
    friction = CoulombFriction(row_model.motors, names).follow(plan.q, plan.dq) if row_model.motors else None
    flowing = None if friction is None else np.nan_to_num(friction)
    zero = np.zeros((n, len(row_model.rows)))
    motions = plan.q, plan.dq, plan.ddq, motion, plan.held
    true = row_model.regressor(*motions, fill_zero_force=False, predicted=zero, friction=flowing) @ chi  # it is zero
    sigma, refused = _of_rows(vehicle, identifier, plan, friction)
    joint_noise = JointNoise(vehicle, row_model.vehicle)
    stated = noise_of_joints(joint_noise.at(plan.dq), plan.dq, plan.ddq)
    of_base = np.stack(_imu_noise(vehicle)) if roles.imus else np.zeros((3, 3))
    sources = np.hstack([*stated, *(np.broadcast_to(part, (n, 3)) for part in of_base)])  # (n, 3 joints + 9)
    by_joint = {joint.joint: joint.is_rate for joint in roles.joints}
    orders = orders_of([by_joint[name] for name in names])
    share = np.hstack([*joint_noise.of_samples(plan.dq), np.ones((n, 9))])
    if coarse and filtered:
        sources = sources * np.where(orders > 0, np.sqrt(1.0 - share), 1.0)
    ends = np.cumsum([len(names)] * 3 + [3] * 2)
    errors = np.split(sources * noises.of(0, orders), ends, axis=1)
    q_sigma, dq_sigma, ddq_sigma, *of_motion = np.split(sources, ends, axis=1)
    q, dq, ddq, *shaken = (
        signal + part for signal, part in zip((plan.q, plan.dq, plan.ddq, *motion), errors, strict=True)
    )
    measured = true + sigma * noises.of(1, np.zeros(true.shape[1], np.intp))
    own = None if coarse else OfSamples(share, orders)
    return Signals(
        *(plan.time_s, q, dq, ddq, BaseMotion(*shaken)),
        *(measured, sigma * noises.inflation, np.gradient(true, period_s, axis=0)),
        SignalNoise(q_sigma, dq_sigma, ddq_sigma, of_motion[0], of_motion[1], of_motion[2], noises.inflation, own),
        flowing,
        refused if refused.any() else None,
    )


class Noises:
    """Noise of unit variance behind the smoothing kernel, drawn once.

    Args:
        time_s: of the ticks.
        width_s: of the kernel.
        kernel: it.
        coarse: white, each tick for as many as fit between it and the next.

    Attributes:
        inflation: of the sigmas, for the correlation of neighbouring ticks.
    """

    def __init__(self, time_s: FloatArray, width_s: float, kernel: Kernel, *, coarse: bool) -> None:
        self._rng, self._count = np.random.default_rng(_SEED), len(time_s)
        self._drawn: list[FloatArray] = []
        period_s = float(time_s[1] - time_s[0])
        self._window: SmoothingWindow | None = None
        if coarse:
            fine_s = width_s / _FINE
            self.inflation = correlation_inflation(width_s, fine_s, kernel) * float(np.sqrt(fine_s / period_s))
            return
        self.inflation = correlation_inflation(width_s, period_s, kernel)
        steps_s = min(period_s, width_s / _FINE)
        self._times_s = np.arange(time_s[0] - width_s, time_s[-1] + width_s, steps_s)
        self._window = SmoothingWindow(self._times_s, time_s, width_s, kernel=kernel)

    def of(self, number: int, orders: NDArray[np.intp]) -> FloatArray:
        """The draw of this number, of sources whose samples were differentiated so often, (k,): (n, k)."""
        if number == len(self._drawn):
            self._drawn.append(self._draw(orders))
        return self._drawn[number]

    def _draw(self, orders: NDArray[np.intp]) -> FloatArray:
        if self._window is None:
            return self.inflation * self._rng.standard_normal((self._count, len(orders)))
        found = self._window.derivatives(self._rng.standard_normal((len(self._times_s), len(orders))), range(3))
        unit = np.stack([one.values / one.noise_gain[:, None] for one in found])  # (3, n, k)
        return np.asarray(np.choose(orders, unit), np.float64)


def _imu_noise(vehicle: config.Vehicle) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of the base's rate, angular acceleration and specific force, smoothed, IMU axes, (3,) each."""
    found = np.concatenate([steady_noise(vehicle, channel, 1) for channel in roles_of(vehicle).imu.channels], axis=1)
    return found[0, :3], found[1, :3], found[0, 3:]


def _of_rows(
    vehicle: config.Vehicle, identifier: Identifier, plan: Plan, friction: FloatArray | None
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Sigma of each row before inflation, and which rows are refused, (n, rows) each."""
    settings, cells = vehicle.file.estimation, {cell.name: cell for cell in roles_of(vehicle).cells}
    vehicle_model = identifier.model.vehicle
    names = [joint.name for joint in vehicle_model.joints]
    sigma = np.zeros((len(plan.time_s), len(identifier.row_names)))
    refused = np.zeros(sigma.shape, np.int64)
    for column, row in enumerate(identifier.row_names):
        if row not in cells:
            force = row.startswith("base_force")
            sigma[:, column] = settings.base_force_sigma_N if force else settings.base_moment_sigma_N_m
            continue
        keys = cells[row].keys
        if isinstance(keys, TorqueKeys):
            sigma[:, column] = keys.sigma_N_m
            still = np.abs(plan.dq[:, names.index(keys.joint)]) < keys.still_rad_s
            if friction is not None:
                still |= np.isnan(friction).any(axis=1)
            refused[:, column] |= reasons(still, GateReason.STILL)
        else:
            sigma[:, column] = steady_noise(vehicle, cells[row].channel, 0)[0, 0]
    return sigma, refused
