"""CiA 402 drives: their mapping, their units, their values, beside the other nodes of a bus."""

import math
import struct

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from drivers.canopen_pdo import CanopenBus, Cia402Config, Cia406Config, SyncConfig
from drivers.errors import ConfigurationError, FrameError
from drivers.records import SampleStatus
from tests.drivers.batches import codes, of, texts, whole
from tests.drivers.can_peers import Bench, Drive, Encoder, u8, u32

ALL = Cia402Config(4, 500_000, position="joint_2", velocity="joint_2_rate", torque="joint_2_torque", gear_ratio=100.0)


def bench_of(clock, config, *nodes, **named):
    return Bench(clock, lambda port: CanopenBus(port, [config], SyncConfig()), *nodes, **named)


def mapping(node, tpdo):
    count = node.objects[0x1A00 + tpdo - 1, 0][0]
    return [int.from_bytes(node.objects[0x1A00 + tpdo - 1, place + 1], "little") for place in range(count)]


def test_three_channels_of_one_drive(clock):
    bench = bench_of(clock, ALL, Drive())
    bench.start()
    bench.run(3_000)
    bench.stop()
    assert set(codes(bench.batches)) == {"started", "stopped"}
    position, velocity, torque = (whole(bench.batches, name) for name in ("joint_2", "joint_2_rate", "joint_2_torque"))
    assert len(position) == len(velocity) == len(torque) > 500
    for rows in (position, velocity, torque):
        np.testing.assert_array_equal(rows["tick"], position["tick"])
    tick = position["tick"].astype(int)
    np.testing.assert_array_equal(position["value_raw"], tick)
    np.testing.assert_array_equal(velocity["value_raw"], -3 * tick)
    np.testing.assert_array_equal(torque["value_raw"], tick % 2_000 - 1_000)
    per_count = 2 * math.pi / 500_000
    assert (position["unit"][0], position["scale"][0]) == (b"rad", per_count)
    assert (velocity["unit"][0], velocity["scale"][0]) == (b"rad/s", per_count)
    # a thousandth of 1.27 N m at the motor, times the gear
    assert (torque["unit"][0], torque["scale"][0]) == (b"N m", pytest.approx(1.27e-3 * 100.0))
    drive = bench.nodes[4]
    assert mapping(drive, 1) == [0x6064_0020, 0x606C_0020]
    assert mapping(drive, 2) == [0x6077_0010]
    assert drive.objects[0x1800, 2] == drive.objects[0x1801, 2] == u8(1)
    assert not len(of(bench.batches, "gap"))


@pytest.mark.parametrize(
    ("names", "tpdos", "mapped"),
    [
        ({"position": "p"}, (1,), [[0x6064_0020]]),
        ({"velocity": "v"}, (3,), [[0x606C_0020]]),
        ({"torque": "t"}, (2, 1), [[0x6077_0010]]),
        ({"position": "p", "torque": "t"}, (1,), [[0x6064_0020, 0x6077_0010]]),
        ({"velocity": "v", "torque": "t"}, (4,), [[0x606C_0020, 0x6077_0010]]),
        ({"position": "p", "velocity": "v"}, (2,), [[0x6064_0020, 0x606C_0020]]),
        ({"position": "p", "velocity": "v", "torque": "t"}, (4, 3), [[0x6064_0020, 0x606C_0020], [0x6077_0010]]),
    ],
)
def test_any_of_the_values_in_any_tpdos(clock, names, tpdos, mapped):
    bench = bench_of(clock, Cia402Config(4, 1_000, tpdos=tpdos, **names), Drive())
    bench.start()
    bench.run(500)
    for tpdo, entries in zip(tpdos, mapped, strict=False):
        assert mapping(bench.nodes[4], tpdo) == entries
    for name in names.values():
        assert len(whole(bench.batches, name)) > 100
    for tpdo in {1, 2, 3, 4} - set(tpdos[: len(mapped)]):
        assert mapping(bench.nodes[4], tpdo) == [0x6041_0010], "not ours: left alone"


@pytest.mark.parametrize("offset", [2**31 - 300, -300, -(2**31), 2**31 - 1])
def test_a_position_that_wraps_is_unwrapped_and_begins_signed(clock, offset):
    bench = bench_of(clock, ALL, Drive(offset=offset))
    bench.start()
    bench.run(3_000)
    rows = whole(bench.batches, "joint_2")
    first = int(rows["tick"][0])
    begin = (offset + first + 2**31) % 2**32 - 2**31
    np.testing.assert_array_equal(rows["value_raw"], begin + rows["tick"].astype(int) - first)


def test_units_of_the_drive_and_rated_torque_by_configuration(clock):
    config = Cia402Config(
        4, 1_000, velocity="v", torque="t", velocity_scale_rad_s=0.1047, rated_torque_N_m=2.0, gear_ratio=-50.0
    )
    bench = bench_of(clock, config, Drive(objects={(0x6076, 0): None}))
    bench.start()
    bench.run(200)
    assert of(bench.batches, "v")["scale"][0] == 0.1047
    assert of(bench.batches, "t")["scale"][0] == pytest.approx(-0.1)


@pytest.mark.parametrize(("rated", "said"), [(None, "6076h"), (u32(0), "rated torque 0")])
def test_a_drive_without_rated_torque_is_named(clock, rated, said):
    bench = bench_of(clock, ALL, Drive(objects={(0x6076, 0): rated}))
    bench.start()
    assert said in texts(bench.batches, "configuration")[0]
    assert not len(of(bench.batches, "joint_2_torque"))


def test_another_profile_is_not_taken_for_a_drive(clock):
    bench = bench_of(clock, ALL, Drive(objects={(0x1000, 0): u32(0x0002_0196)}))
    bench.start()
    assert "joint_2 needs xxxx0192h" in texts(bench.batches, "wrong_device")[0]


def test_a_drive_whose_mapping_is_fixed_and_another_is_named(clock):
    bench = bench_of(clock, ALL, Drive(read_only=[(0x1A00, 0)]))
    bench.start()
    assert "1A00h" in texts(bench.batches, "configuration")[0]


def test_a_drive_set_up_already_is_written_to_only_where_it_differs(clock):
    bench = bench_of(clock, ALL, Drive())
    bench.start()
    bench.stop()
    drive = bench.nodes[4]
    drive.requests.clear()
    bench.batches += bench.device.start(clock())
    bench.run(600)
    assert [request for request in drive.requests if request[0] == "write"] == [("write", 0x1017, 0, 500)]


@pytest.mark.parametrize(
    "place", [pytest.param(one, marks=pytest.mark.campaign if one % 3 else ()) for one in range(40)]
)  # answers between those of the others
def test_a_drive_that_falls_silent_at_any_point_of_its_set_up_is_set_up_later(clock, place):
    drive = Drive()
    bench = bench_of(clock, ALL, drive)
    answer = drive.sdo
    drive.sdo = lambda data: None if len(drive.requests) >= place else answer(data)
    bench.start()
    bench.run(4_000)
    drive.sdo = answer
    bench.run(8_000)
    bench.stop()
    for name in ("joint_2", "joint_2_rate", "joint_2_torque"):
        assert len(whole(bench.batches, name)) > 100
    if len(drive.requests) > place and "no_answer" in codes(bench.batches):
        assert codes(bench.batches).count("no_answer") == 1


def test_a_drive_that_reboots_is_mapped_again(clock):
    bench = bench_of(clock, ALL, Drive())
    bench.start()
    bench.run(1_000)
    bench.put(bench.nodes[4].boot(clock()))
    bench.run(1_000)
    bench.stop()
    for name in ("joint_2", "joint_2_rate", "joint_2_torque"):
        rows = whole(bench.batches, name)
        assert np.count_nonzero(rows["status"] & SampleStatus.AFTER_RESET) == 1
    np.testing.assert_array_equal(rows["value_raw"], rows["tick"].astype(int) % 2_000 - 1_000)


def test_a_drive_and_an_encoder_share_a_bus(clock):
    bench = Bench(
        clock,
        lambda port: CanopenBus(port, [Cia406Config("joint_1", 1, 500_000), ALL], SyncConfig()),
        Encoder(),
        Drive(),
    )
    bench.start()
    bench.run(500)
    assert {"joint_1", "joint_2", "joint_2_rate", "joint_2_torque"} <= {batch.channel for batch in bench.batches}


@given(st.binary(max_size=8))
def test_any_bytes_are_a_sample_or_a_frame_error(data):
    for value, length in zip(ALL.process_data(), (8, 8, 2), strict=True):
        if len(data) == length:
            assert -(2**31) <= value.decode(data).value_raw < 2**31
        else:
            with pytest.raises(FrameError, match=f"its objects have {length}: check the mapping 1A0[01]h"):
                value.decode(data)


def test_the_bytes_are_little_endian_and_signed():
    position, velocity, torque = ALL.process_data()
    data = struct.pack("<ii", -123_456, 789)
    assert (position.decode(data).value_raw, velocity.decode(data).value_raw) == (-123_456, 789)
    assert torque.decode(b"\xff\xff").value_raw == -1
    assert (position.cob_id, velocity.cob_id, torque.cob_id) == (0x184, 0x184, 0x284)


@pytest.mark.parametrize(
    "wrong",
    [
        {},
        {"position": "p", "counts_per_revolution": 0},
        {"velocity": "v", "velocity_scale_rad_s": 0.0},
        {"torque": "t", "rated_torque_N_m": -1.0},
        {"torque": "t", "gear_ratio": 0.0},
        {"torque": "t", "gear_ratio": float("nan")},
        {"position": "p", "tpdos": (1, 1)},
        {"position": "p", "tpdos": (5,)},
        {"position": "p", "velocity": "v", "torque": "t", "tpdos": (1,)},
    ],
)
def test_configurations_that_cannot_be_are_refused(wrong):
    with pytest.raises(ConfigurationError, match=":"):
        Cia402Config(**{"node": 4, "counts_per_revolution": 1_000, **wrong})


def test_two_channels_of_one_name_are_refused(clock):
    with pytest.raises(ConfigurationError, match="two channels of the same name"):
        bench_of(clock, Cia402Config(4, 1_000, position="x", velocity="x"))
    with pytest.raises(ConfigurationError, match="node = 0"):
        bench_of(clock, Cia402Config(0, 1_000, position="x"))
