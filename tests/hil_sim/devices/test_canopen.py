"""The CANopen twins against CiA 301, 404 and 406; every byte of a frame typed here."""

import itertools
import math
import struct

import pytest

from hil_sim.devices.canopen.arm_controller import ArmController
from hil_sim.devices.canopen.canopen_node import CanopenNode
from hil_sim.devices.canopen.encoder406 import Encoder406
from hil_sim.devices.canopen.loadcell404 import LoadCell404
from hil_sim.faults import Fault, FaultError, FaultPlan
from tests.hil_sim.devices.twin_bench import MS, START_NS, Analog, CanRig

COUNTS = 500_000


def plan(*faults):
    return FaultPlan(faults, START_NS).of("node")


def encoder(angle=lambda t: 0.0, **options):
    return Encoder406(1, Analog(angle), START_NS, **options)


def cell(force=lambda t: 0.0, **options):
    return LoadCell404(2, Analog(force), START_NS, **options)


def booted(*nodes):
    rig = CanRig(*nodes)
    rig.run(100)
    return rig


def operational(*nodes):
    rig = booted(*nodes)
    rig.send(0x000, 1, 0)
    rig.run(1)
    return rig


def of(frames, identifier):
    return [frame for frame in frames if frame.identifier == identifier]


def sync(rig, counter=None, ms=5.0):
    rig.send(0x080, *([] if counter is None else [counter]))
    return rig.run(ms)


# NMT and heartbeat


def test_boot_up_then_silence():
    rig = CanRig(encoder(), cell())
    frames = rig.run(1000)
    assert [(frame.identifier, frame.data) for frame in frames] == [(0x701, b"\0"), (0x702, b"\0")]
    assert all(50 * MS <= frame.end_ns - START_NS < 60 * MS for frame in frames)


@pytest.mark.parametrize(("command", "state"), [(1, 0x05), (2, 0x04), (128, 0x7F)])
@pytest.mark.parametrize("target", [0, 1])
def test_heartbeat_tells_the_state(command, state, target):
    rig = booted(encoder())
    assert rig.ask(1, "2B 17 10 00 64 00 00 00") == "60 17 10 00 00 00 00 00"
    assert {f.data for f in of(rig.run(250), 0x701)} == {b"\x7f"}
    rig.send(0x000, command, target)
    assert of(rig.run(450), 0x701)[-1].data == bytes([state])


def test_heartbeat_period_is_that_of_1017h_and_starts_a_period_later():
    rig = booted(encoder())
    assert of(rig.run(1000), 0x701) == []
    rig.ask(1, "2B 17 10 00 F4 01 00 00")  # 500 ms
    ends = [f.end_ns for f in of(rig.run(2600), 0x701)]
    assert len(ends) == 5
    assert all(abs(b - a - 500 * MS) < 0.1 * MS for a, b in itertools.pairwise(ends))
    rig.ask(1, "2B 17 10 00 00 00 00 00")
    assert of(rig.run(1500), 0x701) == []


def test_a_command_for_another_node_is_not_obeyed():
    rig = booted(encoder())
    rig.send(0x000, 1, 9)
    rig.run(2)
    assert of(sync(rig), 0x281) == []


def test_reset_of_communication_reaches_from_1000h_to_1fffh():
    rig = booted(encoder())
    rig.ask(1, "2B 17 10 00 64 00 00 00")
    rig.ask(1, "2B 00 60 00 00 00 00 00")
    rig.send(0x000, 130, 1)
    rig.run(20)
    assert rig.ask(1, "40 17 10 00 00 00 00 00") == "4b 17 10 00 00 00 00 00"
    assert rig.ask(1, "40 00 60 00 00 00 00 00") == "4b 00 60 00 00 00 00 00"


@pytest.mark.parametrize(("command", "position_kept"), [(129, False), (130, True)])
def test_reset_boots_again_with_default_parameters(command, position_kept):
    rig = operational(encoder())
    rig.ask(1, "2F 01 18 02 0A 00 00 00")  # 1801h:2 transmission type 10
    rig.ask(1, "23 03 60 00 39 05 00 00")  # preset 1337
    rig.send(0x000, command, 1)
    frames = rig.run(20)
    assert [(f.identifier, f.data) for f in frames] == [(0x701, b"\0")]
    assert rig.ask(1, "40 01 18 02 00 00 00 00") == "4f 01 18 02 01 00 00 00"
    expected = "39 05 00 00" if position_kept else "00 00 00 00"
    assert rig.ask(1, "40 04 60 00 00 00 00 00") == f"43 04 60 00 {expected}"
    assert of(sync(rig), 0x281) == []  # pre-operational again


def test_stopped_answers_neither_sdo_nor_sync():
    rig = operational(encoder())
    rig.send(0x000, 2, 1)
    rig.run(1)
    rig.send(0x601, 0x40, 0, 0x10, 0, 0, 0, 0, 0)
    assert sync(rig) == []
    rig.send(0x000, 128, 1)
    rig.run(1)
    assert rig.ask(1, "40 00 10 00 00 00 00 00").startswith("43")


@pytest.mark.parametrize("node", [0, 128])
def test_node_number_out_of_range(node):
    with pytest.raises(ValueError, match="1 to 127"):
        Encoder406(node, Analog(lambda t: 0.0), START_NS)


# SDO


@pytest.mark.parametrize(
    ("index", "sub", "answer"),
    [
        (0x1000, 0, "43 00 10 00 96 01 02 00"),
        (0x1001, 0, "4f 01 10 00 00 00 00 00"),
        (0x1005, 0, "43 05 10 00 80 00 00 00"),
        (0x1014, 0, "43 14 10 00 81 00 00 00"),
        (0x1017, 0, "4b 17 10 00 00 00 00 00"),
        (0x1018, 0, "4f 18 10 00 04 00 00 00"),
        (0x1800, 1, "43 00 18 01 81 01 00 00"),
        (0x1800, 2, "4f 00 18 02 fe 00 00 00"),
        (0x1801, 1, "43 01 18 01 81 02 00 00"),
        (0x1801, 2, "4f 01 18 02 01 00 00 00"),
        (0x1A00, 0, "4f 00 1a 00 01 00 00 00"),
        (0x1A00, 1, "43 00 1a 01 20 00 04 60"),
        (0x1A01, 1, "43 01 1a 01 20 00 04 60"),
        (0x6000, 0, "4b 00 60 00 04 00 00 00"),
        (0x6001, 0, "43 01 60 00 20 a1 07 00"),
        (0x6501, 0, "43 01 65 00 20 a1 07 00"),
        (0x1018, 4, "43 18 10 04 e9 03 00 00"),
        (0x1800, 0, "4f 00 18 00 06 00 00 00"),
        (0x6003, 0, "43 03 60 00 00 00 00 00"),
        (0x6200, 0, "4b 00 62 00 14 00 00 00"),
        (0x6500, 0, "4b 00 65 00 04 00 00 00"),
        (0x6502, 0, "4b 02 65 00 8d 21 00 00"),  # 8589 revolutions of 500,000 in 2^32
        (0x6503, 0, "4b 03 65 00 00 00 00 00"),
        (0x6505, 0, "4b 05 65 00 00 00 00 00"),
    ],
)
def test_encoder_objects(index, sub, answer):
    rig = booted(encoder())
    assert rig.ask(1, struct.pack("<BHB4x", 0x40, index, sub).hex()) == answer


@pytest.mark.parametrize(
    ("index", "sub", "answer"),
    [
        (0x1000, 0, "43 00 10 00 94 01 02 00"),
        (0x1014, 0, "43 14 10 00 82 00 00 00"),
        (0x6110, 0, "4f 10 61 00 01 00 00 00"),
        (0x6110, 1, "4b 10 61 01 46 00 00 00"),
        (0x6112, 1, "4f 12 61 01 01 00 00 00"),
        (0x6131, 1, "43 31 61 01 00 00 21 00"),
        (0x6132, 1, "4f 32 61 01 04 00 00 00"),
        (0x9130, 1, "43 30 91 01 0c 30 00 00"),
        (0x9100, 1, "43 00 91 01 18 26 03 00"),
        (0x6150, 1, "4f 50 61 01 00 00 00 00"),
        (0x1800, 1, "43 00 18 01 82 01 00 00"),
        (0x1800, 2, "4f 00 18 02 01 00 00 00"),
        (0x1A00, 0, "4f 00 1a 00 02 00 00 00"),
        (0x1A00, 1, "43 00 1a 01 20 01 30 91"),
        (0x1A00, 2, "43 00 1a 02 08 01 50 61"),
    ],
)
def test_load_cell_objects(index, sub, answer):
    rig = booted(cell(lambda t: 1.23))
    assert rig.ask(2, struct.pack("<BHB4x", 0x40, index, sub).hex()) == answer


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        ("40 00 20 00 00 00 00 00", 0x06020000),  # no such object
        ("40 18 10 09 00 00 00 00", 0x06090011),  # no such sub-index
        ("23 04 60 00 01 00 00 00", 0x06010002),  # 6004h is read-only
        ("40 25 61 01 00 00 00 00", 0x06010001),  # 6125h is write-only (load cell)
        ("2F 17 10 00 64 00 00 00", 0x06070010),  # one byte for a U16
        ("23 17 10 00 64 00 00 00", 0x06070010),  # four bytes for a U16
        ("2F 01 18 02 F5 00 00 00", 0x06090030),  # transmission type 245 is reserved
        ("2F 01 18 02 00 00 00 00", 0x06090030),  # type 0 is not offered
        ("23 01 18 01 82 02 00 00", 0x06090030),  # another COB-ID while the PDO exists
        ("2B 01 18 03 0A 00 00 00", 0x06090030),  # inhibit time while the PDO exists
        ("2F 01 1A 00 00 00 00 00", 0x06010000),  # mapping while the PDO exists
        ("20 17 10 00 64 00 00 00", 0x05040001),  # segmented download
        ("E0 17 10 00 64 00 00 00", 0x05040001),  # no such command
    ],
)
def test_refusals(request_, code):
    node = 2 if request_.startswith("40 25") else 1
    rig = booted(encoder(), cell())
    answer = bytes.fromhex(rig.ask(node, request_))
    assert answer[:4] == bytes([0x80]) + bytes.fromhex(request_)[1:4]
    assert int.from_bytes(answer[4:], "little") == code


def test_a_write_without_size_takes_the_size_of_the_object():
    rig = booted(encoder())
    assert rig.ask(1, "22 17 10 00 64 00 00 00") == "60 17 10 00 00 00 00 00"
    assert rig.ask(1, "40 17 10 00 00 00 00 00") == "4b 17 10 00 64 00 00 00"


def test_client_aborts_and_short_frames_get_no_answer():
    rig = booted(encoder())
    rig.send(0x601, 0x80, 0, 0x10, 0, 0, 0, 4, 5)
    rig.send(0x601, 0x40, 0, 0x10, 0)
    rig.send(0x602, 0x40, 0, 0x10, 0, 0, 0, 0, 0)
    assert rig.run(10) == []


def test_an_answer_takes_half_a_millisecond():
    rig = booted(encoder())
    rig.send(0x601, 0x40, 0, 0x10, 0, 0, 0, 0, 0)
    (frame,) = rig.run(5)
    assert 0.5 * MS < frame.end_ns - (rig.now_ns - 5 * MS) < 1.5 * MS


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


# Emergency and faults


def test_emergency_carries_code_register_and_vendor_bytes():
    node = encoder()
    rig = booted(node)
    node.emergency(0x8110, 0x11, b"\x01\x02", rig.now_ns)
    (frame,) = rig.run(5)
    assert (frame.identifier, frame.data) == (0x081, bytes.fromhex("10 81 11 01 02 00 00 00"))
    assert rig.ask(1, "40 01 10 00 00 00 00 00") == "4f 01 10 00 11 00 00 00"
    assert rig.ask(1, "40 03 10 01 00 00 00 00") == "43 03 10 01 10 81 00 00"


def test_an_error_cleared_is_code_zero():
    node = encoder()
    rig = booted(node)
    node.emergency(0, 0, b"", rig.now_ns)
    assert rig.run(5)[0].data == bytes(8)
    assert rig.ask(1, "2F 03 10 00 00 00 00 00").startswith("60")
    assert rig.ask(1, "2F 03 10 00 01 00 00 00").startswith("80")


def test_a_silent_node_keeps_its_state_and_reports_the_recovery():
    rig = operational(encoder(faults=plan(Fault("silent", "node", 0.2, 0.4))))
    rig.ask(1, "23 00 18 01 81 01 00 80")
    rig.run(105)
    assert sync(rig) == []
    frames = rig.run(300)
    assert [f.data[:3].hex() for f in of(frames, 0x081)] == ["408110", "000000"]
    assert len(of(sync(rig), 0x281)) == 1


def test_a_brown_out_boots_again():
    node = encoder(faults=plan(Fault("reset", "node", 0.2)))
    rig = operational(node)
    frames = rig.run(300)
    assert [(f.identifier, f.data) for f in frames][-1] == (0x701, b"\0")
    assert of(sync(rig), 0x281) == []
    assert rig.ask(1, "40 00 10 00 00 00 00 00").startswith("43")


def test_without_supply_it_is_gone_until_it_boots():
    rig = operational(encoder(faults=plan(Fault("off", "node", 0.2, 0.5))))
    rig.run(120)
    rig.send(0x601, 0x40, 0, 0x10, 0, 0, 0, 0, 0)
    assert rig.run(200) == []
    frames = rig.run(300)
    assert [(f.identifier, f.data) for f in frames] == [(0x701, b"\0")]
    assert frames[0].end_ns - START_NS > 550 * MS


def test_stuck_and_saturated_inputs():
    force = Analog(lambda t: 10 * t)
    faults = plan(Fault("stuck", "node", 0.2, 0.3), Fault("saturated", "node", 0.4, 0.5, -1))
    rig = operational(LoadCell404(2, force, START_NS, faults=faults))
    values = {}
    for _ in range(90):
        for frame in of(sync(rig), 0x182):
            values[(frame.end_ns - START_NS) // MS] = struct.unpack("<iB", frame.data)[0]
    inside = {value for ms, value in values.items() if 206 <= ms < 300}
    assert len(inside) == 1
    assert 1.9e4 < inside.pop() <= 2.0e4
    assert {value for ms, value in values.items() if 401 <= ms < 500} == {-500_000}
    assert 3.0e4 < max(value for ms, value in values.items() if ms < 400) < 4.0e4


def test_a_fault_that_the_node_cannot_have():
    with pytest.raises(FaultError, match="cannot have the fault nack"):
        encoder(faults=plan(Fault("nack", "node", 0.0)))


def test_a_node_without_wire_runs_all_the_same():
    node = encoder()
    node.act(START_NS + 10**9)
    assert isinstance(node, CanopenNode)
    assert node.state == 0x7F


def test_more_objects_than_a_pdo_has_places_for():
    rig = booted(encoder())
    rig.ask(1, "23 00 18 01 81 01 00 80")
    assert rig.ask(1, "2F 00 1A 00 09 00 00 00")[-11:] == "30 00 09 06"


def test_what_was_produced_is_what_was_sent():
    joint, force = encoder(), cell()
    rig = operational(joint, force)
    for k in range(20):
        sync(rig, k + 1)
    assert (joint.produced, force.produced) == (20, 20)
    assert len(of(rig.frames, 0x281)) == len(of(rig.frames, 0x182)) == 20
