"""The rocket's arm as a vehicle with servos, stops, air and an ejection, and its true signals."""

import copy
from typing import Any, NamedTuple

import numpy as np

from hil_sim.plants.motions.carrier import turned
from hil_sim.plants.vehicle_plant import VehiclePlant
from hil_sim.scenario.load import load
from tests.hil_sim import built

AS_DRAWN = {"as_built": built.AS_DRAWN}
NO_AIR = {"air": {"pressure_Pa": 0.0}}
NO_VIBRATION = {"vibration": {"broadband_mg": [0.0, 0.0, 0.0], "linear_mode_mg": [], "angular_mode_mrad_s": []}}
AT_REST = {"coning": {"spin_rad_s": 0.0, "nutation_rate_rad_s": 0.0, "residual_rate_rad_s": [0.0, 0.0, 0.0]}}
STILL = NO_AIR | NO_VIBRATION | AT_REST
HOLD = {"phase": 0, "action": "hold", "duration_s": 1.0}
SWEEP = {
    "phase": 4,
    "action": "strokes",
    "amplitude": {"joint_1": float(np.deg2rad(11.5))},
    "stroke_s": 0.6,
    "strokes": 3,
    "pause_s": 0.05,
    "transfer_s": 0.6,
}
EJECT = {"phase": 5, "action": "hold", "duration_s": 1.0}


def push(degrees: float) -> dict[str, Any]:
    to = {"joint_1": float(np.deg2rad(degrees))}
    return {"phase": 1, "action": "push", "to": to, "approach_s": 1.4, "hold_s": 0.6, "retreat_s": 1.0}


class History(NamedTuple):
    """True signals of a flight, and the motion of its base."""

    specific_force_imu_m_s2: np.ndarray  # (n, 3)
    rate_half_imu_rad_s: np.ndarray  # (n, 3) at t - h/2
    moment_n_m: np.ndarray  # (n,) in the flange, about the joint
    angle_rad: np.ndarray
    joint_rate_half_rad_s: np.ndarray  # at t - h/2
    servo_torque_n_m: np.ndarray
    angular_accel_rad_s2: np.ndarray  # (n, 3) of the base, its axes
    angular_rate_half_rad_s: np.ndarray  # (n, 3) at t - h/2
    origin_accel_m_s2: np.ndarray  # (n, 3) its axes
    pressure_pa: np.ndarray  # (n,)
    wind: np.ndarray  # (n, 3)


def scenario(**overrides: Any):
    """The rocket's scenario with other tables."""
    return load("rocksat", overrides)


def plant(seed: int = 7, **overrides: Any) -> VehiclePlant:
    """A flight with everything as drawn, not begun."""
    return VehiclePlant(scenario(**AS_DRAWN | overrides), np.random.default_rng(seed))


def history(flown: VehiclePlant) -> History:
    """What a plant has computed."""
    path = copy.deepcopy(flown.flight._path).rows(0, flown.rows)
    flown.advance(1e9)
    imu, rows, angle = flown.inertial("imu_base"), flown.rows, flown.angle_rad("joint_1")
    own = path.pose[:rows, 3:] * [1.0, -1.0, -1.0, -1.0]
    return History(
        imu.specific_force_m_s2,
        imu.rate_rad_s,
        flown.moment_n_m("joint_1"),
        angle,
        np.diff(angle, prepend=angle[0]) / flown.step_s,
        flown.servo_torque_n_m("joint_1"),
        path.acceleration[:rows, 3:],
        path.before[:rows, 3:],
        turned(own, path.acceleration[:rows, :3]),
        path.pressure_pa[:rows],
        path.wind[:rows],
    )
