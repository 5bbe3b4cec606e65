"""A Universal Robots controller that serves its outputs by RTDE on port 30004, typed from the guide of the interface.

A package is a big-endian uint16 of its whole size, a letter, and the rest:

======  ===================================================  =====================================================
letter  from the client                                      from the controller
======  ===================================================  =====================================================
V       uint16: the protocol version that it wants           uint8: 1 if it can have that
v       nothing                                              4 x uint32: major, minor, bugfix and build number
O       double: packages a second; names with commas         uint8: number of the recipe; types with commas
S, P    nothing                                              uint8: 1 if it sends, pauses
U       (inputs: not taken here)                             uint8: recipe, and the outputs in the order of their names
M       (not taken here)                                     uint8 and message, uint8 and source, uint8 level
======  ===================================================  =====================================================

An output that is unknown has the type NOT_FOUND; one that another client has is IN_USE; the recipe is 0 then. A
package's outputs are all of the instant of its ``timestamp``, seconds since the controller was started. It leaves
within a control cycle. A protective stop and an emergency stop are only reported: the plant moves on.

Tables of what a UR controller measures: joints, the wrench at the wrist, other outputs. A bus has one twin.
"""

import math
import struct
from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar, Final, Literal

import numpy as np
from pydantic import Field, PositiveFloat

from hil_sim.devices.emulator import Bench, Emulator, Equivalent, JointEmulator, Twin
from hil_sim.devices.network.networked import NetworkedTwin
from hil_sim.devices.wrist.components import ComponentEmulator
from hil_sim.faults import FaultKind, FaultyScalar
from hil_sim.scenario.sensor_tables import NonNegative
from hil_sim.scenario.sheets import Sheets
from hil_sim.sensing.analog import ChipClock, ScalarAnalog
from hil_sim.sensing.controller_sensors import MotorTorqueSensor
from hil_sim.sensing.sensors import EncoderSensor, LoadCellSensor

_SIX: Final = "VECTOR6D"
_OUTPUTS: Final = {  # the guide's names and types, of those that are served
    "timestamp": "DOUBLE",
    "target_q": _SIX,
    "target_qd": _SIX,
    "target_moment": _SIX,
    "actual_q": _SIX,
    "actual_qd": _SIX,
    "actual_current": _SIX,
    "actual_TCP_pose": _SIX,
    "actual_TCP_force": _SIX,
    "ft_raw_wrench": _SIX,
    "robot_mode": "INT32",
    "safety_mode": "INT32",
    "safety_status_bits": "UINT32",
    "runtime_state": "UINT32",
    "speed_scaling": "DOUBLE",
}
_FORMATS: Final = {"DOUBLE": "d", "INT32": "i", "UINT32": "I", _SIX: "6d"}
_RUNNING, _POWER_OFF = 7, 3  # robot_mode
_BIT_NORMAL, _BIT_PROTECTIVE, _BIT_ROBOT_STOP, _BIT_STOP, _BIT_SAFETY = 0, 2, 6, 7, 10  # safety_status_bits
_CONTROL_HZ: Final = 500.0
Input = Callable[[float], float]
_RATE_WINDOW_S: Final = 2e-3


class UrController(NetworkedTwin[tuple[str, int]]):
    """One controller; see ``NetworkedTwin``.

    Args:
        inputs: What it measures at a mission time, by output and place from 0; others are 0.
        lacks: Outputs that it has not, and what it says of them.
    """

    draws = 0x5552
    fault_kinds = (FaultKind.TRIP, FaultKind.EMERGENCY_STOP)
    boot_ns = 1_000_000_000  # a real one takes a minute

    def __init__(
        self,
        inputs: Mapping[tuple[str, int], Input],
        clock: ChipClock,
        start_ns: int,
        *,
        latency_ns: int = 700_000,
        lacks: Mapping[str, str] | None = None,
        **options: Any,
    ) -> None:
        self._types = {**_OUTPUTS, **(lacks or {})}
        self._request = bytearray()
        self._names: list[str] = []
        self._rate_hz = _CONTROL_HZ
        self._next = 0  # number of the next package since power-up, at its rate
        super().__init__(inputs, clock, start_ns, latency_ns=latency_ns, **options)

    def connected(self) -> None:
        """See ``NetworkDevice``."""
        self._request.clear()
        super().connected()

    def receive(self, data: bytes, now_ns: int) -> None:
        """See ``NetworkDevice``."""
        self._request += data
        while len(self._request) >= 3 and len(self._request) >= (size := int.from_bytes(self._request[:2], "big")) >= 3:
            letter, rest = chr(self._request[2]), bytes(self._request[3:size])
            del self._request[:size]
            self._asked(letter, rest, now_ns)

    # Requests

    def _say(self, letter: str, rest: bytes, ready_ns: int) -> None:
        self._transmit(_package(letter, rest), ready_ns)

    def _asked(self, letter: str, rest: bytes, now_ns: int) -> None:
        ready_ns = now_ns + self._latency_ns
        match letter:
            case "V":
                self._say("V", bytes([rest == b"\0\2"]), ready_ns)
            case "v":
                self._say("v", struct.pack(">IIII", 5, 16, 1, 0), ready_ns)
            case "O":
                named = rest[8:].decode("ascii", "replace").split(",")
                self._names = [name for name in named if name]  # ur_rtde sends a comma after the last
                self._rate_hz = min(max(struct.unpack(">d", rest[:8])[0], 1.0), _CONTROL_HZ)
                types = [self._types.get(name, "NOT_FOUND") for name in self._names]
                fits = all(one in _FORMATS for one in types)
                self._say("O", bytes([fits]) + ",".join(types).encode(), ready_ns)
                self._names = self._names if fits else []
            case "S" | "P":
                self._say(letter, bytes([bool(self._names)]), ready_ns)
                if letter == "P" or not self._names:
                    self._stop("sample")
                    return
                period_ns = 1e9 / self._rate_hz
                self._next = math.ceil((self._clock.chip_ns(ready_ns) - self._powered_chip_ns) / period_ns)
                self._arm(ready_ns)

    # Data

    def _arm(self, not_before_ns: int) -> None:
        own_ns = self._powered_chip_ns + round(self._next * 1e9 / self._rate_hz)
        self._at("sample", max(self._clock.time_ns(own_ns), not_before_ns), self._sample)

    def _sample(self, now_ns: int) -> None:
        stamp_s = self._next / self._rate_hz
        time_s = self._seconds(now_ns)
        rest = struct.pack(">B", 1)
        for name in self._names:
            rest += struct.pack(f">{_FORMATS[self._types[name]]}", *self._measured(name, time_s, stamp_s, now_ns))
        if self._active(FaultKind.GARBAGE, now_ns):
            rest = self._latency.rng.bytes(len(rest))
        self._send(_package("U", rest), self._next, now_ns + self._latency.draw_ns())
        self._next += 1
        self._arm(now_ns)

    def _measured(self, name: str, time_s: float, stamp_s: float, now_ns: int) -> list[float]:
        stopped, pressed = self._active(FaultKind.TRIP, now_ns), self._active(FaultKind.EMERGENCY_STOP, now_ns)
        match name:
            case "timestamp":
                return [stamp_s]
            case "robot_mode":
                return [_POWER_OFF if pressed else _RUNNING]
            case "safety_mode":
                return [7 if pressed else 3 if stopped else 1]
            case "safety_status_bits":
                normal = [_BIT_PROTECTIVE, _BIT_SAFETY] if stopped else [_BIT_NORMAL]
                bits = [_BIT_ROBOT_STOP, _BIT_STOP, _BIT_SAFETY] if pressed else normal
                return [sum(1 << bit for bit in bits)]
            case "runtime_state" | "speed_scaling":
                return [1]
        found = [self._inputs.get((name, place)) for place in range(6)]
        return [0.0 if one is None else one(time_s) for one in found]


def _package(letter: str, rest: bytes) -> bytes:
    return struct.pack(">HB", 3 + len(rest), ord(letter)) + rest


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


class UrJointTable(_UrTable, JointEmulator):
    """A joint."""

    where = "joint {number}"

    kind: Literal["ur_joint"]
    number: Annotated[int, Field(ge=1, le=6)] = 1
    noise_rad: NonNegative = 2e-5
    sign: Literal[-1, 1] = 1
    zero_rad: float = 0.0
    torque_N_m_A: PositiveFloat = 10.0  # noqa: N815  (the newton's letter)

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

    def build(self, bench: Bench) -> Twin:
        """See ``Emulator``."""
        angle = FaultyScalar(bench.sensor(EncoderSensor), bench.faults, bench.start_ns)
        turning = rate(bench.sensor(EncoderSensor))
        torque = bench.sensor(MotorTorqueSensor, "torque")
        rng = np.random.default_rng(bench.seed)
        at = self.number - 1
        inputs: dict[tuple[str, int], Input] = {
            ("actual_q", at): lambda t: (
                self.sign * angle.value(t) + self.zero_rad + self.noise_rad * float(rng.standard_normal())
            ),
            ("actual_qd", at): lambda t: self.sign * turning(t),
            ("actual_current", at): lambda t: self.sign * torque.value(t) / self.torque_N_m_A,
        }
        return self.twin(bench, inputs, self.recorded(bench.name))


class UrWrenchTable(_UrTable, ComponentEmulator):
    """A component of the wrench at the wrist."""

    kind: Literal["ur_wrench"]

    @classmethod
    def further(cls, said: Mapping[str, Any]) -> dict[str, Any]:
        """See ``ComponentEmulator``: it has no range."""
        return {}

    def build(self, bench: Bench) -> Twin:
        """See ``Emulator``."""
        cell = FaultyScalar(bench.sensor(LoadCellSensor), bench.faults, bench.start_ns)
        return self.twin(bench, {("ft_raw_wrench", self.component - 1): cell.value}, (bench.name,))


class UrOutputTable(_UrTable):
    """Six numbers of another output, which are 0 here."""

    where = "{output}"

    kind: Literal["ur_output"]
    output: str

    @classmethod
    def from_vehicle(cls, name: str, said: Mapping[str, Any], sheets: Sheets) -> Equivalent:
        """See ``Emulator``."""
        return Equivalent({"output": said["output"]}, {}, {name: "crystal"})

    def build(self, bench: Bench) -> Twin:
        """See ``Emulator``."""
        return self.twin(bench, {}, tuple(f"{bench.name}_{place}" for place in range(1, 7)))
