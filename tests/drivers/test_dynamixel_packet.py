"""DYNAMIXEL packets against the examples of the e-manual; answers fed three ways; any bytes."""

from itertools import repeat

import hypothesis.strategies as st
import pytest
from hypothesis import given

from drivers import dynamixel
from drivers.dynamixel.packet import sync_write_request, write_request
from drivers.dynamixel.registers import decode_driven
from drivers.errors import ConfigurationError, FrameError
from tests.drivers.dynamixel_model import crc, fast_status, status
from tests.drivers.serial_script import bytewise, pieces

# e-manual, protocol 2.0: Read; Sync Read of ids 1 and 2; Fast Sync Read of ids 3, 7 and 4; all of Present Position
READ = bytes.fromhex("FF FF FD 00 01 07 00 02 84 00 04 00 1D 15")
READ_ANSWER = bytes.fromhex("FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0")
SYNC = bytes.fromhex("FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA")
SYNC_ANSWER = READ_ANSWER + bytes.fromhex("FF FF FD 00 02 08 00 55 00 1F 08 00 00 BA BE")
FAST = bytes.fromhex("FF FF FD 00 FE 0A 00 8A 84 00 04 00 03 07 04 20 F2")
FAST_ANSWER = bytes.fromhex(
    "FF FF FD 00 FE 19 00 55 00 03 A6 00 00 00 84 08 00 07 1F 08 00 00 16 CA 00 04 FF 03 00 00 D1 9E"
)
WRITE = bytes.fromhex("FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89")  # Goal Position 512
WRITE_ANSWER = bytes.fromhex("FF FF FD 00 01 04 00 55 00 A1 0C")
SYNC_WRITE = bytes.fromhex("FF FF FD 00 FE 11 00 83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00 82 87")  # 150 and 170
POSITIONS = [(166).to_bytes(4, "little"), (2079).to_bytes(4, "little"), (1023).to_bytes(4, "little")]
FED = [repeat(1 << 20), bytewise(), *(pieces(seed, 9) for seed in range(8))]


def fed(reply, data, sizes):
    """Whether the answer was whole at its last byte, and not before."""
    done, at = False, 0
    while at < len(data):
        assert not done
        assert 1 <= reply.missing <= len(data) - at
        size = next(sizes)
        done = reply.receive(data[at : at + size])
        at += size
    return done


def test_crc_check_value():
    assert dynamixel.crc16(b"123456789") == 0xFEE8
    assert dynamixel.crc16(b"6789", dynamixel.crc16(b"12345")) == 0xFEE8


def test_requests_of_the_manual():
    assert dynamixel.read_request(1, 132, 4) == READ
    assert dynamixel.sync_read_request([1, 2], 132, 4) == SYNC
    assert dynamixel.sync_read_request([3, 7, 4], 132, 4, fast=True) == FAST


def test_writes_of_the_manual():
    assert write_request(1, 116, (512).to_bytes(4, "little")) == WRITE
    assert sync_write_request(116, {1: (150).to_bytes(4, "little"), 2: (170).to_bytes(4, "little")}) == SYNC_WRITE
    for wrong in ({}, {1: b"ab", 2: b"a"}, {253: b"a"}):
        with pytest.raises((ConfigurationError, ValueError)):
            sync_write_request(116, wrong)


@pytest.mark.parametrize("sizes", FED)
@pytest.mark.parametrize("error", [0, 0x80, 7, 0x84])
def test_the_answer_to_a_write_has_no_data(sizes, error):
    reply = dynamixel.Reply([1], 0)
    assert fed(reply, status(1, error, b""), sizes)
    assert reply.blocks == [dynamixel.Block(1, error, b"")]
    assert status(1, 0, b"") == WRITE_ANSWER
    late = dynamixel.Reply([1], 0)
    with pytest.raises(FrameError, match="it is late"):
        late.receive(READ_ANSWER)


def test_what_a_driven_servo_says():
    block = bytearray(38)
    block[0], block[25] = 0xFF, 2
    block[18:22], block[30:34], block[34:38] = (one.to_bytes(4, "little", signed=True) for one in (-7, -50, 2000))
    assert decode_driven(bytes(block)) == (0xFF, -7, 2, -50, 2000)
    with pytest.raises(FrameError, match="37 bytes"):
        decode_driven(bytes(block[1:]))


@pytest.mark.parametrize("sizes", FED)
def test_answers_of_the_manual(sizes):
    for identifiers, fast, answer in (([1], False, READ_ANSWER), ([1, 2], False, SYNC_ANSWER)):
        reply = dynamixel.Reply(identifiers, 4, fast=fast)
        assert fed(reply, answer, sizes)
        assert reply.blocks == [
            dynamixel.Block(one, 0, data) for one, data in zip(identifiers, POSITIONS, strict=False)
        ]
    reply = dynamixel.Reply([3, 7, 4], 4, fast=True)
    assert reply.missing == len(FAST_ANSWER) == dynamixel.answer_bytes(3, 4, fast=True)
    assert fed(reply, FAST_ANSWER, sizes)
    assert reply.blocks == [dynamixel.Block(one, 0, data) for one, data in zip((3, 7, 4), POSITIONS, strict=True)]


@pytest.mark.parametrize("sizes", FED)
def test_an_adapter_that_hears_itself(sizes):
    for fast, request, answer in ((False, SYNC, SYNC_ANSWER), (True, FAST, FAST_ANSWER)):
        reply = dynamixel.Reply([3, 7, 4] if fast else [1, 2], 4, fast=fast)
        said = request + answer
        assert [reply.receive(said[at : at + 1]) for at in range(len(said))] == [False] * (len(said) - 1) + [True]


@given(st.binary(min_size=4, max_size=12), st.binary(min_size=4, max_size=12), st.integers(0, 30))
def test_stuffing_is_taken_out_wherever_it_is_cut(first, second, at):
    second = second.ljust(len(first), b"\xfd")[: len(first)]
    said = status(5, 0x80, b"\xff\xff\xfd" + first) + status(6, 0, second + b"\xff\xff\xfd")
    reply = dynamixel.Reply([5, 6], len(first) + 3)
    assert [reply.receive(said[:at]), reply.receive(said[at:])] == [False, True]
    assert reply.blocks == [
        dynamixel.Block(5, 0x80, b"\xff\xff\xfd" + first),
        dynamixel.Block(6, 0, second + b"\xff\xff\xfd"),
    ]


def test_a_request_with_a_header_inside_is_stuffed():
    request = dynamixel.read_request(1, 0xFFFF, 0xFD)  # FF FF FD 00
    assert request[7:-2] == bytes.fromhex("02 FF FF FD FD 00")
    assert request[5] == len(request) - 7
    assert request[-2:] == crc(request[:-2])


def test_a_fast_answer_has_no_stuffing():
    data = bytes.fromhex("FF FF FD FD FF FF FD 00")
    reply = dynamixel.Reply([9, 1], 8, fast=True)
    assert reply.receive(fast_status([(9, 0, data), (1, 0x80, data)], 2))
    assert reply.blocks == [dynamixel.Block(9, 0, data), dynamixel.Block(1, 0x80, data)]


def test_blocks_before_a_silent_servo_are_there():
    reply = dynamixel.Reply([3, 7, 4], 4, fast=True)
    assert not reply.receive(FAST_ANSWER[:24])
    assert [block.identifier for block in reply.blocks] == [3, 7]
    reply = dynamixel.Reply([1, 5, 2], 4)
    assert reply.receive(SYNC_ANSWER)  # the second of three is silent, and the last one answers
    assert [block.identifier for block in reply.blocks] == [1, 2]


def test_an_error_without_data_is_an_answer():
    reply = dynamixel.Reply([1], 4)
    assert reply.receive(status(1, 7, b""))
    assert reply.blocks == [dynamixel.Block(1, 7, b"")]


@pytest.mark.parametrize(
    ("identifiers", "fast", "said", "match"),
    [
        ([1], False, b"\x00", "begins no packet"),
        ([1], False, b"\xff\xff\xfd\xfd", "begins no packet"),
        ([2], False, READ_ANSWER, "was not asked"),
        ([1], False, READ_ANSWER[:-1] + b"\x00", "CRC of id 1"),
        ([1], False, READ_ANSWER + b"\x00", "1 bytes after"),
        ([1], False, status(1, 0, bytes(5)), "sent 5 bytes, not 4"),
        ([1], False, status(1, 0x80, b""), "sent 0 bytes"),
        ([1], False, status(1, 0, bytes(40)), "a packet of 44 bytes"),
        ([1], False, b"\xff\xff\xfd\x00\x01\x02\x00\x55", "a packet of 2 bytes"),
        ([3, 7], True, FAST_ANSWER, "25 bytes of id 254"),
        ([3, 7, 4], True, READ_ANSWER, "8 bytes of id 1"),
        ([3, 4, 7], True, FAST_ANSWER, "id 7 where 4 answers"),
        ([3, 7, 4], True, FAST_ANSWER[:23] + b"\x00", "CRC of id 7"),
        ([3, 7, 4], True, FAST_ANSWER + b"\xff", "1 bytes after"),
    ],
)
def test_what_is_not_the_answer_is_refused(identifiers, fast, said, match):
    with pytest.raises(FrameError, match=match):
        dynamixel.Reply(identifiers, 4, fast=fast).receive(said)


@pytest.mark.parametrize("bit", range(8 * len(FAST_ANSWER)))
def test_no_inverted_bit_passes(bit):
    spoilt = bytearray(FAST_ANSWER)
    spoilt[bit // 8] ^= 1 << bit % 8
    reply = dynamixel.Reply([3, 7, 4], 4, fast=True)
    try:
        done = reply.receive(bytes(spoilt))
    except FrameError:
        done = False
    assert not done
    assert (
        reply.blocks
        == [dynamixel.Block(one, 0, data) for one, data in zip((3, 7, 4), POSITIONS, strict=True)][: len(reply.blocks)]
    )


def test_what_is_out_of_the_protocol_is_refused():
    for bad in ([], [1, 1], [253], [-1]):
        with pytest.raises(ConfigurationError):
            dynamixel.sync_read_request(bad, 132, 4)
    for address, count in ((-1, 1), (0x10000, 1), (0, 0), (0, 1001)):
        with pytest.raises(ConfigurationError):
            dynamixel.read_request(1, address, count)


def test_registers():
    assert dynamixel.decode_identity(bytes.fromhex("FC 03 00 00 00 00 2D 01 03 FA")) == (1020, 45, 500)
    assert dynamixel.decode_present(bytes.fromhex("FE FF 03 00 00 00 FF FF FF FF")) == (-2, 3, -1)
    with pytest.raises(FrameError):
        dynamixel.decode_identity(bytes(9))
    with pytest.raises(FrameError):
        dynamixel.decode_present(bytes(9))
