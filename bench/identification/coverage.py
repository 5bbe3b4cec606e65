"""Do the recursive ExIDDM's intervals cover: NEES and each quantity, over random payload flights of DYMAFLEX.

Every seed is a flight of its own by MuJoCo with all that the vehicle file states tolerances for drawn within them:
masses, centres, inertias, joint places, encoder zeros, IMU place, axes, scale, bias, drift, delay. The priors are those
of the vehicle file. Signals are synthetic: samples on one grid without buses, clocks or a capture. ``bench/plans``
``coverage.toml`` flies boxes of 0.5 to 30 kg, ``lies.toml`` faults and model errors that no prior states.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.identification import free_flyer as case
from bench.identification.recursive import ticks_of
from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.plants import free_flyer
from hil_sim.sensing.free_flyer_sensors import ImuErrors, sample
from onboard import config
from onboard.devices.roles import LoadCellKeys
from onboard.dynamics.model.inertia import RigidBody, elements
from onboard.dynamics.model.payload import standard_of
from onboard.dynamics.ticks import FlightSignals, tick_signals
from onboard.estimation.smoothing import SPLINE, Response, correlation_inflation, filtered_inflation, smooth
from onboard.flight.estimate.problem.identification import UNMARKED_CLOCK_s, build_exiddm, build_model
from onboard.flight.estimate.readings.cyclic import cyclic_functions
from onboard.flight.estimate.readings.roles import roles_of
from onboard.flight.estimate.readings.signals import CYCLIC_LEFT
from onboard.ground.campaign.results import FlightAnswer, FlightResult
from onboard.identification.exiddm.online import ExiddmIdentifier
from onboard.identification.exiddm.prediction.imu_prediction import PAYLOAD
from onboard.identification.exiddm.prediction.ticks import BATCH_TICKS, Ticks
from onboard.identification.quantities import BODY, BODY_UNITS
from onboard.identification.standing import Level, standing

Floats = NDArray[np.float64]

GYRO_PER_K_rad_s, FORCE_PER_K_m_s2 = np.deg2rad(0.08), 2.5e-3  # of the MPU-6050's biases, 1 sigma
DURATION_s, STEP_s, SAMPLES = 30.0, 1.0 / 300.0, 3  # of MuJoCo and the sensors; in a tick
CELL_SAMPLES = 5  # of the wrist cell in a tick, as it flies
SMOOTHING_s, TICK_s = 0.25, 0.01  # as the vehicle file has it; three samples
BOXES = {
    "0.5 kg": free_flyer.Body.box(0.5, (0.08, 0.06, 0.10), (0.01, -0.005, 0.04)),
    "2 kg far out": free_flyer.Body.box(2.0, (0.10, 0.12, 0.60), (0.05, -0.03, 0.40)),
    "5 kg": case.BOXES[5],
    "30 kg": free_flyer.Body.box(30.0, (0.35, 0.30, 0.30), (0.05, -0.04, 0.18)),
}


class Lies(NamedTuple):
    """What is wrong besides what is drawn by default; the first three are in the sigmas of the scenario."""

    links: float = 1.0
    places: float = 1.0
    zeros: float = 1.0
    swing_rad: float = 0.35
    joint_scale: float = 0.0  # of joint 2
    joint_late_s: float = 0.0  # of joint 4
    gyro_scale: float = 0.0  # of gyro and accelerometer, from the middle of the flight on
    warming_K: float = 0.0  # noqa: N815 - within 25 s
    slosh: free_flyer.IsotropicSlosh | None = None
    compliance_rad_N_m: float = 0.0  # noqa: N815


class Covered(NamedTuple):
    """One flight's answer."""

    answers: tuple[FlightAnswer, ...]  # mass, centre, inertia
    nees: float  # of the standard parameters, without the misfit's widening
    changes: int
    refused: str  # why no answer is to be used

    @property
    def z(self) -> Floats:
        """Errors over their sigmas, (10,); NaN: not answered."""
        return np.array([(one.value - one.truth) / one.sigma for one in self.answers])


def flight(seed: int, settings: dict[str, Any]) -> FlightResult:
    """One flight of a plan.

    Args:
        seed: of everything drawn.
        settings: ``payload``, of ``BOXES``; anything of ``Lies`` by its name; ``stated``, tables laid over
            vehicle.toml, for the estimator alone.
    """
    said = dict(settings)
    box, stated = BOXES[said.pop("payload")], said.pop("stated", None)
    if "slosh" in said:
        said["slosh"] = free_flyer.IsotropicSlosh(**said["slosh"])
    found = flown(box, Lies(**said), seed, stated)
    return FlightResult(found.answers, events=("change",) * found.changes, detections=found.changes)


def flown(box: free_flyer.Body, lies: Lies, seed: int, stated: Mapping[str, Any] | None = None) -> Covered:
    """One flight through the estimator of the vehicle file, with what is stated over it."""
    rng = np.random.default_rng([seed, 0xC0])
    scenario = scenario_of("dymaflex")
    base_built, link_built = scenario.as_built["base"], scenario.as_built["link_1"]
    base, *arm = (
        case.as_built(
            body, (scale * own.mass_relative, 1e-3 * scale * own.centre_mm, scale * own.inertia_relative), rng
        )
        for body, own, scale in [
            (free_flyer.BASE, base_built, 1.0),
            *((link, link_built, lies.links) for link in free_flyer.ARM),
        ]
    )
    offsets_m = 1e-3 * lies.places * link_built.place_mm * rng.standard_normal((free_flyer.JOINTS, 3))
    world = free_flyer.world(box, base, arm, STEP_s, offsets_m, lies.slosh)
    motion = free_flyer.JointMotion.draw(rng, lies.swing_rad)
    truth = free_flyer.fly(world, motion, rng.uniform(-0.05, 0.05, 3), DURATION_s)
    zeros = 1e-3 * lies.zeros * rng.standard_normal(free_flyer.JOINTS)
    imu_m = 1e-3 * scenario.as_built["imu_base"].place_mm
    off_m = imu_m * rng.standard_normal(3)
    spoilt = _spoilt(truth, lies, rng)
    signals, cyclic = _sensed(spoilt, zeros, off_m, rng)
    online, _ = build_exiddm(_vehicle(stated))
    off_m = imu_m * rng.standard_normal(3)
    ticks = _with_joint_noise(ticks_of(signals)._replace(cyclic=cyclic))
    ticks = _with_further(ticks, _second(truth, spoilt, off_m, rng), _wrist(truth, rng))
    for first in range(0, len(ticks.time_s), BATCH_TICKS):
        online.exiddm.update(ticks.part(slice(first, first + BATCH_TICKS)))
    online.finish()
    return _judged(box, online)


def _vehicle(stated: Mapping[str, Any] | None = None) -> config.Vehicle:
    vehicle = config.load(config.packaged("dymaflex"))
    tree = config.laid_over(vehicle.tree, {"estimation": {"exiddm": {"held_at_start": True}}})
    return config.parse_tree(config.laid_over(tree, dict(stated or {})), vehicle.path, config.Origin("the bench"))


def _spoilt(truth: free_flyer.FreeFlightSignals, lies: Lies, rng: np.random.Generator) -> free_flyer.FreeFlightSignals:
    """The flight with what lies."""
    t = truth.time_s
    q = truth.q_rad + lies.compliance_rad_N_m * truth.torque_n_m
    q[:, 1] *= 1.0 + lies.joint_scale
    q[:, 3] = np.interp(t - lies.joint_late_s, t, q[:, 3])
    gain = np.where(t > 0.5 * DURATION_s, 1.0 + lies.gyro_scale, 1.0)[:, None]
    rise_K = lies.warming_K * -np.expm1(-t / 10.0)[:, None]
    rate = gain * truth.rate_rad_s + rise_K * GYRO_PER_K_rad_s * rng.standard_normal(3)
    force = gain * truth.specific_force_m_s2 + rise_K * FORCE_PER_K_m_s2 * rng.standard_normal(3)
    return truth._replace(q_rad=q, rate_rad_s=rate, specific_force_m_s2=force)


def _sensed(
    truth: free_flyer.FreeFlightSignals, zeros: Floats, off_m: Floats, rng: np.random.Generator
) -> tuple[FlightSignals, Floats]:
    """Ticks of the first IMU, and the functions of the joints' cyclic errors at these."""
    """The flight as encoders and the displaced IMU see it."""
    step_s = float(truth.time_s[1] - truth.time_s[0])
    w = truth.rate_rad_s
    swing = np.cross(np.gradient(w, step_s, axis=0, edge_order=2), off_m) + np.cross(w, np.cross(w, off_m))
    q = truth.q_rad + zeros
    for periods, rms in _ripple():
        q += np.sqrt(2.0) * rms * np.sin(periods * truth.q_rad + rng.uniform(0.0, 2.0 * np.pi, free_flyer.JOINTS))
    seen = truth._replace(q_rad=q, specific_force_m_s2=truth.specific_force_m_s2 + swing)
    sampled = sample(seen, _imu_errors(), rng)
    periods = [one for one, _ in _ripple()]
    waves = np.hstack([cyclic_functions(np.outer(angle, periods)) for angle in sampled.angle_rad.T])
    functions = tick_signals(*sampled._replace(angle_rad=waves)[:4], sampled[4:], SAMPLES, SMOOTHING_s)
    cyclic = np.stack([functions.q, functions.dq, functions.ddq], axis=1)
    return tick_signals(*sampled[:4], sampled[4:], SAMPLES, SMOOTHING_s), cyclic


def _imu_errors() -> ImuErrors:
    """Drawn with the sigmas that the vehicle file states."""
    stated = _vehicle().file.estimation.imu_prior
    return ImuErrors(
        stated.gyro_bias_rad_s,
        stated.gyro_drift_rad_s2,
        stated.accelerometer_bias_m_s2,
        stated.accelerometer_drift_m_s3,
        stated.gyro_scale,
        stated.gyro_misalignment_rad,
        stated.delay_s,
    )


def _second(
    truth: free_flyer.FreeFlightSignals, spoilt: free_flyer.FreeFlightSignals, off_m: Floats, rng: np.random.Generator
) -> FlightSignals:
    """The second IMU, which no lie but those of the joints touches; its clock has no marks."""
    first, second = (build_model(_vehicle()).pose_in_base(frame) for frame in ("imu_base", "imu_2"))
    step_s = float(truth.time_s[1] - truth.time_s[0])
    w = truth.rate_rad_s @ first[0].T
    r = second[1] + off_m - first[1]
    swing = np.cross(np.gradient(w, step_s, axis=0, edge_order=2), r) + np.cross(w, np.cross(w, r))
    force = truth.specific_force_m_s2 @ first[0].T + swing
    seen = spoilt._replace(rate_rad_s=w @ second[0], specific_force_m_s2=force @ second[0])
    sampled = sample(seen, replace(_imu_errors(), delay_s=UNMARKED_CLOCK_s), rng)
    return tick_signals(*sampled[:4], sampled[4:], SAMPLES, SMOOTHING_s)


def _wrist(truth: free_flyer.FreeFlightSignals, rng: np.random.Generator) -> FlightSignals:
    """The wrist cell, in the place of the first axis of a rate."""
    keys = next(cell.keys for cell in roles_of(_vehicle()).cells)
    assert isinstance(keys, LoadCellKeys)
    assert keys.zero_sigma_N is not None
    assert keys.zero_drift_N_s is not None
    alike = filtered_inflation(1e-3 * keys.delay_ms, TICK_s / CELL_SAMPLES)
    t, noise_N = truth.time_s, alike * keys.noise_N * np.sqrt(SAMPLES / CELL_SAMPLES)
    force = (1.0 + keys.scale_sigma * rng.standard_normal()) * truth.wrist_force_n @ np.array(keys.axis)
    force += keys.zero_sigma_N * rng.standard_normal() + keys.zero_drift_N_s * rng.standard_normal() * (t - t[0])
    force += noise_N * rng.standard_normal(len(t))
    read = np.column_stack([force, force, force])
    return tick_signals(t, truth.q_rad, read, read, (noise_N, noise_N), SAMPLES, SMOOTHING_s)


def _with_joint_noise(ticks: Ticks) -> Ticks:
    """Ticks with the noise of quantised and smoothed joints and their gears, as the estimator's smoother states it."""
    inflation = correlation_inflation(SMOOTHING_s, TICK_s, SPLINE)
    at_s, count_rad = STEP_s * np.arange(301), 2.0 * np.pi / free_flyer.COUNTS_PER_TURN
    response, sigma, own = Response(SMOOTHING_s), ticks.joint_sigma.copy(), ticks.sample_sigma.copy()
    for order in (1, 2):
        gain = float(smooth(at_s, np.zeros((301, 1)), at_s[150:151], SMOOTHING_s, order).noise_gain[0])
        squares = (count_rad * gain) ** 2 / 12.0 * np.ones_like(ticks.dq)
        own[:, order - 1] = np.sqrt(squares)
        for periods, rms in _ripple():
            squares += (CYCLIC_LEFT * rms * response.gain(periods * ticks.dq, order)) ** 2
        sigma[:, order - 1] = inflation * np.sqrt(squares)
    return ticks._replace(joint_sigma=sigma, sample_sigma=own)


def _ripple() -> tuple[tuple[float, float], ...]:
    """Cyclic errors of the encoders, alike for all: periods of each in a radian times 2 pi, and its rms."""
    roles = roles_of(_vehicle())
    [tones] = {roles.signals[joint.channel].ripple for joint in roles.joints}
    return tones


def _with_further(ticks: Ticks, second: FlightSignals, wrist: FlightSignals) -> Ticks:
    """Ticks of the first IMU with those of the second and of the cell."""
    n = len(ticks.time_s)
    sigma = np.concatenate([second.rate_sigma, second.specific_force_sigma, wrist.rate_sigma[:1]])
    measured = np.concatenate([ticks.measured, second.rate, second.specific_force, wrist.rate[:, :1]], axis=1)
    return ticks._replace(measured=measured, sigma=np.concatenate([ticks.sigma, np.tile(sigma, (n, 1))], axis=1))


def _judged(box: free_flyer.Body, online: ExiddmIdentifier) -> Covered:
    exiddm, estimate, findings = online.exiddm, online.estimate(), online.findings()
    wanted = [box.mass_kg, *box.centre_of_mass_m, *elements(box.inertia_kg_m2)]
    answers = []
    for name, unit, found, true in zip(BODY, BODY_UNITS, estimate.quantities, wanted, strict=True):
        level, why = standing(found, findings)
        said = FlightAnswer(name, unit, float(true), found.mean, found.low, found.high, found.sigma)
        supported = bool(np.isfinite(found.mean)) and level is not Level.DO_NOT_USE
        answers.append(said._replace(supported=supported, level=str(level), why=why, leans=found.leans))
    nees = np.nan
    if exiddm.state is not None and exiddm.held:
        off = exiddm.state[PAYLOAD] - standard_of(RigidBody(box.mass_kg, box.centre_of_mass_m, box.inertia_kg_m2))
        nees = float(off @ np.linalg.solve(exiddm.covariance[PAYLOAD, PAYLOAD], off))
    return Covered(tuple(answers), nees, len(exiddm.changes), "; ".join(findings.against))
