"""The drive that moves its axis, against IEC 61800-7-201 and CiA 301 typed here; and ``canopen`` as its master."""

import math
import struct
import time

import pytest
from canopen.objectdictionary import ODRecord, ODVariable, datatypes
from canopen.profiles.p402 import BaseNode402, State402

from hil_sim.devices.canopen.servo402 import ServoDrive402
from hil_sim.faults import Fault, FaultPlan
from hil_sim.plants.drives.servo_axis import ServoAxis
from tests.hil_sim.devices.test_drive402 import dictionary, mask, network
from tests.hil_sim.devices.twin_bench import START_NS, CanRig

NODE, COUNTS = 5, 500_000
PER_RAD = COUNTS / math.tau
ENABLED, QUICK_STOP, FAULT, DISABLED = 0x27, 0x07, 0x08, 0x40
FORMS = {1: "2f", 2: "2b", 4: "23"}


class Bench:
    """A drive, booted, its target in RPDO2 on SYNC; ``sync`` sends one every 5 ms."""

    def __init__(self, faults=(), zero=0, reversed_count=False, **axis):
        self.axis = ServoAxis(**axis)
        plan = FaultPlan(faults, START_NS).of("drive")
        self.drive = ServoDrive402(
            NODE, self.axis, START_NS, zero_increments=zero, reversed_count=reversed_count, faults=plan
        )
        self.rig = CanRig(self.drive)
        self.rig.run(100)
        self.set(0x60C2, 1, 5, 1)
        self.set(0x60C2, 2, -3, 1)
        for index, sub, value, size in (
            *((0x1401, 1, 0x8000_0300 + NODE, 4), (0x1401, 2, 1, 1), (0x1601, 1, 0x607A_0020, 4), (0x1601, 0, 1, 1)),
            (0x1401, 1, 0x300 + NODE, 4),
        ):
            self.set(index, sub, value, size)
        self.rig.send(0x000, 1, NODE)
        self.rig.run(2)

    def ask(self, index, sub, value, size):
        data = (value & (1 << 8 * size) - 1).to_bytes(size, "little").ljust(4, bytes(1)).hex(" ")
        return self.rig.ask(NODE, f"{FORMS[size]} {index & 0xFF:02x} {index >> 8:02x} {sub:02x} {data}")

    def set(self, index, sub, value, size):
        answer = self.ask(index, sub, value, size)
        assert answer.startswith("60"), (hex(index), answer)

    def read(self, index, form="<i", sub=0):
        answer = bytes.fromhex(self.rig.ask(NODE, f"40 {index & 0xFF:02x} {index >> 8:02x} {sub:02x} 00 00 00 00"))
        return struct.unpack(form, answer[4 : 4 + struct.calcsize(form)])[0]

    def enable(self, mode=8):
        self.set(0x6060, 0, mode, 1)
        for word in (0x06, 0x07, 0x0F):
            self.word(word)
        assert self.state == ENABLED
        return self

    def word(self, word):
        self.rig.send(0x200 + NODE, word & 0xFF, word >> 8)
        return self.rig.run(1)

    def target(self, angle, syncs=1, per_sync=0.0):
        """Targets from ``angle`` on, one a SYNC."""
        frames = []
        for _ in range(syncs):
            self.rig.send(0x300 + NODE, *struct.pack("<i", round(angle * PER_RAD)))
            self.rig.send(0x080)
            frames += self.rig.run(5)
            angle += per_sync
        return frames

    @property
    def state(self):
        return mask(self.drive.statusword(self.rig.now_ns))

    @property
    def angle(self):
        return self.axis.angle_rad(self.seconds)

    @property
    def seconds(self):
        return (self.rig.now_ns - START_NS) * 1e-9


def emergencies(frames):
    return [int.from_bytes(frame.data[:2], "little") for frame in frames if frame.identifier == 0x080 + NODE]


@pytest.mark.parametrize(("zero", "reversed_count"), [(0, False), (1234, False), (0, True)])
def test_cyclic_position_follows_its_targets(zero, reversed_count):
    bench = Bench(zero=zero, reversed_count=reversed_count).enable()
    sense = -1.0 if reversed_count else 1.0
    bench.target(zero / PER_RAD, 200, per_sync=0.002)  # 0.4 rad/s
    wanted = sense * 0.002 * 198  # SYNC comes before the target that is sent with it, which waits for the next one
    assert bench.angle == pytest.approx(wanted, abs=0.004)
    bench.rig.run(300)
    assert bench.read(0x6064) == pytest.approx(zero + sense * bench.angle * PER_RAD, abs=2)
    assert bench.angle == pytest.approx(wanted, abs=2e-4), "it stands at its last target without SYNC"
    assert abs(bench.read(0x60F4)) <= 10
    assert bench.state == ENABLED


def test_what_it_answers_is_not_known_ahead():
    bench = Bench()
    assert bench.drive.answers(0) is None


def test_a_target_waits_for_sync_and_for_operational():
    bench = Bench().enable()
    bench.rig.send(0x300 + NODE, *struct.pack("<i", 5000))
    bench.rig.run(200)
    assert abs(bench.angle) < 1e-4
    bench.rig.send(0x080)
    bench.rig.run(500)
    assert bench.angle == pytest.approx(5000 / PER_RAD, abs=2e-4)
    bench.rig.send(0x000, 0x80, NODE)
    bench.target(0.5)
    bench.rig.run(200)
    assert bench.angle == pytest.approx(5000 / PER_RAD, abs=2e-4)


def test_nothing_moves_unless_it_is_enabled():
    bench = Bench()
    bench.target(0.3, 50)
    assert bench.axis.highest_rad == 0.0
    bench.enable()
    bench.word(0x07)
    bench.target(0.3, 50)
    assert bench.axis.highest_rad < 1e-6


def test_targets_are_cut_to_the_software_limits():
    bench = Bench()
    bench.set(0x607D, 1, round(-0.1 * PER_RAD), 4)
    bench.set(0x607D, 2, round(0.2 * PER_RAD), 4)
    bench.enable()
    bench.target(0.0, 150, per_sync=0.002)
    bench.rig.run(200)
    assert bench.angle == pytest.approx(0.2, abs=2e-4)
    assert bench.read(0x6041, "<H") & 0x0800  # internal limit
    assert bench.axis.highest_rad < 0.204


def test_a_jump_beyond_the_following_error_window_is_a_fault_and_the_brake_holds():
    bench = Bench()
    bench.set(0x6065, 0, round(0.02 * PER_RAD), 4)
    bench.set(0x6066, 0, 10, 2)
    bench.set(0x605E, 0, 0, 2)
    bench.enable()
    frames = bench.target(1.0, 30)
    assert emergencies(frames) == [0x8611]
    assert bench.state == FAULT
    stood = bench.angle
    assert stood < 0.2
    bench.rig.run(500)
    assert bench.angle == stood


@pytest.mark.parametrize(("option", "then"), [(2, DISABLED), (6, QUICK_STOP)])
def test_a_quick_stop_ramps_down_at_its_deceleration(option, then):
    bench = Bench()
    bench.set(0x605A, 0, option, 2)
    bench.set(0x6085, 0, round(2.0 * PER_RAD), 4)
    bench.enable()
    bench.target(0.0, 200, per_sync=0.004)  # 0.8 rad/s
    before = bench.angle
    bench.word(0x02)
    assert bench.state == QUICK_STOP
    bench.rig.run(600)
    assert bench.state == then
    assert bench.angle - before == pytest.approx(0.8**2 / (2 * 2.0), rel=0.1)  # v^2 / 2 a
    assert bench.axis.rate_rad_s == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize(
    ("option", "state"), [(0, ENABLED), (1, FAULT), (2, DISABLED), (3, DISABLED)], ids=["none", "fault", "off", "stop"]
)
def test_a_heartbeat_that_stops(option, state):
    bench = Bench()
    bench.set(0x1016, 1, 127 << 16 | 100, 4)
    bench.set(0x6007, 0, option, 2)
    bench.enable()
    bench.rig.run(200)
    assert bench.state == ENABLED, "no beat was heard yet: nobody is watched"
    for k in range(20):
        bench.rig.send(0x700 + 127, 5)
        assert emergencies(bench.target(0.002 * 10 * k, 10, per_sync=0.002)) == []
    assert bench.state == ENABLED
    assert 0x8130 in emergencies(bench.rig.run(90)) or 0x8130 in emergencies(bench.rig.run(40))
    bench.rig.run(600)
    assert bench.state == state
    assert bench.drive.state == 0x7F  # pre-operational, the default of 1029h
    stood = bench.angle
    bench.target(1.0, 20)
    assert bench.angle == pytest.approx(stood, abs=1e-4)


def test_profile_position_keeps_its_velocity_and_shakes_hands():
    bench = Bench()
    bench.set(0x6081, 0, round(0.5 * PER_RAD), 4)
    bench.set(0x6083, 0, round(2.0 * PER_RAD), 4)
    bench.set(0x6084, 0, round(2.0 * PER_RAD), 4)
    bench.enable(1)
    assert bench.read(0x6041, "<H") & 0x1400 == 0x0400  # reached, not acknowledged
    bench.set(0x607A, 0, round(0.4 * PER_RAD), 4)
    bench.rig.run(50)
    assert bench.axis.highest_rad < 1e-6, "a target without bit 4 is none"
    bench.word(0x1F)
    assert bench.read(0x6041, "<H") & 0x1400 == 0x1000
    bench.word(0x0F)
    assert not bench.read(0x6041, "<H") & 0x1000
    bench.rig.run(500)
    assert bench.axis.rate_rad_s == pytest.approx(0.5, abs=0.01)
    bench.word(0x10F)  # halt
    bench.rig.run(400)
    assert abs(bench.axis.rate_rad_s) < 0.01
    bench.word(0x0F)
    bench.rig.run(1000)
    assert bench.angle == pytest.approx(0.4, abs=1e-3)
    assert bench.read(0x6041, "<H") & 0x0400
    assert bench.axis.fastest_rad_s < 0.52


def test_torque_accelerates_the_axis_and_a_limit_stops_it():
    bench = Bench(inertia_kg_m2=2.0, coulomb_n_m=0.0, viscous_n_m_s=0.0)
    bench.set(0x607D, 1, round(-0.5 * PER_RAD), 4)
    bench.set(0x607D, 2, round(0.5 * PER_RAD), 4)
    bench.enable(10)
    bench.set(0x6071, 0, 100, 2)  # a tenth of 10 N m
    at_s, rate = bench.axis.newest_s, bench.axis.rate_rad_s
    bench.rig.run(300)
    assert (bench.axis.rate_rad_s - rate) / (bench.axis.newest_s - at_s) == pytest.approx(1.0 / 2.0, rel=1e-6)
    assert bench.read(0x6077, "<h") == 100
    assert emergencies(bench.rig.run(2500)) == [0x8612]
    assert bench.state == FAULT
    assert bench.axis.highest_rad < 0.6


def test_drive_fault_and_emergency_stop_of_the_vocabulary():
    bench = Bench(faults=[Fault("trip", "drive", 1.0, value=0x3210)]).enable()
    frames = bench.target(0.0, 250, per_sync=0.001)
    assert emergencies(frames) == [0x3210]
    assert bench.state == FAULT
    bench = Bench(faults=[Fault("emergency_stop", "drive", 1.0, 1.5)]).enable()
    frames = bench.target(0.0, 180, per_sync=0.001)
    assert emergencies(frames) == [0x5441]
    bench.word(0x80)
    assert bench.state == FAULT, "the button is in"
    bench.rig.run(600)
    bench.word(0x00)
    bench.word(0x80)
    assert bench.state == DISABLED


@pytest.mark.parametrize(("index", "sub", "value", "size"), [(0x605A, 0, 5, 2), (0x6007, 0, 4, 2), (0x6060, 0, 6, 1)])
def test_values_that_it_does_not_have_are_refused(index, sub, value, size):
    assert Bench().ask(index, sub, value, size).endswith("30 00 09 06")


def test_objects_that_an_rpdo_cannot_carry_are_refused():
    bench = Bench()
    assert bench.ask(0x1601, 1, 0x6064_0020, 4).endswith("00 00 01 06"), "the PDO exists"
    bench.set(0x1402, 1, 0x8000_0400 + NODE, 4)
    assert bench.ask(0x1602, 1, 0x6064_0020, 4).endswith("41 00 04 06"), "read only"
    bench.set(0x1602, 1, 0x607A_0020, 4)
    bench.set(0x1602, 0, 1, 1)
    bench.set(0x1402, 1, 0x400 + NODE, 4)
    bench.rig.send(0x400 + NODE, 1, 2)
    assert emergencies(bench.rig.run(5)) == [0x8210]


@pytest.mark.realtime
def test_canopen_p402_moves_it_by_profile_and_by_cyclic_targets():
    axis = ServoAxis()
    drive = ServoDrive402(NODE, axis, time.monotonic_ns())
    od = dictionary()
    record = ODRecord("rpdo 2", 0x1401), ODRecord("mapping 2", 0x1601)
    for one, subs in zip(record, ({0: 5, 1: 7, 2: 5}, {0: 5, **dict.fromkeys(range(1, 9), 7)}), strict=True):
        for sub, kind in subs.items():
            variable = ODVariable(f"{one.name} {sub}", one.index, sub)
            variable.data_type = kind
            one.add_member(variable)
        od.add_object(one)
    for index, kind in ((0x607A, datatypes.INTEGER32), (0x6081, datatypes.UNSIGNED32)):
        variable = ODVariable(f"object {index:04X}h", index)
        variable.data_type = kind
        od.add_object(variable)
    node = BaseNode402(NODE, od)
    with network(drive, "hil_servo", node) as net:
        node.sdo[0x1800][5].raw = 10
        node.setup_402_state_machine()
        node.nmt.state = "OPERATIONAL"
        net.sync.start(0.01)
        assert node.tpdo[1].wait_for_reception(2.0)
        node.op_mode = "PROFILED POSITION"
        node.state = "OPERATION ENABLED"
        assert node.op_mode == "PROFILED POSITION"
        node.sdo[0x6081].raw = round(PER_RAD)
        node.sdo[0x607A].raw = round(0.2 * PER_RAD)
        node.controlword = 0x1F
        until_s = time.monotonic() + 5.0
        while abs(node.sdo[0x6064].raw - 0.2 * PER_RAD) > 50 and time.monotonic() < until_s:
            time.sleep(0.02)
        assert node.sdo[0x6064].raw == pytest.approx(0.2 * PER_RAD, abs=50)
        assert axis.highest_rad == pytest.approx(0.2, abs=2e-3)
        node.controlword = State402.CW_QUICK_STOP  # the state of its name is over before a busy computer has seen it
        until_s = time.monotonic() + 5.0
        while node.state != "SWITCH ON DISABLED" and time.monotonic() < until_s:
            time.sleep(0.02)
        assert node.state == "SWITCH ON DISABLED"
