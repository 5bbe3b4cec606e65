"""Modbus-RTU frames and the Laumas map: the manual's bytes, any feeding, any bytes."""

import pytest

from drivers.errors import ConfigurationError, FrameError
from drivers.modbus_load_cell import (
    ModbusException,
    ModbusLoadCellConfig,
    ModbusReply,
    crc16,
    decode_weights,
    read_request,
)
from drivers.records import SampleStatus
from tests.drivers.modbus_model import TransmitterModel, framed

REQUEST = bytes.fromhex("01 03 00 07 00 02 75 CA")  # Laumas: read the gross weight


def test_check_value_of_the_crc():
    assert crc16(b"123456789") == 0x4B37
    assert crc16(b"") == 0xFFFF


def test_the_manuals_request():
    assert read_request(1, 7, 2) == REQUEST


@pytest.mark.parametrize(
    ("frame", "made"),
    [
        # other manufacturers' manuals: Flintec FT-13 page 48
        ("01 03 00 00 00 02 C4 0B", lambda: read_request(1, 0, 2)),
        ("01 03 00 02 00 01 25 CA", lambda: read_request(1, 2, 1)),
    ],
)
def test_requests_of_other_manuals(frame, made):
    assert made() == bytes.fromhex(frame)


def fed(answer: ModbusReply, data: bytes, bytewise: bool):
    """The first thing that is not None."""
    pieces = [data[n : n + 1] for n in range(len(data))] if bytewise else [data]
    for place, piece in enumerate(pieces):
        made = answer.receive(piece)
        if made is not None:
            assert place == len(pieces) - 1
            return made
    return None


@pytest.mark.parametrize("bytewise", [False, True])
@pytest.mark.parametrize("echo", [False, True])
def test_the_manuals_answer(bytewise, echo):
    answer = framed(bytes.fromhex("01 03 04 00 01 02 03"))  # Laumas: 01 03 04 HH HH LL LL crc
    data = REQUEST + answer if echo else answer
    gathering = ModbusReply(REQUEST, echo)
    assert gathering.missing == len(data)
    assert fed(gathering, data, bytewise) == (0x0001, 0x0203)


def test_it_says_how_many_bytes_are_to_come():
    answer, gathering = framed(bytes.fromhex("01 03 04 00 01 02 03")), ModbusReply(REQUEST)
    missing = []
    for place in range(9):
        missing.append(gathering.missing)
        gathering.receive(answer[place : place + 1])
    assert missing == [9, 8, 7, 6, 5, 4, 3, 2, 1]
    assert gathering.missing == 1


@pytest.mark.parametrize("bytewise", [False, True])
@pytest.mark.parametrize(
    ("code", "word"), [(1, "function"), (2, "address"), (3, "value"), (4, "failure"), (99, "unknown")]
)
def test_exceptions(bytewise, code, word):
    with pytest.raises(ModbusException, match=word) as caught:
        fed(ModbusReply(REQUEST), framed(bytes([1, 0x83, code])), bytewise)
    assert caught.value.code == code


GOOD = framed(bytes.fromhex("01 03 04 00 01 02 03"))
BAD = {
    "another address": framed(bytes.fromhex("02 03 04 00 01 02 03")),
    "another function": framed(bytes.fromhex("01 04 04 00 01 02 03")),
    "another length": framed(bytes.fromhex("01 03 06 00 01 02 03 00 00")),
    "trailing junk": GOOD + b"\0",
    "crc": GOOD[:-1] + bytes([GOOD[-1] ^ 1]),
    "data": GOOD[:4] + b"\x55" + GOOD[5:],
}


@pytest.mark.parametrize("bad", BAD.values(), ids=BAD)
def test_what_is_no_answer_is_refused(bad):
    with pytest.raises(FrameError):
        ModbusReply(REQUEST).receive(bad)


def test_an_echo_that_does_not_come_is_refused():
    with pytest.raises(FrameError, match="echo"):
        ModbusReply(REQUEST, True).receive(GOOD)


@pytest.mark.parametrize("bad", [(0, 0, 1), (248, 0, 1), (1, -1, 1), (1, 65536, 1), (1, 0, 0), (1, 0, 126)])
def test_requests_that_cannot_be_said(bad):
    with pytest.raises(ConfigurationError):
        read_request(*bad)


# The map


def registers(model):
    return tuple(model.register(number) for number in range(40007, 40015))


@pytest.mark.parametrize("sign", ["status", "twos_complement"])
@pytest.mark.parametrize(("gross", "net"), [(0, 0), (123456, -7), (-999999, 70000), (-1, -65536)])
def test_signs_and_halves(sign, gross, net):
    weights = decode_weights(
        registers(TransmitterModel(gross=gross, net=net, sign=sign)), ModbusLoadCellConfig(sign=sign)
    )
    assert (weights.gross, weights.net) == (gross, net)
    assert (weights.scale, weights.unit, weights.status) == (0.001, "kg", 0)


def test_magnitudes_only():
    weights = decode_weights(registers(TransmitterModel(gross=-5, net=-6)), ModbusLoadCellConfig(sign="positive"))
    assert (weights.gross, weights.net) == (5, 6)


# TLB manual, register 40014: division by low byte, unit by high byte
DIVISIONS = dict(enumerate([*[1.0] * 7, *[0.1] * 3, *[0.01] * 3, *[1e-3] * 3, *[1e-4] * 3]))


@pytest.mark.parametrize(("code", "scale"), DIVISIONS.items())
@pytest.mark.parametrize(("unit", "factor"), [(0, 1.0), (1, 1e-3), (2, 1e3), (3, 0.45359237)])
def test_scales_of_mass(code, scale, unit, factor):
    model = TransmitterModel(gross=1)
    model.division, model.unit = code, unit
    weights = decode_weights(registers(model), ModbusLoadCellConfig())
    assert weights.scale == pytest.approx(scale * factor, rel=1e-15)
    assert weights.unit == "kg"


@pytest.mark.parametrize(("division", "unit"), [(15, 4), (15, 9), (19, 0), (255, 0), (0, 255)])
def test_a_unit_that_is_not_known_is_never_a_number(division, unit):
    model = TransmitterModel(gross=1)
    model.division, model.unit = division, unit
    weights = decode_weights(registers(model), ModbusLoadCellConfig())
    assert weights.scale == 0.0
    assert weights.status == SampleStatus.NOT_VALID
    told = decode_weights(registers(model), ModbusLoadCellConfig(scale=1e-4, unit="N"))
    assert (told.scale, told.unit, told.status) == (1e-4, "N", 0)


@pytest.mark.parametrize(
    ("bit", "status"),
    [
        (0, SampleStatus.NOT_VALID),
        (1, SampleStatus.NOT_VALID),
        *((bit, SampleStatus.SATURATED) for bit in (2, 3, 4, 5)),
    ],
)
def test_errors_of_the_status_register(bit, status):
    model = TransmitterModel(gross=1)
    model.errors = 1 << bit
    weights = decode_weights(registers(model), ModbusLoadCellConfig())
    assert weights.status == status
    assert weights.device_status == 1 << bit


def test_too_few_registers():
    with pytest.raises(FrameError):
        decode_weights((0,) * 7, ModbusLoadCellConfig())


@pytest.mark.parametrize(("baud", "pause_ms"), [(9600, 4.01), (19200, 2.005), (38400, 1.75), (115200, 1.75)])
def test_the_silence_between_frames(baud, pause_ms):
    assert ModbusLoadCellConfig(baud=baud).pause_ms == pytest.approx(pause_ms, abs=0.01)
