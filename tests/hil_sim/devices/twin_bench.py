"""What the twins hang on in these tests: a clock of known rate, and analogue inputs that can be predicted by hand."""

from collections.abc import Callable, Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from hil_sim.buses.media import Bus, CanBus, I2cBus, PulseLine
from hil_sim.devices.can_bus.can_wire import CanTalker, CanWire
from hil_sim.devices.can_bus.sync_train import WireFrame
from hil_sim.devices.canopen.encoder406 import Encoder406
from hil_sim.devices.canopen.loadcell404 import LoadCell404
from hil_sim.devices.mpu6050.chip import Mpu6050Twin
from hil_sim.devices.sync.sync_box import SyncBox
from hil_sim.scenario.bus_tables import BusTable, CanBusTable, I2cBusTable, PulseLineTable

BUSES: dict[str, BusTable] = {
    "i2c_1": I2cBusTable(kind="i2c"),
    "can_0": CanBusTable(kind="can"),
    "sync_line": PulseLineTable(kind="pulse", channel="pulse"),
}
START_NS = 7_000_000_000
MS = 1_000_000


class RateClock:
    """A device clock that runs ``1 + rate_error`` times as fast as the true one."""

    def __init__(self, rate_error: float = 0.0, start_ns: int = START_NS) -> None:
        self.rate = 1.0 + rate_error
        self.start_ns = start_ns

    def time_ns(self, chip_ns: int) -> int:
        return self.start_ns + round(chip_ns / self.rate)

    def chip_ns(self, time_ns: int) -> int:
        return int((time_ns - self.start_ns) * self.rate)

    def times_s(self, chip_ns: NDArray[np.float64]) -> NDArray[np.float64]:
        return chip_ns / self.rate * 1e-9


class StairImu:
    """Sample at mission time t has words 100 * axis + (t in ms, rounded) % 64; remembers how it was asked."""

    def __init__(self) -> None:
        self.calls: list[tuple[int, float, float, int]] = []
        self.times_s: list[float] = []

    def counts(
        self, times_s: NDArray[np.float64], accel_lsb_per_g: float, gyro_lsb_per_dps: float, dlpf_cfg: int
    ) -> NDArray[np.int16]:
        self.calls.append((len(times_s), accel_lsb_per_g, gyro_lsb_per_dps, dlpf_cfg))
        self.times_s.extend(times_s.tolist())
        step = np.round(times_s * 1e3).astype(np.int64) % 64
        return (100 * np.arange(7) + step[:, None]).astype(np.int16)


class FlatImu:
    """The same seven words always."""

    def __init__(self, words: Iterable[int]) -> None:
        self.words = np.array(list(words), np.int16)

    def counts(
        self, times_s: NDArray[np.float64], accel_lsb_per_g: float, gyro_lsb_per_dps: float, dlpf_cfg: int
    ) -> NDArray[np.int16]:
        del accel_lsb_per_g, gyro_lsb_per_dps, dlpf_cfg
        return np.tile(self.words, (len(times_s), 1))


class Analog:
    """A scalar input given as a function of mission time; remembers when it was asked."""

    def __init__(self, function: Callable[[float], float]) -> None:
        self._function = function
        self.times_s: list[float] = []

    def value(self, time_s: float) -> float:
        self.times_s.append(time_s)
        return self._function(time_s)


class CanRig:
    """Nodes on a wire, and the flight computer as a list of what it received."""

    def __init__(self, *nodes: CanTalker) -> None:
        self.wire = CanWire()
        self.now_ns = START_NS
        self.frames: list[WireFrame] = []
        for node in nodes:
            self.wire.add(node)

    def run(self, ms: float) -> list[WireFrame]:
        """Let time pass; returns the frames received in it."""
        self.now_ns += round(ms * MS)
        new = self.wire.advance(self.now_ns)
        self.frames += new
        return new

    def send(self, identifier: int, *data: int) -> None:
        self.wire.send(identifier, bytes(data), self.now_ns)

    def ask(self, node: int, request: str) -> str:
        """One SDO request in hex, and the answer in hex."""
        self.wire.send(0x600 + node, bytes.fromhex(request), self.now_ns)
        answers = [frame.data.hex(" ") for frame in self.run(3) if frame.identifier == 0x580 + node]
        assert len(answers) == 1
        return answers[0]


class SmallMission:
    """An IMU, an encoder, a load cell and a sync box with nothing behind them; as ``hil_sim.mission.Mission`` is."""

    def __init__(self, duration_s: float = 1.0) -> None:
        self.duration_ns = round(duration_s * 1e9)
        self.start_ns = self.now_ns = 0

    @property
    def end_ns(self) -> int:
        return self.start_ns + self.duration_ns

    @property
    def finished(self) -> bool:
        return self.now_ns >= self.end_ns

    def attach(self, *, i2c: I2cBus, can: CanBus, pulse: PulseLine, start_ns: int) -> None:
        self.i2c, self.can, self.pulse = i2c, can, pulse
        self.start_ns = self.now_ns = start_ns
        self.imu = Mpu6050Twin(FlatImu([0, 0, 8192, -500, 0, 0, 0]), RateClock(0.003, start_ns), start_ns)
        self.box = SyncBox(RateClock(0.0, start_ns), start_ns)
        self.joint = Encoder406(1, Analog(lambda t: 0.1 * t), start_ns, zero_count=1000)
        self.cell = LoadCell404(2, Analog(lambda t: 1.5), start_ns)
        i2c.add(self.imu)
        for node in (self.box, self.joint, self.cell):
            can.add(node)
        self.box.connect_pin(self.imu.fsync)
        self.box.connect_pin(pulse.edge)

    def plug(self, buses: Mapping[str, Bus], start_ns: int) -> None:
        """Attach to buses opened as ``BUSES``."""
        i2c, can, pulse = (buses[name] for name in BUSES)
        assert isinstance(i2c, I2cBus)
        assert isinstance(can, CanBus)
        assert isinstance(pulse, PulseLine)
        self.attach(i2c=i2c, can=can, pulse=pulse, start_ns=start_ns)

    def advance(self, now_ns: int) -> None:
        self.now_ns = now_ns
        self.can.advance(now_ns)
        self.i2c.advance(now_ns)
        self.pulse.advance(now_ns)

    def produced(self) -> dict[str, int]:
        return {"imu_base": self.imu.produced, "joint_1": self.joint.produced, "can_sync": self.box.produced}

    def truth(self) -> dict[str, object]:
        return {"load_n": np.float64(1.5), "inertia": np.eye(2)}
