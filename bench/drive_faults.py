"""An arm driven through random faults: it never moves outside its limits, and stands at the end.

    python -m bench.drive_faults [--runs 1000] [--first 1] [--verbose]

Every run is another arm (two or three joints; ranges, counts, zeros, directions, rates, motors), another motion, which
goes to the end of what it may use in half of the runs, cyclic or by way points, and one to three faults at random
times, of a drive, the SYNC producer, the bus or the flight computer: killed, killed and started again, stopped by
SIGTERM, stalled. The flight computer is the acquisition worker with its vehicle file, URDF and CSV, in virtual time;
the drives are ``hil_sim``'s. The limits are those of the URDF; the file's margin is the default.

Not among the faults: a drive whose only encoder lies (``stuck``, ``wrong``). Nothing on the bus shows an encoder that
freezes while the arm is held, and the motor runs away; a second encoder or a limit switch is needed. Exit code 1 where
an axis left its limits or did not come to rest.
"""

import argparse
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drivers.records import Batch
from hil_sim.arm_rig import BUS, START_NS, ArmRig, RigMotor
from hil_sim.faults import Fault, FaultKind
from onboard import config
from onboard.flight.acquire.acquisition import Acquisition
from onboard.flight.acquire.arming import Arming
from onboard.flight.acquire.devices import OpenDevices, open_devices
from onboard.flight.acquire.publisher import Publisher

PERIOD_S = 0.005
BEGIN_S = 1.4  # about when the motion begins: boot, set-up, enabling, blending
AFTER_S = 2.5
REST_RAD_S = 1e-3
MARGIN_RAD = 0.05  # the default of [drive]
DRIVE = ("off", "reset", "silent", "intermittent", "garbage", "slow", "delayed", "trip", "emergency_stop")
BOX = ("off", "reset", "silent", "intermittent", "wrong", "garbage", "slow", "clock_jump")
WIRE = ("frame_drop", "bus_off", "error_frames", "flood")
HOST = ("kill", "restart", "sigterm", "stall")
COUNTS = (4_000, 20_000, 500_000, 1_048_576)


class MotorJoint(NamedTuple):
    """One joint as the URDF has it, and its motor."""

    motor: RigMotor
    low: float
    high: float
    rate: float


class FaultFlight(NamedTuple):
    """One run.

    Attributes:
        seed: Its.
        faults: What broke.
        beyond_rad: How far an axis was outside its limits; negative: how far it stayed inside.
        moved_rad: How far the axis went that went furthest.
        rest_rad_s: Rate of the fastest axis at the end.
        fastest: Largest rate over the joint's limit.
        codes: Events of the player.
    """

    seed: int
    faults: tuple[str, ...]
    beyond_rad: float
    moved_rad: float
    rest_rad_s: float
    fastest: float
    codes: tuple[str, ...]

    @property
    def is_safe(self) -> bool:
        """Never outside, and at rest."""
        return self.beyond_rad <= 0.0 and self.rest_rad_s <= REST_RAD_S


def fly(seed: int) -> FaultFlight:
    """One run."""
    rng = np.random.default_rng([seed, 0xD4])
    seconds = float(rng.uniform(1.5, 3.0))
    joints = _joints(rng)
    time_s, q = _motion(rng, joints, seconds)
    stands = q[0] + rng.uniform(-0.03, 0.03, len(joints))
    joints = [j._replace(motor=j.motor._replace(angle_rad=float(at))) for j, at in zip(joints, stands, strict=True)]
    mode = "profile" if rng.random() < 0.2 else "cyclic"
    faults, host = _faults(rng, joints, BEGIN_S + seconds + 0.5)
    with tempfile.TemporaryDirectory(prefix="drive_") as name:
        directory = Path(name)
        _write(directory, joints, mode, time_s, q)
        with ArmRig([joint.motor for joint in joints], faults, seed=seed) as rig:
            end_ns = START_NS + round(1e9 * (BEGIN_S + seconds + AFTER_S))
            heard = _drive(rig, directory, host, end_ns)
            rig.advance(rig.now_ns + 2_500_000_000)
            axes = [rig.axes[joint.motor.name] for joint in joints]
            return FaultFlight(
                seed,
                tuple(f"{fault.kind}:{fault.device}" for fault in faults) + tuple(kind for kind, _, _ in host),
                max(max(j.low - a.lowest_rad, a.highest_rad - j.high) for j, a in zip(joints, axes, strict=True)),
                max(a.highest_rad - a.lowest_rad for a in axes),
                max(abs(a.rate_rad_s) for a in axes),
                max(a.fastest_rad_s / j.rate for j, a in zip(joints, axes, strict=True)),
                tuple(code for code in heard if code.startswith("drive_")),
            )


# The flight computer


class _Kept(Publisher):
    """Keeps the codes of events."""

    def __init__(self) -> None:
        super().__init__({})
        self.codes: list[str] = []
        self.texts: list[str] = []

    def publish(self, batches: Iterable[Batch]) -> None:
        for batch in batches:
            if batch.channel == "event":
                self.codes += [row["code"].decode() for row in batch.rows]
                self.texts += [f"{row['code'].decode()}: {row['text'].decode()}" for row in batch.rows]


class _Computer:
    """An acquisition process on the rig."""

    def __init__(self, rig: ArmRig, directory: Path, kept: _Kept) -> None:
        vehicle = config.load(directory / "vehicle.toml").model_copy(update={"arm": True})
        self.opened: OpenDevices = open_devices(vehicle.with_urls({BUS: rig.url}), lambda: rig.now_ns)
        kept.publish(self.opened.problems)
        self.acquisition = Acquisition(self.opened.devices, kept, Arming(vehicle, directory))
        self.acquisition.start(rig.now_ns)


def _drive(rig: ArmRig, directory: Path, host: list[tuple[str, int, int]], end_ns: int) -> list[str]:
    kept = _Kept()
    computer: _Computer | None = _Computer(rig, directory, kept)
    away_ns = 0  # it does nothing until then
    while rig.now_ns < end_ns:
        rig.advance(rig.now_ns + round(1e9 * PERIOD_S))
        for kind, at_ns, until_ns in host:
            if not at_ns <= rig.now_ns < at_ns + 1e9 * PERIOD_S:
                continue
            if kind == "sigterm" and computer is not None:
                computer.acquisition.stop(rig.now_ns)
            if kind == "stall":
                away_ns = until_ns
            elif computer is not None:
                computer.opened.close()
                computer, away_ns = None, until_ns if kind == "restart" else end_ns + 1
        if rig.now_ns < away_ns:
            continue
        if computer is None:
            computer = _Computer(rig, directory, kept)
        computer.acquisition.step(rig.now_ns)
    if computer is not None:
        computer.acquisition.stop(rig.now_ns)
        rig.advance(rig.now_ns + 10_000_000)
        computer.opened.close()
    return kept.codes


# What is drawn


def _joints(rng: np.random.Generator) -> list[MotorJoint]:
    joints = []
    for k in range(int(rng.integers(2, 4))):
        low, high = -rng.uniform(0.2, 2.0), rng.uniform(0.2, 2.0)
        torque = 10.0 ** rng.uniform(0.7, 1.7)
        motor = RigMotor(
            f"joint_{k + 1}",
            k + 1,
            0.0,
            int(rng.choice(COUNTS)),
            int(rng.integers(-100_000, 100_000)),
            bool(rng.random() < 0.4),
            float(torque),
            float(torque / rng.uniform(10.0, 40.0)),
        )
        joints.append(MotorJoint(motor, float(low), float(high), float(rng.uniform(0.3, 1.0))))
    return joints


def _motion(rng: np.random.Generator, joints: list[MotorJoint], seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) and angles (n, joints): swings that begin and end at rest, within range, rate and acceleration."""
    time_s = np.linspace(0.0, seconds, 150)
    window = np.sin(np.pi * time_s / seconds) ** 2
    columns = []
    for joint in joints:
        shape = window * sum(
            rng.standard_normal() * np.sin(2 * np.pi * f * time_s / seconds + rng.uniform(0, 6)) for f in (0.5, 1, 2)
        )
        step = time_s[1]
        rate = np.abs(np.diff(shape)).max() / step
        bend = np.abs(np.diff(shape, 2)).max() / step**2
        low, high = joint.low + MARGIN_RAD + 0.03, joint.high - MARGIN_RAD - 0.03  # it may stand 0.03 beside its start
        size = min(0.9 * joint.rate / rate, 3.5 / bend, (high - low) / np.ptp(shape))
        shape *= size * (1.0 if rng.random() < 0.5 else rng.uniform(0.2, 1.0))
        least, most = low - shape.min(), high - shape.max()  # of its start
        start = rng.choice((least, most)) if rng.random() < 0.5 else rng.uniform(least, most)
        columns.append(start + shape)
    return time_s, np.stack(columns, 1)


def _faults(
    rng: np.random.Generator, joints: list[MotorJoint], until_s: float
) -> tuple[list[Fault], list[tuple[str, int, int]]]:
    faults: list[Fault] = []
    host: list[tuple[str, int, int]] = []
    for _ in range(int(rng.integers(1, 4))):
        start_s = float(rng.uniform(0.3 if rng.random() < 0.2 else BEGIN_S, until_s))
        end_s = start_s + float(10.0 ** rng.uniform(-2.0, 0.3))
        where = rng.choice(("drive", "box", "wire", "host"), p=(0.45, 0.15, 0.2, 0.2))
        if where == "host" and not host:
            host.append((str(rng.choice(HOST)), START_NS + round(1e9 * start_s), START_NS + round(1e9 * end_s)))
            continue
        kinds, device = {
            "drive": (DRIVE, str(rng.choice([j.motor.name for j in joints]))),
            "box": (BOX, "sync_box"),
        }.get(where, (WIRE, BUS))
        kind = FaultKind(str(rng.choice(kinds)))
        if any(other.device == device and {other.kind, kind} & {FaultKind.OFF, FaultKind.RESET} for other in faults):
            continue
        faults.append(Fault(kind, device, start_s, end_s, _value(rng, kind)))
    return faults, host


def _value(rng: np.random.Generator, kind: FaultKind) -> float:
    values = {
        FaultKind.INTERMITTENT: 10.0 ** rng.uniform(-2.0, -0.5),
        FaultKind.SLOW: 10.0 ** rng.uniform(-3.0, -1.0),
        FaultKind.DELAYED: 10.0 ** rng.uniform(-3.0, -1.3),
        FaultKind.TRIP: float(rng.choice((0x2310, 0x3210, 0x4210, 0x7305, 0x8130))),
        FaultKind.WRONG: float(rng.integers(1, 200)),
        FaultKind.CLOCK_JUMP: float(rng.choice((-1.0, 1.0)) * 10.0 ** rng.uniform(-3.0, 0.0)),
        FaultKind.ERROR_FRAMES: 10.0 ** rng.uniform(-3.0, -1.0),
        FaultKind.FLOOD: float(rng.integers(0, 0x100)),
        FaultKind.FRAME_DROP: float(rng.choice((0, 0x80, 0x181, 0x182, 0x581, 0x701))),
    }
    return float(values.get(kind, 0.0))


def _write(directory: Path, joints: list[MotorJoint], mode: str, time_s: np.ndarray, q: np.ndarray) -> None:
    """Vehicle file, URDF and CSV."""
    links, devices, inertial = (
        "",
        "",
        '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>',
    )
    for k, joint in enumerate(joints):
        motor, parent = joint.motor, "base" if k == 0 else f"link_{k}"
        links += (
            f'<link name="link_{k + 1}">{inertial}</link><joint name="j{k + 1}" type="revolute">'
            f'<parent link="{parent}"/>'
            f'<child link="link_{k + 1}"/><axis xyz="0 0 1"/><limit lower="{joint.low!r}" upper="{joint.high!r}" '
            f'effort="50" velocity="{joint.rate!r}"/></joint>\n'
        )
        devices += (
            f'[device.{motor.name}]\nkind = "cia402"\nbus = "{BUS}"\nnode = {motor.node}\njoint = "j{k + 1}"\n'
            f"counts_per_revolution = {motor.counts}\nzero_count = {motor.zero}\nnoise_rad = 1e-5\ndriven = true\n"
            f"gain = {-1.0 if motor.reversed_count else 1.0}\n"
        )
    (directory / "arm.urdf").write_text(f'<robot name="arm"><link name="base">{inertial}</link>{links}</robot>')
    (directory / "vehicle.toml").write_text(
        f'[vehicle]\nname = "arm"\nurdf = "arm.urdf"\nbase = "fixed"\nbase_link = "base"\n'
        f'[bus.{BUS}]\nurl = "can+virtual://arm"\n[device.can_sync]\nkind = "canopen_sync"\nbus = "{BUS}"\n'
        f'period_ms = {1e3 * PERIOD_S:g}\n{devices}[drive]\narmed = true\nmotion = "motion.csv"\nmode = "{mode}"\n'
    )
    if mode == "profile":
        time_s, q = time_s[::20], q[::20]
    rows = [",".join(["time_s", *(f"j{k + 1}" for k in range(len(joints)))])]
    rows += [",".join(f"{value:.9g}" for value in row) for row in np.column_stack([time_s, q])]
    (directory / "motion.csv").write_text("\n".join(rows) + "\n")


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--first", type=int, default=1, help="seed of the first run")
    parser.add_argument("--verbose", action="store_true")
    arguments = parser.parse_args()
    outcomes: list[FaultFlight] = []
    for seed in range(arguments.first, arguments.first + arguments.runs):
        one = fly(seed)
        outcomes.append(one)
        if arguments.verbose or not one.is_safe:
            print(one, flush=True)
    codes = Counter(code for one in outcomes for code in set(one.codes))
    kinds = Counter(fault.split(":")[0] for one in outcomes for fault in one.faults)
    moved = [one for one in outcomes if one.moved_rad > 0.02]
    print(f"{len(outcomes)} runs, {len(moved)} moved, {sum(not one.is_safe for one in outcomes)} unsafe")
    print("events, runs with:", dict(codes.most_common()))
    print("faults:", dict(kinds.most_common()))
    closest = max(one.beyond_rad for one in outcomes)
    print(f"nearest to a limit of the URDF: {-closest:.4f} rad inside (margin 0.05)")
    print(f"largest rate over its limit: {max(one.fastest for one in outcomes):.2f}")
    return 0 if moved and all(one.is_safe for one in outcomes) else 1


if __name__ == "__main__":
    sys.exit(main())
