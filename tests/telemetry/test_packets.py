"""Bytes of a packet against the standards' own layout, and values that are absurd."""

import math
import struct
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.config.telemetry import Telemetry
from onboard.telemetry import packets
from onboard.telemetry.packets import (
    ANSWER,
    EVENT,
    KINDS,
    PHASE,
    STATUS,
    PacketError,
    PacketKind,
    decode,
    encode,
    plain,
)

APIDS = Telemetry().apids
BY_APID = {apid: KINDS[name] for name, apid in APIDS.items()}
AT_NS = 1_764_000_000_123_456_789


def some(kind: PacketKind, **given: Any) -> dict[str, Any]:
    """A value for each field."""
    values = {}
    for number, field in enumerate((*kind.lead, *kind.fields)):
        values[field.name] = "t" * (number + 1) if field.is_text else field.choices[0][0] if field.choices else number
    return values | given


def made(kind: PacketKind, count: int = 5, **given: Any) -> bytes:
    return encode(kind, APIDS[kind.name], count, 77, AT_NS, some(kind, **given))


def test_a_packet_is_laid_out_as_the_standards_say() -> None:
    data = made(PHASE, mode=3, phase=-1, age=1.5)
    identity, sequence, length = struct.unpack(">HHH", data[:6])
    assert (identity >> 13, identity >> 12 & 1, identity >> 11 & 1, identity & 0x7FF) == (0, 0, 1, 258)
    assert (sequence >> 14, sequence & 0x3FFF) == (3, 5)
    assert length == len(data) - 7
    # CUC, CCSDS 301.0-B-4, 3.2: P-field bit 0 extension, 1-3 agency's epoch 010, 4-5 octets less one, 6-7 of fraction
    assert data[6] == 0b0_010_11_11
    assert int.from_bytes(data[7:11], "big") == 1_764_000_000
    assert int.from_bytes(data[11:14], "big") / 2**24 == pytest.approx(0.123456789, abs=2**-24)
    assert struct.unpack(">BH", data[14:17]) == (packets.VERSION, 77)
    assert struct.unpack(">Bif", data[17:-2]) == (3, -1, 1.5)
    register = 0xFFFF
    for bit in (byte >> (7 - k) & 1 for byte in data[:-2] for k in range(8)):  # ECSS-E-ST-70-41C, B.1.3
        register = (register << 1 ^ (0x1021 if bit ^ register >> 15 else 0)) & 0xFFFF
    assert int.from_bytes(data[-2:], "big") == register


def test_the_crc_is_that_of_the_standards_examples() -> None:
    examples = {"0000": 0x1D0F, "000000": 0xCC9C, "abcdef01": 0x04A2, "1456f89a0001": 0x7FD5}  # annex B.1.5
    assert {data: packets.crc(bytes.fromhex(data)) for data in examples} == examples


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_what_is_sent_is_read(kind: PacketKind) -> None:
    data = made(kind, count=packets.COUNTS + 3)
    packet = decode(data, BY_APID)
    assert (packet.kind, packet.count, packet.session, len(data)) == (kind, 3, 77, kind.length)
    assert abs(packet.at_ns - AT_NS) <= 60
    words = {field.name: field.choices[0][1] for field in kind.fields if field.choices}
    assert packet.values == some(kind) | words


@pytest.mark.parametrize("at_ns", [0, 1, 59, 60, 999_999_999, AT_NS, (1 << 32) * 1_000_000_000 - 1])
def test_time_is_kept_to_its_resolution(at_ns: int) -> None:
    packet = decode(encode(PHASE, 258, 0, 0, at_ns, some(PHASE)), BY_APID)
    assert 0 <= at_ns - packet.at_ns + 1 <= 61
    assert (
        encode(PHASE, 258, 0, 0, packet.at_ns, some(PHASE))[6:14] == encode(PHASE, 258, 0, 0, at_ns, some(PHASE))[6:14]
    )


def test_every_changed_bit_is_refused() -> None:
    data = made(ANSWER)
    for bit in range(8 * len(data)):
        changed = bytearray(data)
        changed[bit // 8] ^= 1 << bit % 8
        with pytest.raises(PacketError):
            decode(bytes(changed), BY_APID)


@given(st.binary(max_size=300))
def test_any_bytes_are_a_packet_or_refused(data: bytes) -> None:
    try:
        packet = decode(data + packets.crc(data).to_bytes(2, "big"), BY_APID)
    except PacketError:
        return
    assert packet.kind in KINDS.values()


def test_absurd_numbers_are_the_ends_of_their_fields() -> None:
    values = decode(
        made(STATUS, latched=1 << 40, rows=-5, phase=-(1 << 40), rows_hz=1e300, slowest=-1e39), BY_APID
    ).values
    assert values["latched"] == (1 << 32) - 1
    assert (values["rows"], values["phase"]) == (0, -(1 << 31))
    assert (values["rows_hz"], values["slowest"]) == (math.inf, -math.inf)
    nothing = decode(made(ANSWER, value=math.nan), BY_APID)
    assert math.isnan(nothing.values["value"])
    assert plain(nothing)["value"] is None


def test_texts_are_cut_between_characters_and_end_with_zero() -> None:
    values = decode(made(EVENT, text="ä" * 200, code="a\0b", source="[/]"), BY_APID).values
    assert values["text"] == "ä" * 80
    assert (values["code"], values["source"]) == ("a b", "[/]")


def sealed(data: bytes) -> bytes:
    return data[:-2] + packets.crc(data[:-2]).to_bytes(2, "big")


def test_other_definitions_apids_and_words_are_refused_with_the_reason() -> None:
    data = bytearray(made(PHASE))
    data[14] = packets.VERSION + 1
    with pytest.raises(PacketError, match=f"number {packets.VERSION + 1}, these are {packets.VERSION}: use the heft"):
        decode(sealed(bytes(data)), BY_APID)
    with pytest.raises(PacketError, match="APID 900 is none of this downlink"):
        decode(encode(PHASE, 900, 0, 0, 0, some(PHASE)), BY_APID)
    with pytest.raises(PacketError, match="mode 77 is none of boot, checkout"):
        decode(made(PHASE, mode=77), BY_APID)
    with pytest.raises(PacketError, match="a packet phase has 28 bytes, this packet 94"):
        decode(encode(ANSWER, APIDS["phase"], 0, 0, 0, some(ANSWER)), BY_APID)
