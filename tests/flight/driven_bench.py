"""A two-joint arm on simulated servo drives, its files, and an acquisition worker on it, in virtual time."""

from contextlib import ExitStack, closing

import numpy as np

from hil_sim.arm_rig import BUS, START_NS, ArmRig, RigMotor
from onboard import config
from onboard.flight.acquire.acquisition import Acquisition
from onboard.flight.acquire.arming import Arming
from onboard.flight.acquire.devices import open_devices
from onboard.flight.acquire.publisher import Publisher

MS = 1_000_000
INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
MOTORS = (RigMotor("shoulder", 1), RigMotor("elbow", 2, 0.2, 20_000, 777, True))
COUNTS = 500_000


def urdf(low=-1.0, high=1.0, speed=1.0):
    joints = "".join(
        f'<link name="link_{k}">{INERTIAL}</link><joint name="j{k}" type="revolute"><parent link="{parent}"/>'
        f'<child link="link_{k}"/><axis xyz="0 0 1"/>'
        f'<limit lower="{low}" upper="{high}" effort="50" velocity="{speed}"/></joint>'
        for k, parent in ((1, "base"), (2, "link_1"))
    )
    return f'<robot name="arm"><link name="base">{INERTIAL}</link>{joints}</robot>'


def swing(seconds=2.0, size=(0.5, -0.4), rows=101):
    """Times, and angles from (0, 0.2) and back."""
    time_s = np.linspace(0.0, seconds, rows)
    rise = 0.5 * (1.0 - np.cos(2.0 * np.pi * time_s / seconds))
    return time_s, np.stack([size[0] * rise, 0.2 + size[1] * rise], 1)


def csv_of(time_s, q, head="time_s,j1,j2"):
    return "\n".join([head, *(",".join(f"{value:.9g}" for value in row) for row in np.column_stack([time_s, q]))])


def swings_csv(seconds, rate_hz, start=(0.2, 0.4)):
    """A motion of joint_1 and joint_2 from ``start`` and back."""
    time_s = np.linspace(0.0, seconds, round(rate_hz * seconds) + 1)
    size = np.sin(np.pi * time_s / seconds) ** 2
    swings = np.stack([0.4 * size * np.sin(1.57 * time_s), 0.35 * size * np.sin(1.95 * time_s)], 1)
    return csv_of(time_s, start + swings, "time_s,joint_1,joint_2")


def files(directory, devices, csv=None, **limits):
    """Vehicle file of a two-joint arm on a bench with these tables, its URDF and its motion."""
    (directory / "arm.urdf").write_text(urdf(**limits))
    (directory / "motion.csv").write_text(csv_of(*swing()) if csv is None else csv)
    vehicle = 'name = "arm"\nurdf = "arm.urdf"\nbase = "fixed"\nbase_link = "base"'
    (directory / "vehicle.toml").write_text(f"[vehicle]\n{vehicle}\n{devices}")
    return directory / "vehicle.toml"


def written(directory, drive="", elbow="gain = -1.0", **said):
    devices = f"""
[bus.{BUS}]
url = "can+virtual://arm"
[device.can_sync]
kind = "canopen_sync"
bus = "{BUS}"
period_ms = 5
[device.shoulder]
kind = "cia402"
bus = "{BUS}"
node = 1
joint = "j1"
counts_per_revolution = {COUNTS}
noise_rad = 1e-5
driven = true
torque = true
[device.elbow]
kind = "cia402"
bus = "{BUS}"
node = 2
joint = "j2"
counts_per_revolution = 20000
zero_count = 777
noise_rad = 1e-5
driven = true
{elbow}
[drive]
armed = true
motion = "motion.csv"
{drive}
"""
    return files(directory, devices, **said)


class Kept(Publisher):
    """Keeps batches."""

    def __init__(self):
        super().__init__({})
        self.rows = {}

    def publish(self, batches):
        for channel, rows in batches:
            self.rows.setdefault(channel, []).append(rows.copy())

    def of(self, channel):
        return np.concatenate(self.rows[channel]) if channel in self.rows else np.zeros(0)


class Bench:
    """An arm, and an acquisition worker on it."""

    bus = BUS

    def __init__(self, directory, faults=(), arm=True, motors=MOTORS, change=None, **said):
        self.directory = directory
        written(directory, **said)
        self.rig = ArmRig(motors, faults)
        for name, do in (change or {}).items():
            do(self.rig.drives[name])
        self.arm, self.kept = arm, Kept()
        self.start()

    def start(self):
        vehicle = config.load(self.directory / "vehicle.toml").model_copy(update={"arm": self.arm})
        self.opened = open_devices(vehicle.with_urls({self.bus: self.rig.url}), lambda: self.rig.now_ns)
        self.kept.publish(self.opened.problems)
        self.worker = Acquisition(self.opened.devices, self.kept, Arming(vehicle, self.directory))
        self.worker.start(self.rig.now_ns)

    def run(self, seconds, pumped=True):
        end_ns = self.rig.now_ns + round(seconds * 1e9)
        while self.rig.now_ns < end_ns:
            self.rig.advance(self.rig.now_ns + 5 * MS // 2)  # two a SYNC: each is answered before the next
            if pumped:
                self.worker.step(self.rig.now_ns)
        return self

    def stop(self):
        self.worker.stop(self.rig.now_ns)
        self.rig.advance(self.rig.now_ns + 500 * MS)

    def close(self):
        self.opened.close()
        self.rig.__exit__()

    @property
    def codes(self):
        events = self.kept.of("event")
        return [code.decode() for code in events["code"] if code.startswith(b"drive_")] if len(events) else []

    def text(self, code):
        events = self.kept.of("event")
        return events["text"][events["code"] == code.encode()][0].decode()

    def axis(self, name):
        return self.rig.axes[name]

    def is_at_rest(self):
        angles = [axis.angle_rad(1e-9 * (self.rig.now_ns - START_NS)) for axis in self.rig.axes.values()]
        self.rig.advance(self.rig.now_ns + 500 * MS)
        later = [axis.angle_rad(1e-9 * (self.rig.now_ns - START_NS)) for axis in self.rig.axes.values()]
        return np.abs(np.subtract(angles, later)).max() < 1e-4


def closed_after(directory, kind):
    """Of a fixture: makes benches of this kind in ``directory`` and closes them afterwards."""
    with ExitStack() as stack:
        yield lambda **said: stack.enter_context(closing(kind(directory, **said)))
