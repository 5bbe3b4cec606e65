"""Twins on analogue inputs that can be predicted by hand, served to this kernel until stdin is closed.

    python -m tests.kernel.devices '{"i2c": "i2c-9", "can": "vcan0", "nodes": true, "faults": [{"kind": ..., ...}]}'

All settings may be left out. As ``hil_sim.serve`` it prints one JSON line when everything can be opened, and one with
counts at the end.
"""

import json
import os
import select
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil_sim.buses.media import Bus, CanBus, I2cBus, PulseLine
from hil_sim.buses.realtime import MissionServer
from hil_sim.devices.canopen.encoder406 import Encoder406
from hil_sim.devices.canopen.loadcell404 import LoadCell404
from hil_sim.devices.mpu6050.chip import Mpu6050Twin
from hil_sim.devices.sync.sync_box import SyncBox
from hil_sim.faults import Fault, FaultPlan
from hil_sim.kernel.server import open_nodes
from tests.hil_sim.devices.twin_bench import BUSES

FOREVER_NS = 1 << 61
ACCEL_Z, TEMPERATURE = 16384, -4420  # 1 g at +-2 g; 23.53 degC
NEWTONS = 12.3456
TURN_PER_S = 0.01


class CountingImu:
    """Accel x and y number the millisecond of the sample (low 15 bits, and the rest); the others stand still."""

    def counts(
        self, times_s: NDArray[np.float64], accel_lsb_per_g: float, gyro_lsb_per_dps: float, dlpf_cfg: int
    ) -> NDArray[np.int16]:
        del gyro_lsb_per_dps, dlpf_cfg
        ms = np.rint(times_s * 1e3).astype(np.int64)  # (n,)
        words = np.zeros((len(ms), 7), np.int16)
        words[:, 0], words[:, 1] = ms & 0x7FFF, ms >> 15
        words[:, 2] = ACCEL_Z * accel_lsb_per_g / 16384
        words[:, 3] = TEMPERATURE
        words[:, 4:] = 131, -262, 393
        return words


class TrueClock:
    """A chip's clock that is right."""

    def __init__(self, start_ns: int) -> None:
        self.start_ns = start_ns

    def time_ns(self, chip_ns: int) -> int:
        return self.start_ns + chip_ns

    def chip_ns(self, time_ns: int) -> int:
        return time_ns - self.start_ns

    def times_s(self, chip_ns: NDArray[np.float64]) -> NDArray[np.float64]:
        return chip_ns * 1e-9


class Turning:
    """A joint that turns evenly."""

    def value(self, time_s: float) -> float:
        return 2.0 * np.pi * TURN_PER_S * time_s


class Pressed:
    """A load cell under a dead weight."""

    def value(self, time_s: float) -> float:
        del time_s
        return NEWTONS


class Bench:
    """A chip on the I2C bus and, if asked for, a sync box, an encoder (node 1) and a load cell (node 2) on CAN."""

    end_ns = FOREVER_NS
    finished = False

    def __init__(self, buses: Mapping[str, Bus], start_ns: int, settings: dict[str, Any]) -> None:
        i2c, can, pulse = (buses[name] for name in BUSES)
        assert isinstance(i2c, I2cBus)
        assert isinstance(can, CanBus)
        assert isinstance(pulse, PulseLine)
        plan = FaultPlan([Fault(**fault) for fault in settings.get("faults", [])], start_ns)
        self._i2c, self._can, self._pulse = i2c, can, pulse
        self.imu = Mpu6050Twin(CountingImu(), TrueClock(start_ns), start_ns, faults=plan.of("imu_base"))
        i2c.add(self.imu)
        i2c.inject(plan.of("i2c_1"))
        self.box = SyncBox(TrueClock(start_ns), start_ns, faults=plan.of("sync_box"))
        self.joint = Encoder406(1, Turning(), start_ns, faults=plan.of("joint_1"))
        self.cell = LoadCell404(2, Pressed(), start_ns, faults=plan.of("load_cell"))
        if settings.get("nodes"):
            for talker in (self.box, self.joint, self.cell):
                can.add(talker)
            self.box.connect_pin(self.imu.fsync)
            self.box.connect_pin(pulse.edge)

    def advance(self, now_ns: int) -> None:
        self._can.advance(now_ns)
        self._i2c.advance(now_ns)
        self._pulse.advance(now_ns)


def stdin_closed() -> bool:
    return bool(select.select([sys.stdin], [], [], 0)[0])


def main() -> None:
    settings = json.loads(sys.argv[1])
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(60))  # hardware waits for no program
    node, can = settings.get("i2c", "i2c-9"), settings.get("can", "vcan0")
    with (
        tempfile.TemporaryDirectory() as directory,
        open_nodes(BUSES, Path(directory), i2c_node=node, can_interface=can) as ports,
    ):
        server = MissionServer(ports, time.monotonic_ns)
        start_ns = time.monotonic_ns()
        bench = Bench(ports.buses, start_ns, settings)
        sys.stdout.write(json.dumps({**ports.urls, "start_ns": start_ns}) + "\n")
        sys.stdout.flush()
        server.run(bench, stdin_closed)
        done = {
            "imu_base": bench.imu.produced_by_enable,
            "can_sync": bench.box.produced,
            "joint_1": bench.joint.produced,
            "load_cell": bench.cell.produced,
            "server": server.summary(),
        }
        sys.stdout.write(json.dumps(done) + "\n")


if __name__ == "__main__":
    main()
