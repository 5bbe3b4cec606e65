"""Signals of controllers: torque of a servo, speed of a reaction wheel, force of a thruster, phase of the sequence."""

import bisect
from typing import Any

import numpy as np

from hil_sim.plants.world import Plant
from hil_sim.scenario.sensor_tables import MotorTorqueTable, ThrustTable, WheelRateTable
from hil_sim.sensing.interpolation import interpolate_one


class MotorTorqueSensor:
    """Servo torque from the motor current, with gain error, offset and noise of the current measurement."""

    def __init__(self, plant: Plant, table: MotorTorqueTable, rng: np.random.Generator, at: str = "") -> None:
        self._plant = plant
        self._torque_n_m = plant.servo_torque_n_m(at)
        self.gain = 1.0 + table.scale_sigma * rng.standard_normal()
        self.offset_Nm = table.offset_sigma_Nm * rng.standard_normal()
        self._noise = table.noise_rms_Nm * rng.standard_normal(plant.rows)

    def value(self, time_s: float) -> float:
        """Torque at ``time_s`` [N m], about the joint."""
        self._plant.require(time_s)
        position = time_s / self._plant.step_s
        return self.measured(float(interpolate_one(self._torque_n_m, position)), time_s)

    def measured(self, torque_n_m: float, time_s: float) -> float:
        """What it makes of a torque at ``time_s`` [N m]."""
        row = min(max(round(time_s / self._plant.step_s), 0), self._plant.rows - 1)
        return float(self.gain * torque_n_m + self.offset_Nm + self._noise[row])

    def truth(self) -> dict[str, Any]:
        """The errors drawn."""
        return {"gain": self.gain, "offset_Nm": self.offset_Nm}


class TachoSensor:
    """Speed of a reaction wheel, with scale error and noise."""

    def __init__(self, plant: Plant, table: WheelRateTable, rng: np.random.Generator, at: str = "") -> None:
        self._plant, self.step_rad_s = plant, table.step_rad_s
        self._rate_rad_s = plant.wheel_rate_rad_s(at)
        self.gain = 1.0 + table.scale_sigma * rng.standard_normal()
        self._noise = table.noise_rms_rad_s * rng.standard_normal(plant.rows)

    def value(self, time_s: float) -> float:
        """Speed at ``time_s`` [rad/s]."""
        self._plant.require(time_s)
        position = time_s / self._plant.step_s
        noise = float(self._noise[min(max(round(position), 0), self._plant.rows - 1)])
        return float(self.gain * interpolate_one(self._rate_rad_s, position) + noise)

    def truth(self) -> dict[str, Any]:
        """The errors drawn."""
        return {"gain": self.gain}


class ThrustSensor:
    """Force of a thruster as its driver tells it, with a scale error: the force is another one."""

    def __init__(self, plant: Plant, table: ThrustTable, rng: np.random.Generator, at: str = "") -> None:
        self._plant, self.step_n = plant, table.step_N
        self._thrust_n = plant.thrust_n(at)
        self.gain = 1.0 + table.scale_sigma * rng.standard_normal()

    def value(self, time_s: float) -> float:
        """Force at ``time_s`` [N]: on or off, nothing between two steps."""
        self._plant.require(time_s)
        step = min(max(int(time_s / self._plant.step_s), 0), self._plant.rows - 1)
        return float(self.gain * self._thrust_n[step])

    def truth(self) -> dict[str, Any]:
        """The errors drawn."""
        return {"gain": self.gain}


def of_actuator(
    plant: Plant, table: WheelRateTable | ThrustTable, rng: np.random.Generator, at: str
) -> TachoSensor | ThrustSensor:
    """What tells of a wheel or of a thruster."""
    if isinstance(table, WheelRateTable):
        return TachoSensor(plant, table, rng, at)
    return ThrustSensor(plant, table, rng, at)


class PhaseSensor:
    """The code of the phase; it has no errors."""

    def __init__(self, plant: Plant) -> None:
        self.changes = plant.program.phase_changes
        self._times_s = [time_s for time_s, _ in self.changes]

    def value(self, time_s: float) -> float:
        """Code at ``time_s``."""
        return float(self.changes[max(bisect.bisect_right(self._times_s, time_s) - 1, 0)][1])

    def truth(self) -> dict[str, Any]:
        """Nothing is drawn."""
        return {}
