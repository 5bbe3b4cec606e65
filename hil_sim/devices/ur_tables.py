"""Tables of what a UR controller measures: joints, the wrench at the wrist, other outputs. A bus has one twin."""

import math
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Final, Literal

import numpy as np
from pydantic import Field, PositiveFloat

from hil_sim.devices.emulator import FORCES, Bench, Emulator, Equivalent, MeasuringEmulator, Signal, Twin
from hil_sim.devices.ur_controller import Input, UrController
from hil_sim.faults import FaultyScalar
from hil_sim.scenario.sensor_tables import NonNegative
from hil_sim.scenario.sheets import Sheets
from hil_sim.sensing.analog import ScalarAnalog
from hil_sim.sensing.controller_sensors import MotorTorqueSensor
from hil_sim.sensing.sensors import EncoderSensor, LoadCellSensor

_RATE_WINDOW_S: Final = 2e-3


def rate(analog: ScalarAnalog) -> Input:
    """The rate of an input over the control cycle before."""

    def value(time_s: float) -> float:
        before_s = max(time_s - _RATE_WINDOW_S, 0.0)
        gone_s = time_s - before_s
        return (analog.value(time_s) - analog.value(before_s)) / gone_s if gone_s else 0.0

    return value


class _UrTable(Emulator):
    """What all tables of a controller have."""

    needs: ClassVar[str] = "tcp"

    bus: str
    latency_ms: NonNegative = 0.7
    lacks: Annotated[dict[str, str], Field(default_factory=dict)]

    def twin(self, bench: Bench, inputs: Mapping[tuple[str, int], Input], channels: tuple[str, ...]) -> Twin:
        """The controller as far as this table says it."""
        controller = UrController(
            inputs,
            bench.clock,
            bench.start_ns,
            latency_ns=round(1e6 * self.latency_ms),
            lacks=self.lacks,
            seed=bench.seed,
            faults=bench.faults,
        )
        return Twin(controller, lambda: controller.produced, channels)


class UrJointTable(_UrTable, MeasuringEmulator):
    """A joint; ``torque`` names the sensor of its torque, ``channels``: recorded beside the angle."""

    quantities = ("joint_angle",)

    kind: Literal["ur_joint"]
    bus: str
    number: Annotated[int, Field(ge=1, le=6)] = 1
    torque: str
    noise_rad: NonNegative = 2e-5
    sign: Literal[-1, 1] = 1
    zero_rad: float = 0.0
    torque_N_m_A: PositiveFloat = 10.0  # noqa: N815  (the newton's letter)
    channels: tuple[Literal["velocity", "torque"], ...] = ()

    @classmethod
    def from_vehicle(cls, name: str, said: Mapping[str, Any], sheets: Sheets) -> Equivalent:
        """See ``Emulator``: its torque's errors are in shares of what the URDF allows the joint."""
        counts = said.get("counts_per_revolution", 1 << 32)
        table = {
            "number": said["number"],
            "measures": name,
            "torque": f"{name}_torque",
            "at": said["joint"],
            "noise_rad": said["noise_rad"],
            "sign": 1 if counts > 0 else -1,
            "zero_rad": said.get("zero_count", 0) * math.tau / abs(counts),
            "torque_N_m_A": said.get("gain_N_m_A", 10.0),
            "channels": [channel for channel in ("velocity", "torque") if said.get(channel)],
        }
        torque = sheets.torque(sheets.effort_n_m(said["joint"]), said)
        angle = sheets.encoder(name, {**said, "counts_per_revolution": 1 << 32})
        return Equivalent(table, {name: angle, f"{name}_torque": torque}, {name: "crystal"})

    @property
    def place(self) -> str:
        """See ``Emulator``."""
        return f"joint {self.number}"

    def signals(self, name: str) -> dict[str, Signal]:
        """See ``Emulator``."""
        return {**super().signals(name), f"{name}_torque": Signal(self.torque, ("servo_torque",), self.at)}

    def build(self, bench: Bench) -> Twin:
        """See ``Emulator``."""
        angle = FaultyScalar(bench.sensor(EncoderSensor), bench.faults, bench.start_ns)
        turning = rate(bench.sensor(EncoderSensor))
        torque = bench.sensor(MotorTorqueSensor, "torque")
        rng = np.random.default_rng([bench.seed, *bench.name.encode()])
        at = self.number - 1
        inputs: dict[tuple[str, int], Input] = {
            ("actual_q", at): lambda t: (
                self.sign * angle.value(t) + self.zero_rad + self.noise_rad * float(rng.standard_normal())
            ),
            ("actual_qd", at): lambda t: self.sign * turning(t),
            ("actual_current", at): lambda t: self.sign * torque.value(t) / self.torque_N_m_A,
        }
        return self.twin(bench, inputs, (bench.name, *(f"{bench.name}_{one}" for one in self.channels)))


class UrWrenchTable(_UrTable, MeasuringEmulator):
    """A component of the wrench at the wrist."""

    quantities = FORCES

    kind: Literal["ur_wrench"]
    bus: str
    component: Annotated[int, Field(ge=1, le=6)] = 1

    @classmethod
    def from_vehicle(cls, name: str, said: Mapping[str, Any], sheets: Sheets) -> Equivalent:
        """See ``Emulator``."""
        table = {"component": said["component"], "measures": name, "at": said["frame"]}
        return Equivalent(table, {name: sheets.load_cell(said)}, {name: "crystal"})

    @property
    def place(self) -> str:
        """See ``Emulator``."""
        return f"component {self.component}"

    def build(self, bench: Bench) -> Twin:
        """See ``Emulator``."""
        cell = FaultyScalar(bench.sensor(LoadCellSensor), bench.faults, bench.start_ns)
        return self.twin(bench, {("ft_raw_wrench", self.component - 1): cell.value}, (bench.name,))


class UrOutputTable(_UrTable):
    """Six numbers of another output, which are 0 here."""

    kind: Literal["ur_output"]
    output: str

    @classmethod
    def from_vehicle(cls, name: str, said: Mapping[str, Any], sheets: Sheets) -> Equivalent:
        """See ``Emulator``."""
        return Equivalent({"output": said["output"]}, {}, {name: "crystal"})

    @property
    def place(self) -> str:
        """See ``Emulator``."""
        return self.output

    def build(self, bench: Bench) -> Twin:
        """See ``Emulator``."""
        return self.twin(bench, {}, tuple(f"{bench.name}_{place}" for place in range(1, 7)))
