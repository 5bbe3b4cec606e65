"""CANopen frames: golden bytes of published manuals, and any bytes at all."""

import pytest

from drivers.canopen_pdo import frame
from drivers.canopen_pdo.frame import NmtCommand, NmtState
from drivers.errors import FrameError


def test_golden_sdo_of_a_strain_link():
    """Baumer DSRT, operating manual: reads of 1000h and 6110h, autozero 6125h."""
    assert frame.encode_sdo_read(0x1000, 0) == bytes.fromhex("40 00 10 00 00 00 00 00")
    device_type = frame.decode_sdo_reply(bytes.fromhex("43 00 10 00 94 01 02 00"))
    assert (device_type.index, device_type.subindex) == (0x1000, 0)
    assert int.from_bytes(device_type.data, "little") == 0x0002_0194
    sensor_type = frame.decode_sdo_reply(bytes.fromhex("4B 10 61 01 46 00 00 00"))
    assert (sensor_type.index, sensor_type.subindex, sensor_type.data) == (0x6110, 1, b"\x46\x00")
    # the manual writes without giving the size (22h); ours gives it (23h): the same transfer
    assert frame.encode_sdo_write(0x6125, 1, b"zero") == bytes.fromhex("23 25 61 01 7A 65 72 6F")
    written = frame.decode_sdo_reply(bytes.fromhex("60 25 61 01 00 00 00 00"))
    assert (written.index, written.subindex, written.is_read, written.abort_code) == (0x6125, 1, False, 0)


@pytest.mark.parametrize(
    ("data", "golden"),
    [
        (b"\x01", "2F 00 62 00 01 00 00 00"),
        (b"\xf4\x01", "2B 00 62 00 F4 01 00 00"),
        (b"\x01\x02\x03", "27 00 62 00 01 02 03 00"),
        (b"\x81\x02\x00\x80", "23 00 62 00 81 02 00 80"),
    ],
)
def test_writes_give_their_size(data, golden):
    assert frame.encode_sdo_write(0x6200, 0, data) == bytes.fromhex(golden)


@pytest.mark.parametrize("data", [b"", b"12345"])
def test_a_write_that_is_not_expedited_is_refused(data):
    with pytest.raises(FrameError, match=r"1\.\.4"):
        frame.encode_sdo_write(0x6200, 0, data)


@pytest.mark.parametrize(("command", "size"), [(0x4F, 1), (0x4B, 2), (0x47, 3), (0x43, 4), (0x42, 4)])
def test_reads_of_every_size(command, size):
    reply = frame.decode_sdo_reply(bytes([command, 0x04, 0x60, 0x00, 1, 2, 3, 4]))
    assert reply.data == bytes([1, 2, 3, 4][:size])


def test_an_abort_and_an_object_that_is_too_long():
    refused = frame.decode_sdo_reply(bytes.fromhex("80 00 62 00 02 00 01 06"))
    assert (refused.abort_code, refused.is_read) == (0x0601_0002, False)
    assert frame.ABORT_TEXT[refused.abort_code] == "read only"
    segmented = frame.decode_sdo_reply(bytes.fromhex("41 08 10 00 0C 00 00 00"))
    assert (segmented.abort_code, segmented.is_read) == (0x0504_0001, True)
    assert frame.encode_sdo_abort(0x1008, 0, 0x0504_0001) == bytes.fromhex("80 08 10 00 01 00 04 05")


def test_nmt_heartbeat_sync_emcy():
    assert frame.encode_nmt(NmtCommand.START, 3) == b"\x01\x03"
    assert frame.decode_heartbeat(b"\x00") is NmtState.BOOT_UP
    assert frame.decode_heartbeat(b"\x7f") is NmtState.PRE_OPERATIONAL
    assert frame.decode_heartbeat(b"\x85") is NmtState.OPERATIONAL  # node guarding toggles bit 7
    assert frame.decode_sync(b"") == 0
    assert [frame.decode_sync(bytes([counter])) for counter in (1, 240)] == [1, 240]
    emergency = frame.decode_emergency(bytes.fromhex("10 FF 81 01 02 03 04 05"))
    assert emergency == (0xFF10, 0x81, b"\x01\x02\x03\x04\x05")


@pytest.mark.parametrize(
    ("decode", "good"),
    [
        (frame.decode_sdo_reply, bytes.fromhex("43 00 10 00 94 01 02 00")),
        (frame.decode_heartbeat, b"\x05"),
        (frame.decode_emergency, bytes(8)),
    ],
)
def test_every_prefix_and_trailing_junk_are_refused(decode, good):
    decode(good)
    for wrong in [good[:size] for size in range(len(good))] + [good + b"\0"]:
        with pytest.raises(FrameError):
            decode(wrong)


@pytest.mark.parametrize("data", [b"\x00", b"\xf1", b"\x01\x02"])
def test_a_sync_counter_out_of_range_is_refused(data):
    with pytest.raises(FrameError, match="1019h"):
        frame.decode_sync(data)
