"""A RockSat-like flight, made in NumPy, and the identifier of its rows."""

from functools import cache

import numpy as np

from onboard.config import packaged
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.estimation.smoothing import SmoothingWindow, correlation_inflation
from onboard.identification.quantities import mass_quantities
from onboard.identification.rows.identifier import Identifier
from onboard.identification.rows.stated_errors.considered import Considered
from onboard.regressor.base_parameters import base_parameters
from onboard.regressor.prior import prior_root
from onboard.regressor.rows import BaseMotion, RowModel, base_motion, load_cell_row
from onboard.regressor.signals import SignalNoise, Signals

WIDTH_S, ROW_S, CELL_S, IMU_S = 0.1, 0.01, 0.005, 0.001
CELL_NOISE_N, GYRO_NOISE, ACCEL_NOISE, ENCODER_NOISE = 0.0025, 9e-4, 0.05, 4e-6
SCALE_SIGMA = 0.0035
EJECTION_S, END_S = 9.0, 18.0
TRUTH_KG = {"m_arm": 0.23313, "m_arm+m_tip_mass": 0.2994, "m_tip_mass": 0.06627}  # table 4.6


@cache
def setup(zero_force=False):
    text = packaged("rocksat").with_name("rocksat.urdf").read_text()
    vehicle = VehicleModel(text, VehicleSpec(BaseKind.PRESCRIBED, "plate", "tip_mass"))
    model = RowModel(vehicle, [load_cell_row("load_cell", "joint_1", (0, 0, 1), "moment", 0.04)], zero_force)
    base = base_parameters(model, np.random.default_rng(0))
    return vehicle, model, base, mass_quantities(model, base, "joint_1", "arm")


SCALE = (Considered("scale", "load_cell", "scale", SCALE_SIGMA),)


def identifier(considered=SCALE, zero_force=False, **options):
    _, model, base, quantities = setup(zero_force)
    links = {"plate": 1.0, "arm": 1.0, "tip_mass": 1.0}
    zeros = {f"zero_force_{axis}": 0.1 for axis in "xyz"} if zero_force else {}
    sigma = prior_root(model, links, {"bias_load_cell": 1.0} | zeros)
    return Identifier(model, base, sigma, 5 * WIDTH_S, quantities, considered, imu_frame="imu_base", **options)


def joint(t):
    """A slow and a fast sweep, twice."""
    rate = np.where(t % 9.0 < 4.5, 2 * np.pi * 0.4, 2 * np.pi * 0.9)
    return 0.21 * np.sin(rate * t), 0.21 * rate * np.cos(rate * t), -0.21 * rate**2 * np.sin(rate * t)


def rocket(t):
    """Spin with wobble and vibration, in plate axes."""
    six, seven = 2 * np.pi * 6, 2 * np.pi * 7
    w = np.column_stack([0.02 * np.sin(0.7 * t), 0.015 * np.sin(1.1 * t), 0.3 + 2e-3 * np.sin(six * t)])
    dw = np.column_stack([0.014 * np.cos(0.7 * t), 0.0165 * np.cos(1.1 * t), 2e-3 * six * np.cos(six * t)])
    f = 0.03 * np.column_stack([np.sin(seven * t), np.cos(0.8 * seven * t), np.sin(1.3 * seven * t)])
    return BaseMotion(w, dw, f + np.array([0.01, 0.02, 0.0]))


def flight(rng):
    """Noisy, smoothed signals of one flight, whether the tip mass is held, and the true scale of the cell."""
    vehicle, model, _, _ = setup()
    ts, ti = np.arange(0, END_S, CELL_S), np.arange(0, END_S, IMU_S)
    q, dq, ddq = (v[:, None] for v in joint(ts))
    chi = model.chi.copy()
    chi[-1] = 0.03  # the cell's zero, N
    scale = 1 + SCALE_SIGMA * rng.normal()
    cell = scale * (model.regressor(q, dq, ddq, rocket(ts), ts < EJECTION_S)[:, 0] @ chi)
    cell = np.round((cell + CELL_NOISE_N * rng.normal(size=ts.size)) * 1e4) / 1e4
    encoder = np.round(q * 500_000 / (2 * np.pi)) / 500_000 * 2 * np.pi
    R, p = vehicle.pose_in_base("imu_base")
    w, dw, f = rocket(ti)
    at_imu = f + np.cross(dw, p) + np.cross(w, np.cross(w, p))
    gyro = w @ R + GYRO_NOISE * rng.normal(size=w.shape)
    accel = at_imu @ R + ACCEL_NOISE * rng.normal(size=w.shape)
    at = np.arange(0.2, END_S - 0.2, ROW_S)
    at = at[(at % 4.5 > 0.2) & (at % 4.5 < 4.3)]
    slow, fast = SmoothingWindow(ts, at, WIDTH_S), SmoothingWindow(ti, at, WIDTH_S)
    inflation = correlation_inflation(WIDTH_S, ROW_S)
    load, rate = slow.apply(cell), slow.apply(cell, 1).values
    joints = [slow.apply(encoder, d) for d in range(3)]
    imu = [fast.apply(gyro), fast.apply(gyro, 1), fast.apply(accel)]
    noise = SignalNoise(
        *(np.outer(s.noise_gain, [ENCODER_NOISE]) for s in joints),
        *(np.outer(s.noise_gain, [n] * 3) for s, n in zip(imu, (GYRO_NOISE, GYRO_NOISE, ACCEL_NOISE), strict=True)),
        inflation,
    )
    motion = base_motion(vehicle, "imu_base", *(s.values for s in imu))
    sigma = (CELL_NOISE_N * inflation * load.noise_gain)[:, None]
    signals = Signals(at, *(s.values for s in joints), motion, load.values, sigma, rate, noise)
    return signals, at < EJECTION_S, scale


def part(signals, which):
    def cut(value):
        if value is None or isinstance(value, float):
            return value
        if isinstance(value, tuple):
            return type(value)(*map(cut, value))
        return value[which]

    return Signals(*map(cut, signals))


def feed(who, signals, held, excluded=None, step=20):
    flags = np.zeros(held.size, np.int64) if excluded is None else excluded
    found = [
        who.update(part(signals, slice(k, k + step)), held[k : k + step], flags[k : k + step])
        for k in range(0, held.size, step)
    ]
    return np.concatenate(found)


def by_name(estimate):
    return {quantity.name: quantity for quantity in estimate.quantities}
