"""What the CANopen twins send in PDOs, against CiA 301, 404 and 406; every byte of a frame typed here."""

import math
import struct

import pytest

from hil_sim.devices.canopen.arm_controller import ArmController
from hil_sim.devices.canopen.encoder406 import Encoder406
from tests.hil_sim.devices.canopen_rig import COUNTS, booted, cell, encoder, of, operational, sync
from tests.hil_sim.devices.twin_bench import MS, START_NS, Analog

# TPDO


def test_sync_gets_the_position_at_its_end_after_the_load_cell():
    angle = Analog(lambda t: 10 * t)
    joint = Encoder406(1, angle, START_NS, zero_count=1_000_000)
    rig = operational(joint, cell(lambda t: -3.0))
    rig.ask(1, "23 00 18 01 81 01 00 80")  # TPDO1 off
    frames = sync(rig, 7)
    assert [frame.identifier for frame in frames] == [0x182, 0x281]
    assert frames[0].data == struct.pack("<iB", -30_000, 0)
    sampled_s = angle.times_s[-1]
    sync_start_s = (rig.now_ns - 5 * MS - START_NS) * 1e-9
    assert 100e-6 < sampled_s - sync_start_s < 125e-6  # one byte at 500 kbit/s: 52 to 62 bits
    expected = 1_000_000 + round(10 * sampled_s * COUNTS / math.tau)
    assert frames[1].data == struct.pack("<I", expected)
    assert frames[1].end_ns - START_NS < sync_start_s * 1e9 + 0.6 * MS
    assert joint.produced == 1


@pytest.mark.parametrize(("angle", "count"), [(-1e-9, 0), (-math.tau, 2**32 - COUNTS), (-math.tau / COUNTS, 2**32 - 1)])
def test_position_wraps_as_a_u32(angle, count):
    rig = operational(encoder(lambda t: angle))
    assert of(sync(rig), 0x281)[0].data == struct.pack("<I", count)


def test_code_sequence_scaling_and_preset():
    rig = booted(encoder(lambda t: math.tau / 4))
    read = "40 04 60 00 00 00 00 00"
    assert rig.ask(1, read) == "43 04 60 00 48 e8 01 00"  # 125,000
    rig.ask(1, "2B 00 60 00 05 00 00 00")
    assert rig.ask(1, read) == "43 04 60 00 b8 17 fe ff"
    rig.ask(1, "2B 00 60 00 04 00 00 00")
    rig.ask(1, "23 01 60 00 E8 03 00 00")  # 1000 a revolution
    assert rig.ask(1, read) == "43 04 60 00 fa 00 00 00"
    rig.ask(1, "2B 00 60 00 00 00 00 00")  # scaling off: physical resolution
    assert rig.ask(1, read) == "43 04 60 00 48 e8 01 00"
    rig.ask(1, "23 03 60 00 2A 00 00 00")
    assert rig.ask(1, read) == "43 04 60 00 2a 00 00 00"
    assert rig.ask(1, "23 01 60 00 00 00 00 00").startswith("80")
    assert rig.ask(1, "2B 00 60 00 10 00 00 00").startswith("80")


def test_event_timer_is_6200h_and_zero_stops_it():
    node = encoder()
    rig = operational(node)
    assert len(of(rig.frames, 0x181)) == 1  # on entering Operational
    assert len(of(rig.run(100), 0x181)) == 5  # 20 ms
    assert rig.ask(1, "2B 00 62 00 0A 00 00 00") == "60 00 62 00 00 00 00 00"
    assert rig.ask(1, "40 00 18 05 00 00 00 00") == "4b 00 18 05 0a 00 00 00"
    assert 9 <= len(of(rig.run(100), 0x181)) <= 11
    rig.ask(1, "2B 00 62 00 00 00 00 00")
    assert of(rig.run(200), 0x181) == []
    assert node.produced_cyclic == len(of(rig.frames, 0x181))


@pytest.mark.parametrize("object_", ["00 18 01 81 01 00 80", "00 18 01 81 01 00 C0"])
def test_bit_31_takes_the_pdo_away(object_):
    rig = operational(encoder())
    rig.ask(1, f"23 {object_}")
    assert of(rig.run(200), 0x181) == []
    rig.ask(1, "23 00 18 01 81 01 00 00")
    assert len(of(rig.run(200), 0x181)) >= 9


def test_every_nth_sync():
    rig = booted(encoder())
    rig.ask(1, "2F 01 18 02 03 00 00 00")
    rig.send(0x000, 1, 1)
    rig.run(1)
    answered = [bool(of(sync(rig), 0x281)) for _ in range(9)]
    assert answered == [False, False, True] * 3


def test_sync_start_value_picks_the_first_sync():
    rig = booted(encoder())
    rig.ask(1, "23 01 18 01 81 02 00 80")
    rig.ask(1, "2F 01 18 06 05 00 00 00")
    rig.ask(1, "2F 01 18 02 02 00 00 00")
    rig.ask(1, "23 01 18 01 81 02 00 00")
    rig.send(0x000, 1, 1)
    rig.run(1)
    answered = [counter for counter in range(1, 11) if of(sync(rig, counter), 0x281)]
    assert answered == [6, 8, 10]  # 5 counts as the first


def test_remapping_by_the_book():
    rig = booted(cell(lambda t: 0.5))
    disable, enable = "23 00 18 01 82 01 00 80", "23 00 18 01 82 01 00 00"
    assert rig.ask(2, "23 00 1A 01 20 01 00 91").startswith("80")  # the PDO exists
    for request in (disable, "2F 00 1A 00 00 00 00 00", "23 00 1A 01 08 01 50 61", "23 00 1A 02 20 01 00 91"):
        assert rig.ask(2, request).startswith("60")
    assert rig.ask(2, "23 00 1A 03 20 00 00 10")[-11:] == "41 00 04 06"  # 1000h cannot be mapped
    assert rig.ask(2, "23 00 1A 03 10 01 00 91")[-11:] == "41 00 04 06"  # 16 bits of an I32
    assert rig.ask(2, "23 00 1A 03 20 00 77 77")[-11:] == "00 00 02 06"  # no such object
    assert rig.ask(2, "23 00 1A 03 20 01 30 91").startswith("60")
    assert rig.ask(2, "2F 00 1A 00 03 00 00 00")[-11:] == "42 00 04 06"  # nine bytes
    assert rig.ask(2, "2F 00 1A 00 02 00 00 00").startswith("60")
    assert rig.ask(2, "23 00 1A 01 08 01 50 61")[-11:] == "00 00 01 06"  # a mapping in use
    assert rig.ask(2, enable).startswith("60")
    rig.send(0x000, 1, 2)
    rig.run(1)
    (frame,) = sync(rig)
    assert frame.data == bytes([0]) + struct.pack("<i", round(0.5 / 50 * (2**23 - 1)))


def test_another_sync_identifier():
    rig = booted(encoder())
    rig.ask(1, "23 05 10 00 90 00 00 00")
    rig.send(0x000, 1, 1)
    rig.run(1)
    assert of(sync(rig), 0x281) == []
    rig.send(0x090)
    assert len(of(rig.run(5), 0x281)) == 1


def test_only_operational_answers_sync():
    node = encoder()
    rig = booted(node)
    assert sync(rig, 1) == []
    assert node.produced == 0


# Load cell


@pytest.mark.parametrize(
    ("force", "flags", "value", "status"),
    [
        (12.34567, False, 123_457, 0),
        (-12.34567, False, -123_457, 0),
        (80.0, False, 500_000, 0),
        (-80.0, True, -500_000, 1),
        (49.9999, True, 499_999, 0),
    ],
)
def test_value_and_clipping(force, flags, value, status):
    rig = operational(cell(lambda t: force, flags_overload=flags))
    assert of(sync(rig), 0x182)[0].data == struct.pack("<iB", value, status)


def test_decimals():
    rig = booted(cell(lambda t: 1.23456))
    for decimals, counts in ((0, 1), (3, 1235), (6, 1_234_560)):
        rig.ask(2, f"2F 32 61 01 0{decimals} 00 00 00")
        assert rig.ask(2, "40 30 91 01 00 00 00 00") == "43 30 91 01 " + struct.pack("<i", counts).hex(" ")
    assert rig.ask(2, "2F 32 61 01 07 00 00 00").startswith("80")


def test_auto_zero_takes_the_word_zero_and_nothing_else():
    rig = booted(cell(lambda t: 2.0))
    assert rig.ask(2, "22 25 61 01 7A 65 72 6E").startswith("80")
    assert rig.ask(2, "40 30 91 01 00 00 00 00") == "43 30 91 01 20 4e 00 00"
    assert rig.ask(2, "22 25 61 01 7A 65 72 6F") == "60 25 61 01 00 00 00 00"
    assert rig.ask(2, "40 30 91 01 00 00 00 00") == "43 30 91 01 00 00 00 00"


# Arm controller


def test_phase_changes_are_events():
    arm = ArmController(3, [(0.05, 1), (0.5, 3), (0.6, 5)], START_NS)
    rig = booted(arm)
    assert of(rig.frames, 0x183) == []
    rig.send(0x000, 1, 0)
    assert [f.data for f in of(rig.run(10), 0x183)] == [b"\x01\x01"]  # on entering Operational
    frames = of(rig.run(1000), 0x183)
    assert [f.data for f in frames] == [b"\x03\x02", b"\x05\x03"]
    assert [round((f.end_ns - START_NS) / MS) for f in frames] == [500, 600]
    assert arm.produced == 3


def test_arm_controller_objects():
    rig = booted(ArmController(3, [], START_NS))
    for request, answer in (
        ("40 00 10 00", "43 00 10 00 00 00 00 00"),
        ("40 00 20 00", "4f 00 20 00 02 00 00 00"),
        ("40 00 20 01", "4f 00 20 01 00 00 00 00"),
        ("40 00 20 02", "4f 00 20 02 00 00 00 00"),
        ("40 00 18 02", "4f 00 18 02 ff 00 00 00"),
        ("40 00 1a 01", "43 00 1a 01 08 01 00 20"),
        ("40 00 1a 02", "43 00 1a 02 08 02 00 20"),
    ):
        assert rig.ask(3, request + " 00 00 00 00") == answer


def test_an_nmt_reset_leaves_the_sequence_alone():
    rig = operational(ArmController(3, [(0.05, 4)], START_NS))
    rig.send(0x000, 129, 3)
    rig.run(20)
    assert rig.ask(3, "40 00 20 01 00 00 00 00") == "4f 00 20 01 04 00 00 00"
    assert rig.ask(3, "40 00 20 02 00 00 00 00") == "4f 00 20 02 01 00 00 00"


def test_phases_out_of_order_are_refused():
    with pytest.raises(ValueError, match="order"):
        ArmController(3, [(1.0, 1), (0.5, 2)], START_NS)


def test_inhibit_time_holds_an_event_back_and_joins_what_follows():
    rig = booted(ArmController(3, [(0.30, 1), (0.31, 2), (0.32, 3), (0.5, 4)], START_NS))
    rig.ask(3, "23 00 18 01 83 01 00 80")
    rig.ask(3, "2B 00 18 03 E8 03 00 00")  # 100 ms
    rig.ask(3, "23 00 18 01 83 01 00 00")
    rig.send(0x000, 1, 3)
    rig.run(100)
    frames = of(rig.run(1000), 0x183)
    assert [(round((f.end_ns - START_NS) / MS), f.data[0]) for f in frames] == [(300, 1), (400, 3), (500, 4)]
