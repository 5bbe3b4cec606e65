"""The master of torques on simulated servo drives, in virtual time: what it sends, and what stops it."""

from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import pytest

from drivers.canopen_pdo.bus import CanopenBus
from drivers.canopen_pdo.play.drive_axis import Cia402AxisConfig
from drivers.canopen_pdo.play.torque_master import TorqueConfig
from drivers.canopen_pdo.profiles.cia402 import Cia402Config
from drivers.canopen_pdo.sync import SyncConfig
from drivers.errors import ConfigurationError
from drivers.records import EVENT
from drivers.transports import open_can
from hil_sim.arm_rig import ArmRig, RigMotor
from hil_sim.faults import Fault

MS = 1_000_000
COUNTS = 500_000
PER_RAD = COUNTS / (2.0 * np.pi)
ENABLED = 0x27


def axis(name, node, rate=3.0):
    drive = Cia402Config(node, COUNTS, position=name, status=f"{name}_status")
    motion = (rate * PER_RAD, 10.0 * PER_RAD, 10.0 * PER_RAD)
    return Cia402AxisConfig(drive, f"{name}_sent", round(-2.0 * PER_RAD), round(2.0 * PER_RAD), *motion, 1000, 1000)


class Bench:
    """Two drives; the law is given, and what it was asked is kept."""

    def __init__(self, law, faults=(), reversed_count=False, **limits):
        self.asked = []
        self.rig = ArmRig([RigMotor("a", 1, reversed_count=reversed_count), RigMotor("b", 2)], faults)

        def keeping(tick, counts):
            self.asked.append((tick, list(counts)))
            return law(tick, counts)

        config = TorqueConfig((axis("a", 1, **limits), axis("b", 2)), keeping)
        self.port = open_can(self.rig.url, lambda: self.rig.now_ns)
        nodes = [one.drive for one in config.axes]
        self.bus = CanopenBus(self.port, nodes, SyncConfig(period_ms=5.0), play=config)
        self.master, self.said = self.bus.player, []
        self.bus.start(self.rig.now_ns)
        self.master.arm()

    def run(self, seconds):
        end_ns = self.rig.now_ns + round(seconds * 1e9)
        while self.rig.now_ns < end_ns:
            self.rig.advance(self.rig.now_ns + MS)
            batches = self.bus.pump(self.rig.now_ns)
            self.said += [row["text"].decode() for b in batches if b.rows.dtype == EVENT for row in b.rows]
        return self

    def close(self):
        self.port.close()
        self.rig.__exit__()

    @property
    def states(self):
        return {name: drive.drive_state for name, drive in self.rig.drives.items()}


@pytest.fixture
def made():
    with ExitStack() as stack:

        def make(*arguments, **options):
            bench = Bench(*arguments, **options)
            stack.callback(bench.close)
            return bench

        yield make


@pytest.mark.parametrize("sense", [1, -1])
def test_a_torque_accelerates_the_joint_by_its_inertia(made, sense):
    """200 thousandths of 10 N m, less the rig's friction of 0.3 and 0.5 dq, on 1 kg m^2."""
    bench = made(lambda tick, counts: [200, 0], reversed_count=sense < 0).run(1.5)
    assert bench.master.is_running
    first = next(k for k, (_, counts) in enumerate(bench.asked) if abs(counts[0]) > 50)
    ticks, counts = zip(*bench.asked[first:], strict=True)
    assert np.diff(ticks) == pytest.approx(np.ones(len(ticks) - 1))
    time_s = 5e-3 * np.arange(len(ticks))
    speed = 1.7 / 0.5 * (1.0 - np.exp(-0.5 * time_s))
    rate = np.gradient([c[0] for c in counts], 5e-3) / PER_RAD
    inside = rate < 1.5
    assert inside.sum() > 50
    assert rate[inside][5:-5] == pytest.approx(speed[inside][5:-5] + rate[0], abs=0.08)
    assert np.sign(bench.rig.axes["a"].rate_rad_s) == sense
    assert abs(bench.rig.axes["b"].angle_rad(bench.rig.axes["b"].newest_s)) < 1e-3


def test_a_law_that_says_why_ends_in_a_quick_stop_of_all(made):
    bench = made(lambda tick, counts: "enough" if counts[0] > 20_000 else [300, 100]).run(2.5)
    assert bench.master.has_stopped
    assert bench.master.stopped_by == "enough"
    assert ENABLED not in bench.states.values()
    assert [axis.rate_rad_s for axis in bench.rig.axes.values()] == pytest.approx([0.0, 0.0], abs=1e-3)
    asked = len(bench.asked)
    assert len(bench.run(0.5).asked) == asked > 10


@pytest.mark.parametrize(
    ("fault", "why"),
    [
        (Fault("trip", "b", 1.5), "b reports 2310h"),
        (Fault("silent", "b", 1.5, 1.8), "b has not answered SYNC"),
        (Fault("off", "sync_box", 1.5, 9.0), "no SYNC for"),
        (Fault("reset", "a", 1.5, 1.6), "a "),
        pytest.param(
            Fault("frame_drop", "can_0", 1.5, 1.7, 0x080), "no SYNC for", marks=pytest.mark.campaign
        ),  # as off
    ],
    ids=lambda value: getattr(value, "kind", ""),
)
def test_what_breaks_stops_all_drives(made, fault, why):
    bench = made(lambda tick, counts: [20, 20], [fault]).run(1.4)
    assert bench.master.is_running
    bench.run(1.5)
    assert why in bench.master.stopped_by
    assert ENABLED not in bench.states.values()
    assert max(abs(axis.rate_rad_s) for axis in bench.rig.axes.values()) < 1e-3


def test_a_joint_that_is_too_fast_is_stopped(made):
    bench = made(lambda tick, counts: [1500, 0], rate=0.5).run(2.0)
    assert "a moves at" in bench.master.stopped_by
    assert bench.rig.axes["a"].fastest_rad_s < 1.2


def test_a_master_that_dies_leaves_drives_that_stop_by_themselves(made):
    bench = made(lambda tick, counts: [200, 0]).run(1.2)
    assert bench.master.is_running
    for _ in range(300):
        bench.rig.advance(bench.rig.now_ns + 5 * MS)
    assert ENABLED not in bench.states.values()
    assert abs(bench.rig.axes["a"].rate_rad_s) < 1e-3


def test_a_number_that_a_drive_has_is_refused_for_the_master():
    with pytest.raises(ConfigurationError, match="master node 1"):
        replace(axis("a", 1), master=1)
