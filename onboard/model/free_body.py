"""Free-body identification from recorded signals: a thrown device with a spinning wheel says what it is strapped to.

The same kernel, rows and estimator as in flight: both sides of every row through one smoothing kernel, base wrench rows
with nothing on the left side, square-root RLS with a prior. What is special is only the preparation (a recording in SI
units, already on one clock) and what is read off: a rigid body, and what remains of it without the known carrier.

Mass is not observable in free fall, and neither is the scale of the inertia but for the wheel: masses are weighed, the
wheel's inertia is calibrated (:func:`calibrate_rotor`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.estimation.gates import GateReason, ReasonArray, range_gate, reasons
from onboard.estimation.smoothing import correlation_inflation, smooth
from onboard.model.base_parameters import BaseParameters, base_parameters, named_relative_sigma
from onboard.model.composite import (
    RigidBody,
    composite_functional,
    elements,
    parallel_axis,
    principal_moments,
    symmetric,
    take_away,
)
from onboard.model.errors import SignalError
from onboard.model.identify import Identifier, Quantity, SignalNoise, Signals
from onboard.model.rows import RowModel, base_force_rows, base_moment_rows, base_motion
from onboard.model.vehicle import Vehicle

FloatArray = NDArray[np.float64]

_NAMING_SEED = 0
# All rows are zero on the left, so something must set the scale, or the least squares would shrink everything towards
# nothing: the mass does for the force rows, the rotors for the moment rows. Their own uncertainty is added at the end.
_EXACT = 1e-6


class Recording(NamedTuple):
    """One throw, SI units, one clock."""

    imu_s: FloatArray  # (k,) sample times
    rate_rad_s: FloatArray  # (k, 3) IMU axes
    specific_force_m_s2: FloatArray  # (k, 3) IMU axes
    joint_s: FloatArray  # (j,)
    joint_rate_rad_s: FloatArray  # (j, joints)


@dataclass(frozen=True, slots=True)
class FreeBodySettings:
    """How a free body's recordings are used."""

    imu_frame: str
    width_s: float = 0.1  # of the smoothing kernel
    row_period_s: float = 0.005
    minimum_joint_rate_rad_s: float = 100.0  # the body flies, and its wheel runs, from here on
    gyro_noise_rad_s: float = 0.02  # per sample, vibration included
    accel_noise_m_s2: float = 1.0
    joint_rate_noise_rad_s: float = 5.0
    max_gap_s: float = 0.005
    force_sigma_n: float = 0.1  # of a base force row, what is left of it when the motion is known: misalignment, drag
    moment_sigma_n_m: float = 5e-4
    base_sigma: float = 3.0  # relative, of the base's prior: nothing is known but the order of magnitude
    rotor_sigma: float = 0.005  # relative, of the rotors' calibration


class BodyEstimate(NamedTuple):
    """A whole vehicle as a rigid body with its wheel locked, and the covariance of ``[c (3), I (6)]``."""

    body: RigidBody
    covariance: FloatArray  # (9, 9)
    rows_used: int
    refused: dict[GateReason, int]


class FreeBodyIdentifier:
    """Identifies a free body with balanced rotors from any number of recordings.

    Args:
        vehicle: with base kind ``free``.
        settings: see there.

    Raises:
        SignalError: a vehicle whose joints move its centre of mass.
    """

    def __init__(self, vehicle: Vehicle, settings: FreeBodySettings) -> None:
        if not vehicle.centre_of_mass_is_fixed():
            raise SignalError("a joint moves this vehicle's centre of mass; only balanced rotors can be used here")
        self.vehicle = vehicle
        self.settings = settings
        self.model = RowModel(vehicle, (*base_force_rows(vehicle), *base_moment_rows(vehicle)))
        self.base: BaseParameters = base_parameters(self.model, np.random.default_rng(_NAMING_SEED))
        names = ("M", "MX", "MY", "MZ", "XX", "XY", "YY", "XZ", "YZ", "ZZ")
        functional = composite_functional(vehicle)
        self.quantities = tuple(
            Quantity(name, "", self.base.weights(row)) for name, row in zip(names, functional, strict=True)
        )
        base_link = vehicle.spec.base_link
        relative = {link: settings.base_sigma if link == base_link else _EXACT for link in vehicle.links}
        mass = vehicle.chi[10 * vehicle.links.index(base_link)]
        self._prior_sigma = named_relative_sigma(self.model, relative, {f"M_{base_link}": _EXACT * mass})

    def identifier(self) -> Identifier:
        """A fresh estimator, at the prior."""
        return Identifier(
            self.model,
            self.base,
            self._prior_sigma,
            5.0 * self.settings.width_s,
            self.quantities,
            imu_frame=self.settings.imu_frame,
        )

    def signals(self, recording: Recording) -> tuple[Signals, ReasonArray]:
        """Smoothed signals of a recording at every row time, and the reasons not to use some.

        Raises:
            SignalError: shapes that do not fit the vehicle.
        """
        s, nj = self.settings, len(self.vehicle.joints)
        if recording.joint_rate_rad_s.shape != (recording.joint_s.size, nj):
            raise SignalError(f"joint rates of shape {recording.joint_rate_rad_s.shape}; give one column a joint, {nj}")
        at = np.arange(recording.imu_s[0], recording.imu_s[-1], s.row_period_s)
        n = at.size

        def smoothed(times: FloatArray, values: FloatArray, derivative: int) -> tuple[FloatArray, FloatArray]:
            result = smooth(times, values, at, s.width_s, derivative, s.max_gap_s)
            return result.values, result.noise_gain[:, None]

        w, gain = smoothed(recording.imu_s, recording.rate_rad_s, 0)
        dw, gain_1 = smoothed(recording.imu_s, recording.rate_rad_s, 1)
        f, _ = smoothed(recording.imu_s, recording.specific_force_m_s2, 0)
        dq, joint_gain = smoothed(recording.joint_s, recording.joint_rate_rad_s, 0)
        ddq, joint_gain_1 = smoothed(recording.joint_s, recording.joint_rate_rad_s, 1)
        ones, joints = np.ones((n, 3)), np.ones((n, nj))
        noise = SignalNoise(
            0.0 * joints,  # a body of revolution: its angle is of no account
            joint_gain * s.joint_rate_noise_rad_s * joints,
            joint_gain_1 * s.joint_rate_noise_rad_s * joints,
            gain * s.gyro_noise_rad_s * ones,
            gain_1 * s.gyro_noise_rad_s * ones,
            gain * s.accel_noise_m_s2 * ones,
            correlation_inflation(s.width_s, s.row_period_s),
        )
        valid = np.isfinite(w).all(axis=1) & np.isfinite(dq).all(axis=1)
        refused = reasons(~valid, GateReason.GAP)
        refused |= range_gate(np.abs(dq), s.minimum_joint_rate_rad_s, np.inf, GateReason.PHASE)
        nothing = np.zeros((n, len(self.model.rows)))
        sigma = np.repeat([[s.force_sigma_n] * 3 + [s.moment_sigma_n_m] * 3], n, axis=0) * noise.inflation
        motion = base_motion(self.vehicle, s.imu_frame, w, dw, f)
        return Signals(at, 0.0 * joints, dq, ddq, motion, nothing, sigma, None, noise), refused

    def identify(self, recordings: Sequence[Recording], mass_kg: float) -> BodyEstimate:
        """The body that flew in all of ``recordings``.

        Args:
            recordings: throws of the same body.
            mass_kg: weighed; in free fall only ratios to it show.

        Raises:
            SignalError: recordings that do not determine the body.
        """
        identifier = self.identifier()
        offset = 0.0
        for recording in recordings:
            signals, refused = self.signals(recording)
            later = signals._replace(time_s=signals.time_s - signals.time_s[0] + offset)
            offset = float(later.time_s[-1]) + 10.0 * self.settings.width_s
            identifier.update(later, np.ones(refused.size, bool), refused)
        honest = identifier.honest()
        weights = np.array([quantity.weights for quantity in self.quantities])
        mean = weights @ honest.mean
        covariance = weights @ honest.covariance @ weights.T
        if not identifier.rows_used or not mean[0] > 0.0:
            raise SignalError("these recordings have no usable rows; check the gates and the wheel's rate")
        c = mean[1:4] / mean[0]
        to_c = np.zeros((9, 10))
        to_c[:3, 0], to_c[:3, 1:4] = -c / mean[0], np.eye(3) / mean[0]
        to_c[3:, 4:] = np.eye(6)
        body = RigidBody(mass_kg, c, symmetric(mean[4:]))
        spread = to_c @ covariance @ to_c.T
        scale = np.concatenate([np.zeros(3), self.settings.rotor_sigma * mean[4:]])
        return BodyEstimate(body, spread + np.outer(scale, scale), identifier.rows_used, dict(identifier.refused))


class PrincipalMoments(NamedTuple):
    """Principal moments of inertia with their standard deviations, ascending, kg m^2."""

    moments: FloatArray  # (3,)
    sigma: FloatArray  # (3,)


def without_carrier(total: BodyEstimate, carrier: BodyEstimate) -> tuple[RigidBody, PrincipalMoments]:
    """What a carrier is strapped to, from throws with and without it, and its principal moments with sigmas.

    Args:
        total: carrier and load, with the mass of both.
        carrier: the carrier alone.

    Raises:
        SignalError: a carrier that is not lighter than the whole.
    """

    def moments(x: FloatArray) -> FloatArray:
        whole = RigidBody(total.body.mass_kg, x[:3], symmetric(x[3:9]))
        part = RigidBody(carrier.body.mass_kg, x[9:12], symmetric(x[12:]))
        return principal_moments(take_away(whole, part))

    x = np.concatenate([_vector(total.body), _vector(carrier.body)])
    covariance = np.zeros((18, 18))
    covariance[:9, :9], covariance[9:, 9:] = total.covariance, carrier.covariance
    steps = np.sqrt(np.diag(covariance))
    jacobian = np.zeros((3, 18))
    for k, step in enumerate(steps):
        if step > 0.0:
            shifted = np.repeat(x[None], 2, axis=0)
            shifted[:, k] += (step, -step)
            jacobian[:, k] = (moments(shifted[0]) - moments(shifted[1])) / (2.0 * step)
    load = take_away(total.body, carrier.body)
    variance = np.einsum("ij,jk,ik->i", jacobian, covariance, jacobian)
    return load, PrincipalMoments(principal_moments(load), np.sqrt(variance))


def calibrate_rotor(device: BodyEstimate, proof: BodyEstimate, known: RigidBody) -> tuple[float, float]:
    """Factor on the rotor's assumed inertia that makes a known body come out right, and the relative misfit left.

    All inertias estimated from free rotation scale with the rotor's. The factor is the least-squares projection over
    the six elements of ``I(proof) - I(device)`` on what the known body adds to it.

    Args:
        device: the device alone, with the assumed rotor.
        proof: the device with the known body.
        known: mass and inertia about its own centre of mass, in the device's axes; where it sits comes from the throws.
    """
    shift = proof.body.centre_of_mass_m - device.body.centre_of_mass_m
    ratio = device.body.mass_kg / known.mass_kg
    expected = elements(
        known.inertia_kg_m2 + parallel_axis(device.body.mass_kg, shift) + parallel_axis(known.mass_kg, ratio * shift)
    )
    found = elements(proof.body.inertia_kg_m2 - device.body.inertia_kg_m2)
    factor = float(found @ expected / (found @ found))
    misfit = float(np.linalg.norm(factor * found - expected) / np.linalg.norm(expected))
    return factor, misfit


def _vector(body: RigidBody) -> FloatArray:
    return np.concatenate([body.centre_of_mass_m, elements(body.inertia_kg_m2)])
