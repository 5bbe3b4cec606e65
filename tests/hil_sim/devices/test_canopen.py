"""NMT, SDO, emergencies and faults of the CANopen twins, against CiA 301; every byte of a frame typed here."""

import itertools
import struct

import pytest

from hil_sim.devices.canopen.canopen_node import CanopenNode
from hil_sim.devices.canopen.encoder406 import Encoder406
from hil_sim.devices.canopen.loadcell404 import LoadCell404
from hil_sim.faults import Fault, FaultError
from tests.hil_sim.devices.canopen_rig import booted, cell, encoder, of, operational, plan, sync
from tests.hil_sim.devices.twin_bench import MS, START_NS, Analog, CanRig

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
