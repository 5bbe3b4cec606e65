"""Bound of base parameters by rows: the identifier that flies takes in the rows of the planned motion.

Rows ``y = Y chi`` are made by the vehicle's regressor at nominal parameters and go to a fresh identifier with the
sigmas that the stated noise has behind the smoothing kernel. None is drawn: what it does to the regressor is taken in
as its mean, and what is reported is the formal covariance, with prior and considered calibrations in it.

Where rows are filtered (:mod:`onboard.identification.rows.stated_errors.whitening`) all ticks are taken, or, coarse,
those given stand for the many that fit between them: their noise is white, smaller by that number, and without what
differentiated samples add.
"""

import copy
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from onboard import config
from onboard.devices.roles import TorqueKeys
from onboard.dynamics.free_flight import predict_base_from_rate
from onboard.dynamics.kinematics import link_motions
from onboard.dynamics.model.payload import standard_of
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.arrays import FloatArray
from onboard.estimation.gates import GateReason, reasons
from onboard.estimation.smoothing import correlation_inflation
from onboard.flight.estimate.answers import useful_of
from onboard.flight.estimate.problem.identification import build_identifier
from onboard.flight.estimate.readings.roles import roles_of
from onboard.flight.estimate.readings.signals import kernel_of
from onboard.ground.before.foresee.plan import (
    UNDETERMINED,
    Expected,
    Foreseen,
    MotionNoise,
    MotionPlan,
    axes_words,
    body_values,
    expected,
    steady_noise,
)
from onboard.identification.rows.identifier import Identifier
from onboard.identification.standing import Level
from onboard.regressor.friction import CoulombFriction
from onboard.regressor.rows import BaseMotion, standing
from onboard.regressor.signals import OfSamples, SignalNoise, Signals, noise_of_joints, orders_of

_MOST_TICKS = 20_000  # whose rows are made at a time: 0.2 GB
_FINE = 20  # steps in a kernel's width, of which coarse ticks stand for as many as fit


def foresee_rows(vehicle: config.Vehicle, plans: Sequence[MotionPlan], *, coarse: bool = False) -> list[Foreseen]:
    """Expected intervals of base parameters and quantities of a vehicle whose method is rows.

    Args:
        vehicle: its file.
        plans: motions at the same ticks, those of the estimator; of a prescribed base the first of its motions.
        coarse: at fewer, each for as many.

    Raises:
        ConfigError: the estimation section does not fit the URDF or the devices.
        SignalError: a motion with which the rows cannot be made.
    """
    fresh, model = build_identifier(vehicle)
    period_s = float(plans[0].time_s[1] - plans[0].time_s[0])
    few = plans[0].few(vehicle) if fresh.whitening is None else slice(None)
    noise = StatedNoise(vehicle, fresh, period_s * (few.step or 1), coarse=coarse)
    # the model does not change: it is shared
    each = [copy.deepcopy(fresh, {id(fresh.model): fresh.model}) for _ in plans[1:]]
    return [_foresee(vehicle, plan, few, who, model, noise) for plan, who in zip(plans, [fresh, *each], strict=True)]


def _foresee(
    vehicle: config.Vehicle,
    plan: MotionPlan,
    few: slice,
    identifier: Identifier,
    model: VehicleModel,
    noise: "StatedNoise",
) -> Foreseen:
    """Of one motion, at some of its ticks, by an identifier that has no rows yet."""
    chi = identifier.model.chi.copy()
    if plan.payload is not None:
        chi[model.payload_columns()] = standard_of(plan.payload)
    motion = BaseMotion(*(signal[few] for signal in _base_motion(model, plan, chi)))
    plan = plan.part(few)
    excluded = reasons(~plan.used(vehicle), GateReason.PHASE)
    edges = np.linspace(0, len(excluded), 1 + -(-len(excluded) // _MOST_TICKS)).astype(np.intp)
    for first, last in pairwise(edges.tolist()):
        part = slice(first, last)
        own = BaseMotion(*(signal[part] for signal in motion))
        identifier.update(noise.signals(plan.part(part), own, chi), plan.held[part], excluded[part])
    identifier.recursion.expect_noise()
    found = identifier.stated_estimate()
    beta = identifier.base.value(chi)
    at = {quantity.name: float(quantity.weights @ beta) for quantity in identifier.quantities}
    at |= body_values(model, plan.payload)
    quantities = expected(found.quantities, at, [one.sigma for one in found.quantities], useful_of(vehicle))
    hidden = set(vehicle.file.estimation.nuisance)
    each = zip(found.names, beta.tolist(), found.sigma.tolist(), found.supported.tolist(), strict=True)
    parameters = [
        Expected(name, "", value, sigma, Level.GOOD if fine else Level.WEAK, "" if fine else UNDETERMINED)
        for name, value, sigma, fine in each
        if name not in hidden
    ]
    used = excluded == 0
    words = axes_words(model, plan, motion.rate_rad_s, used & plan.held)
    return Foreseen(tuple(quantities), tuple(parameters), plan.payload, float(used.sum() * noise.period_s), words)


def _base_motion(model: VehicleModel, plan: MotionPlan, chi: FloatArray) -> BaseMotion:
    """What the base does: as planned, nothing, or what the joints make of a free one."""
    if plan.bases:
        return plan.bases[0]
    n = len(plan.time_s)
    if not model.spec.base.falls:
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


class StatedNoise:
    """Noise that the instruments of a vehicle have behind the smoothing kernel.

    Args:
        vehicle: its file.
        identifier: of its rows.
        period_s: of the ticks.
        coarse: filtered rows of a tick stand for as many as fit between it and the next.

    Attributes:
        period_s: as given.
    """

    def __init__(self, vehicle: config.Vehicle, identifier: Identifier, period_s: float, *, coarse: bool) -> None:
        self._vehicle, self._identifier, self.period_s = vehicle, identifier, period_s
        self._coarse, self._filtered = coarse, identifier.whitening is not None
        roles, of_vehicle = roles_of(vehicle), identifier.model.vehicle
        self._joints = MotionNoise(vehicle, of_vehicle)
        self._of_base = np.stack(_imu_noise(vehicle)) if roles.imus else np.zeros((3, 3))
        by_joint = {joint.joint: joint.is_rate for joint in roles.joints}
        self._orders = orders_of([by_joint[joint.name] for joint in of_vehicle.joints])
        width_s, kernel = vehicle.file.estimation.smoothing_ms * 1e-3, kernel_of(vehicle)
        self._inflation = correlation_inflation(width_s, period_s, kernel)
        if coarse and self._filtered:
            fine_s = width_s / _FINE
            self._inflation = correlation_inflation(width_s, fine_s, kernel) * float(np.sqrt(fine_s / period_s))

    def signals(self, plan: MotionPlan, motion: BaseMotion, chi: FloatArray) -> Signals:
        """Smoothed signals of a motion, with the sigmas of what the instruments would add to them, and without that."""
        row_model, n = self._identifier.model, len(plan.time_s)
        names = [joint.name for joint in row_model.vehicle.joints]
        friction = CoulombFriction(row_model.motors, names).follow(plan.q, plan.dq) if row_model.motors else None
        flowing = None if friction is None else np.nan_to_num(friction)
        motions = plan.q, plan.dq, plan.ddq, motion, plan.held
        true = row_model.regressor(*motions, fill_zero_force=False, friction=flowing) @ chi
        sigma, refused = _of_rows(self._vehicle, self._identifier, plan, friction)
        stated = noise_of_joints(self._joints.at(plan.dq), plan.dq, plan.ddq)
        sources = np.hstack([*stated, *(np.broadcast_to(part, (n, 3)) for part in self._of_base)])  # (n, 3 joints + 9)
        share = np.hstack([*self._joints.of_samples(plan.dq), np.ones((n, 9))])
        if self._coarse and self._filtered:
            sources = sources * np.where(self._orders > 0, np.sqrt(1.0 - share), 1.0)
        q, dq, ddq, *of_motion = np.split(sources, np.cumsum([len(names)] * 3 + [3] * 2), axis=1)
        own = None if self._coarse else OfSamples(share, self._orders)
        noise = SignalNoise(q, dq, ddq, of_motion[0], of_motion[1], of_motion[2], self._inflation, own)
        return Signals(
            *(plan.time_s, plan.q, plan.dq, plan.ddq, motion),
            *(true, sigma * self._inflation, np.gradient(true, self.period_s, axis=0)),
            *(noise, flowing, refused if refused.any() else None),
            cyclic=self._joints.cyclic(plan.q, plan.dq),
        )


def _imu_noise(vehicle: config.Vehicle) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of the base's rate, angular acceleration and specific force, smoothed, IMU axes, (3,) each."""
    found = np.concatenate([steady_noise(vehicle, channel, 1) for channel in roles_of(vehicle).imu.channels], axis=1)
    return found[0, :3], found[1, :3], found[0, 3:]


def _of_rows(
    vehicle: config.Vehicle, identifier: Identifier, plan: MotionPlan, friction: FloatArray | None
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
