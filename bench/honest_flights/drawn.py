"""What flies under a seed: vehicle, faults of the vocabulary and model errors, alone and in pairs.

A *fault* is a line of ``hil_sim.faults.vocabulary``; of the recorded run (``planar``), which has no twins, the same on
columns of the recording. A *model error* is a vehicle or sensor that is not as its files say, beyond
what every seed draws (masses, centres, lengths, zeros, misalignment, bias).
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

_SWEEP = {"action": "strokes", "amplitude": {"joint_1": 0.2007}, "pause_s": 0.05, "transfer_s": 0.5}
_SLOW, _FAST = (
    _SWEEP | {"phase": 3, "stroke_s": 1.0, "strokes": 3},
    _SWEEP | {"phase": 4, "stroke_s": 0.6, "strokes": 4},
)


def _each(name: str, of: Iterable[object], tables: dict[str, Any]) -> dict[str, Any]:
    return {name.format(one): tables for one in of}


def _hold(duration_s: float, phase: int = 0) -> dict[str, Any]:
    return {"phase": phase, "action": "hold", "duration_s": duration_s}


MISSION = [
    *(_hold(2.5), _SLOW, _hold(0.4), _FAST, _hold(0.3), {"phase": 5, "action": "hold", "duration_s": 0.8}),
    *(_SLOW, _hold(0.4), _FAST, _hold(0.5, 9)),
]
"""Of the rocket's arm: 17 s; one slow and one fast sweep with the tip mass and without."""
FIRST_SWEEP_S, LAST_HELD_S, RELEASED_S, END_S = 2.6, 9.1, 10.9, 17.0
_SWING = {"action": "swing", "ramp_s": 2.0, "tones": 3}
CAPTURE_MISSION = {
    "sequence": [
        _hold(3.0),
        _SWING | {"phase": 1, "duration_s": 10.0, "swing": 0.137, "band_Hz": [0.1, 0.4]},
        _SWING | {"phase": 2, "duration_s": 16.0, "swing": 0.274, "band_Hz": [0.1, 0.6]},
        _hold(1.0, 9),
    ],
    "capture": {"earliest_s": 7.0, "latest_s": 9.0},
}
"""Of the free-flyer: 30 s."""
WORKSHOP_MISSION = {
    "sequence": [
        _hold(1.0),
        _SWING | {"phase": 1, "duration_s": 5.0, "swing": 0.5},
        _SWING | {"phase": 2, "duration_s": 11.0, "swing": 0.5},
        _hold(0.5, 9),
    ],
    "payload": {"mass_kg": [0.2, 2.5]},
}
"""Of the arm on the bench: 17.5 s."""

_MISSING = [("off", 0.0), ("reset", 0.0), ("silent", 0.0), ("intermittent", 0.1)]
_FALSE = [("stuck", 0.0), ("wrong", np.nan), ("delayed", 0.1)]  # NaN: a scale is drawn
_IMU = [*_MISSING[:2], *_FALSE, ("saturated", 1.0), ("garbage", 0.0)]
_CAN = [*_MISSING, *_FALSE, ("garbage", 0.0)]
_COLUMN = [("silent", 0.0), ("stuck", 0.0), ("wrong", np.nan), ("delayed", 0.05)]
FAULTS: dict[str, dict[str, list[tuple[str, float]]]] = {
    "rocksat": {
        "imu_base": _IMU,
        "joint_1": _CAN,
        "load_cell": [*_CAN, ("saturated", 1.0)],
        "arm_phase": [*(("wrong", float(by)) for by in (1, 2, 3, 4, 5, 6, -1, -2)), ("delayed", 0.2), ("stuck", 0.0)],
        "can_0": [("frame_drop", 0.0), ("intermittent", 0.1), ("error_frames", 0.01)],
        "sync_line": [("pulse_drop", 0.0), ("delayed", 0.02)],
    },
    "rocksat_serial": {
        "imu_base": [*_MISSING, *_FALSE, ("saturated", 1.0)],
        "joint_1": [*_MISSING, *_FALSE, ("slow", 0.2)],
        "load_cell": [*_MISSING, *_FALSE, ("saturated", 1.0)],
        "cell_port": [("byte_loss", 0.02), ("byte_garble", 0.02), ("unplug", 0.0)],
        "joint_port": [("byte_loss", 0.02), ("unplug", 0.0)],
    },
    "rocksat_mixed": {
        "joint_1": [*_MISSING[:1], *_FALSE],
        "load_cell": [*_MISSING, *_FALSE],
        "load_cell_2": [*_MISSING, *_FALSE],
        "imu_base": _FALSE,
    },
    "dymaflex": {
        "imu_base": _IMU,
        "imu_2": _IMU,
        **{f"joint_{number}": _CAN for number in range(1, 6)},
        "load_cell": _CAN,
        "can_0": [("frame_drop", 0.0), ("intermittent", 0.1)],
    },
    "workshop": {
        **{f"joint_{number}": _CAN for number in range(1, 6)},
        **{f"wrist_{kind}_{axis}": _CAN for kind in ("force", "moment") for axis in "xyz"},
        "can_0": [("frame_drop", 0.0), ("intermittent", 0.1)],
    },
    "planar": {**{f"joint_{number}": _COLUMN for number in range(1, 6)}, "imu_base": _COLUMN},
}
ROCKETS = ("rocksat", "rocksat_serial", "rocksat_mixed")
MISSIONS: dict[str, dict[str, Any]] = {
    **_each("{}", ROCKETS, {"sequence": MISSION}),
    "dymaflex": CAPTURE_MISSION,
    "workshop": WORKSHOP_MISSION,
}
"""Of the vehicles that are flown, what lies over their scenario."""
_SHARE = {  # of the flights; a free-flyer's costs four times a rocket's
    "rocksat": 0.34,
    "rocksat_serial": 0.16,
    "rocksat_mixed": 0.22,
    "dymaflex": 0.08,
    "workshop": 0.12,
    "planar": 0.08,
}
_SCALES = [-2.0, -1.0, -0.5, -0.3, -0.1, 0.05, 0.1, 0.3]
_WARM = {"temperature_rise_K": 15.0, "temperature_time_s": 10.0}
_IMUS = ("base", "2")
_DATASHEET = {"scale_sigma": 0.015, "cross_axis_sigma": 0.01}
MODEL_ERRORS: dict[str, dict[str, dict[str, Any]]] = {
    "rocket": {
        "tip mass 2 mm off": {"as_built": {"tip_mass": {"centre_off_mm": [2.0, 0.0, 0.0]}}},
        "tip mass of 150 g, another shape": {"as_built": {"tip_mass": {"mass_factor": 2.2635, "inertia_factor": 1.85}}},
        "arm 2 mm off": {"as_built": {"arm": {"centre_off_mm": [2.0, 0.0, 0.0]}}},
        "arm 6 % heavier": {"as_built": {"arm": {"mass_factor": 1.06}}},
        "zero 3 mrad off": {"sensor": {"encoder": {"zero_sigma_mrad": 3.0}}},
        "IMU turned by 1.5 deg": {"sensor": {"imu": {"mounting_sigma_deg": 1.5}}},
        "IMU warms by 15 K": {"sensor": {"imu": _WARM}},
    },
    "dymaflex": {
        "links 3 %, 2 mm": {"as_built": _each("link_{}", range(1, 6), {"mass_relative": 0.03, "centre_mm": 2.0})},
        "zeros 3 mrad off": {"sensor": _each("joint_{}", range(1, 6), {"zero_sigma_mrad": 3.0})},
        "IMU turned by 0.5 deg": {"sensor": _each("imu_{}", _IMUS, {"mounting_sigma_deg": 0.5})},
        "IMU warms by 15 K": {"sensor": _each("imu_{}", _IMUS, _WARM)},
        "IMU of the datasheet": {"sensor": _each("imu_{}", _IMUS, {"accel_g": _DATASHEET, "gyro_deg_s": _DATASHEET})},
    },
    "workshop": {
        "zeros 3 mrad off": {"sensor": _each("joint_{}", range(1, 6), {"zero_sigma_mrad": 3.0})},
        "gripper 3 % off": {"as_built": {"gripper": {"mass_relative": 0.03}}},
    },
    "planar": {"zeros 3 mrad off": {"zero_rad": 0.003}, "links 3 %": {"link": 0.03}},
}
SHORTEST_S, LONGEST_S = 0.2, 3.0  # of a fault that ends
HARMLESS = {"off", "reset", "silent", "intermittent", "frame_drop", "error_frames", "pulse_drop", "byte_loss", "unplug"}
REDUNDANT = {"rocksat_mixed": {"load_cell", "load_cell_2"}, "dymaflex": {"imu_base", "imu_2"}}
VISIBLE_SCALE = 0.2  # the drawn arm's mass shows a scale that is wrong by more


class Drawn(NamedTuple):
    """A flight to be flown."""

    seed: int
    vehicle: str
    faults: list[dict[str, Any]]
    model_errors: dict[str, dict[str, Any]]  # tables of the scenario, by name

    @property
    def overrides(self) -> dict[str, Any]:
        """Of the scenario, or of a recorded run: what is not as drawn."""
        merged: dict[str, Any] = {}
        for tables in self.model_errors.values():
            _lay_over(merged, tables)
        return merged

    @property
    def texts(self) -> tuple[str, ...]:
        """Faults as ``heft hil --fault`` has them, then the model errors."""
        faults = list[str]()
        for one in self.faults:
            end = f"{one['end_s']:.3f}" if "end_s" in one else ""
            faults.append(f"{one['kind']}:{one['device']}:{one['start_s']:.3f}:{end}:{one['value']:g}")
        return (*faults, *self.model_errors)

    @property
    def invisible(self) -> bool:
        """A scale of a rocket's only cell or encoder is wrong for all rows with the payload, or all without.

        No other instrument on board measures it, and the drawn arm's mass shows it from :data:`VISIBLE_SCALE` on.
        """
        if self.vehicle not in ROCKETS:
            return False
        alone = REDUNDANT.get(self.vehicle, set())
        for one in self.faults:
            if one["kind"] != "wrong" or one["device"] not in {"load_cell", "joint_1"} - alone:
                continue
            starts, ends = one["start_s"], one.get("end_s", np.inf)
            held = starts < FIRST_SWEEP_S + 1.0 and ends > LAST_HELD_S - 1.0
            free = starts < RELEASED_S + 1.0 and ends > END_S - 1.0
            if (held or free) and (not free or abs(one["value"]) < VISIBLE_SCALE):
                return True
        return False


def draw(seed: int, vehicle: str | None = None, healthy: bool = False) -> Drawn:
    """What flies under a seed: one in eight healthy, six in ten of the others with one error and four with two."""
    rng = np.random.default_rng([seed, 0x12])
    name = vehicle or str(rng.choice(list(_SHARE), p=list(_SHARE.values())))
    count = 0 if healthy or rng.random() < 0.125 else int(rng.choice([1, 2], p=[0.6, 0.4]))
    known = MODEL_ERRORS["rocket" if name in ROCKETS else name]
    errors, model_errors, devices = list(known), dict[str, dict[str, Any]](), rng.permutation(list(FAULTS[name]))
    faults = list[dict[str, Any]]()
    for number in range(count):
        if rng.random() < 0.25:
            error = errors.pop(int(rng.integers(len(errors))))
            model_errors[error] = known[error]
            continue
        kinds = FAULTS[name][str(devices[number])]
        kind, value = kinds[int(rng.integers(len(kinds)))]
        faults.append(_fault(rng, str(devices[number]), kind, value, 28.0 if name == "dymaflex" else 15.0))
    return Drawn(seed, name, faults, model_errors)


def _fault(rng: np.random.Generator, device: str, kind: str, value: float, latest_s: float) -> dict[str, Any]:
    if np.isnan(value):
        value = float(rng.choice(_SCALES))
    start_s = float(rng.choice([0.5, rng.uniform(2.0, latest_s)], p=[0.2, 0.8]))
    made = fault(kind, device, start_s, value)
    stays = kind in ("stuck", "wrong", "delayed") and device != "arm_phase" and rng.random() < 0.5
    if not stays:
        made["end_s"] = start_s + float(rng.uniform(SHORTEST_S, LONGEST_S if kind in ("stuck", "wrong") else 0.8))
    return made


def fault(kind: str, device: str, start_s: float, value: float) -> dict[str, Any]:
    """A fault that stays."""
    return {"kind": kind, "device": device, "value": value, "start_s": start_s}


def _lay_over(table: dict[str, Any], other: dict[str, Any]) -> None:
    for key, value in other.items():
        if isinstance(value, dict):
            _lay_over(table.setdefault(key, {}), value)
        else:
            table[key] = value
