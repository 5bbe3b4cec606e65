"""A two-joint arm on simulated DYNAMIXEL servos, its files, and an acquisition worker on it, in virtual time."""

import tempfile
from contextlib import ExitStack
from pathlib import Path
from unittest import mock

from drivers import transports
from hil_sim.arm_rig import START_NS
from hil_sim.buses.in_process import in_process
from hil_sim.devices.serial_line.dynamixel import asks
from hil_sim.devices.serial_line.dynamixel_servo import DynamixelServo
from hil_sim.faults import FaultPlan
from hil_sim.plants.drives.servo_axis import ServoAxis
from hil_sim.scenario.bus_tables import SerialBusTable
from tests.flight.driven_bench import MS, Bench, Kept, files

LINE = "tty_servos"
SERVOS = {"shoulder": {"identifier": 1}, "elbow": {"identifier": 2, "turns": -1.0, "zero_count": 1777}}


def written(directory, drive="", servo="timeout_ms = 10", zero=1777, **said):
    devices = f"""
[bus.{LINE}]
url = "serial:///dev/{LINE}?baud=1000000"
[device.shoulder]
kind = "dynamixel"
bus = "{LINE}"
id = 1
joint = "j1"
zero_count = 2048
noise_rad = 7e-4
driven = true
torque = true
{servo}
[device.elbow]
kind = "dynamixel"
bus = "{LINE}"
id = 2
joint = "j2"
zero_count = {zero}
noise_rad = 7e-4
driven = true
gain = -1.0
{servo}
[drive]
armed = true
motion = "motion.csv"
following_error_rad = 0.25
{drive}
"""
    return files(directory, devices, **said)


class ServoRig:
    """Servos on one line, each with a joint of its own; ``hang_n_m``: what pulls at the shoulder. A context manager."""

    def __init__(self, faults=(), servos=SERVOS, angles=(0.0, 0.2), memory=None, **axis):
        self.now_ns = START_NS
        own = {"inertia_kg_m2": 0.05, "torque_n_m": 4.1, "brake_n_m": 0.0, "coulomb_n_m": 0.05, "viscous_n_m_s": 0.05}
        self.axes = {name: ServoAxis(at, **own | axis) for name, at in zip(servos, angles, strict=True)}
        self._stack = ExitStack()
        directory = Path(self._stack.enter_context(tempfile.TemporaryDirectory(prefix="hil_")))
        table = {LINE: SerialBusTable(kind="serial", baud_rate=1_000_000)}
        ports = self._stack.enter_context(in_process(table, directory, lambda: self.now_ns, name="servos"))
        self.url, self._bus, plan = ports.urls[LINE], ports.buses[LINE], FaultPlan(faults, START_NS)
        self.drives = {}
        for name, said in servos.items():
            self.drives[name] = DynamixelServo(self.axes[name], START_NS, faults=plan.of(name), return_delay=0, **said)
            self._bus.add(self.drives[name], asks=asks)
        self._bus.inject(plan.of(LINE))
        plan.check_all_taken()
        self._stack.enter_context(mock.patch.object(transports, "rest", self.rest))

    def rest(self, seconds):
        self.advance(self.now_ns + round(1e9 * seconds))

    def advance(self, now_ns):
        while self.now_ns < now_ns:
            self.now_ns = min(self.now_ns + MS, now_ns)
            self._bus.advance(self.now_ns)
            self._bus.look()
            for axis in self.axes.values():
                axis.advance(1e-9 * (self.now_ns - START_NS))

    def __exit__(self, *_):
        self._stack.close()


class ServoBench(Bench):
    """The arm, and an acquisition worker on it."""

    bus = LINE

    def __init__(self, directory, faults=(), arm=True, change=None, rig=None, **said):
        self.directory = directory
        written(directory, **said)
        self.rig = ServoRig(faults, **rig or {})
        self.rig.advance(START_NS + MS)  # they are powered up
        for name, do in (change or {}).items():
            do(self.rig.drives[name])
        self.arm, self.kept = arm, Kept()
        self.start()

    def run(self, seconds, pumped=True):
        end_ns = self.rig.now_ns + round(seconds * 1e9)
        while self.rig.now_ns < end_ns:
            self.rig.advance(self.rig.now_ns + MS)
            if pumped:
                self.worker.step(self.rig.now_ns)
        return self

    def is_at_rest(self, within=2e-3):
        """Within a count or so: a servo without an integral part settles slowly."""
        angles = [axis.angle_rad(1e-9 * (self.rig.now_ns - START_NS)) for axis in self.rig.axes.values()]
        self.rig.advance(self.rig.now_ns + 500 * MS)
        later = [axis.angle_rad(1e-9 * (self.rig.now_ns - START_NS)) for axis in self.rig.axes.values()]
        return max(abs(a - b) for a, b in zip(angles, later, strict=True)) < within

    def register(self, name, address, size=4):
        data = self.rig.drives[name].memory[address : address + size]
        return int.from_bytes(data, "little", signed=size > 1)
