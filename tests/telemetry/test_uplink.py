"""Commands: their bytes against the standard's own layout, and what is refused of what comes."""

import binascii
import struct
import xml.etree.ElementTree as ET
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from space_packet_parser.generators.ccsds import ccsds_generator
from space_packet_parser.xtce.definitions import XtcePacketDefinition
from space_packet_parser.xtce.validation import validate_xtce
from spacepackets.ecss.pus_1_verification import ManagedParamsVerification, Service1Tm
from spacepackets.ecss.tm import ManagedParams

from onboard.channels import Order, Refusal
from onboard.cli.common import console
from onboard.config.telemetry import Telemetry
from onboard.telemetry import xtce
from onboard.telemetry.board import PacketBoard
from onboard.telemetry.packets import KINDS, SECONDARY
from onboard.telemetry.stream import Series, Splitter
from onboard.telemetry.uplink import LAYOUTS, MOST_AT_ONCE, Telecommand, Uplink, telecommand
from tests.telemetry.rows import FLIGHT, SECOND_NS, START_NS, downlink, sent

APID, SESSION = 264, 7
ALL = ("mark", "stop", "span")
NOW_NS = START_NS + 200 * 1_000_000_000
NOW_S = FLIGHT.wall_clock_ns // 1_000_000_000 + 200


def uplink(armed: tuple[str, ...] = ALL) -> Uplink:
    return Uplink(APID, SESSION, armed, FLIGHT)


def told(order: Order = Order.MARK, *arguments: int, count: int = 5, session: int = SESSION, source: int = 2) -> bytes:
    return telecommand(order, APID, session, count, source, *arguments)


def one(data: bytes, armed: tuple[str, ...] = ALL) -> Telecommand:
    [command] = uplink(armed).feed(data, NOW_NS)
    return command


def by_hand(service: int, subtype: int, data: bytes, count: int = 5, ack: int = 0xF) -> bytes:
    """ECSS-E-ST-70-41C 7.4.4.1: PUS version 2 and acknowledgement flags, service, subtype, source; CRC of annex B."""
    body = struct.pack(">BBBH", 0x20 | ack, service, subtype, 2) + data
    head = struct.pack(">HHH", 1 << 12 | 1 << 11 | APID, 3 << 14 | count, len(body) + 2 - 1)
    return head + body + struct.pack(">H", binascii.crc_hqx(head + body, 0xFFFF))


def test_a_command_is_laid_out_as_the_standard_says() -> None:
    assert told(Order.MARK, 33) == by_hand(128, 1, struct.pack(">HH", SESSION, 33))
    assert told(Order.STOP) == by_hand(128, 2, struct.pack(">H", SESSION))
    assert told(Order.SPAN, 10, 20) == by_hand(128, 3, struct.pack(">HII", SESSION, 10, 20))
    assert one(told(Order.MARK, 33)) == Telecommand(1, Refusal.NONE, bytes.fromhex("1908c005"), 2, 15, 33)


def test_a_span_is_in_the_time_of_the_log() -> None:
    command = one(told(Order.SPAN, NOW_S - 60, NOW_S - 30))
    assert (command.begin_ns, command.end_ns) == (NOW_NS - 60 * 10**9, NOW_NS - 30 * 10**9)


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (told(Order.MARK, 3, session=8), Refusal.OTHER_SESSION),
        (by_hand(17, 1, b""), Refusal.UNKNOWN),
        (by_hand(128, 4, b"\0\7"), Refusal.UNKNOWN),
        (by_hand(128, 1, b"\0\7"), Refusal.MALFORMED),
        (by_hand(128, 2, b"\0\7\0"), Refusal.MALFORMED),
        (by_hand(128, 2, b""), Refusal.MALFORMED),
        (told(Order.SPAN, NOW_S - 30, NOW_S - 60), Refusal.OUT_OF_RANGE),
        (told(Order.SPAN, NOW_S - 60, NOW_S - 60), Refusal.OUT_OF_RANGE),
        (told(Order.SPAN, NOW_S - 60, NOW_S + 2), Refusal.OUT_OF_RANGE),
        (told(Order.SPAN, NOW_S - 202, NOW_S - 100), Refusal.OUT_OF_RANGE),
        (told(Order.SPAN, 0, NOW_S), Refusal.OUT_OF_RANGE),
    ],
)
def test_what_is_not_accepted(data: bytes, why: Refusal) -> None:
    assert one(data).refused == why


def test_a_span_is_bounded() -> None:
    later = Uplink(APID, SESSION, ALL, FLIGHT)
    for count, (seconds, why) in enumerate([(600, Refusal.NONE), (601, Refusal.OUT_OF_RANGE)]):
        data = told(Order.SPAN, NOW_S, NOW_S + seconds, count=count)
        assert [one.refused for one in later.feed(data, NOW_NS + 700 * 10**9)] == [why]


@pytest.mark.parametrize("armed", [(), ("mark",), ("stop", "span")])
def test_only_what_is_armed_is_accepted(armed: tuple[str, ...]) -> None:
    packets = {"mark": told(Order.MARK, 1), "stop": told(Order.STOP), "span": told(Order.SPAN, NOW_S - 9, NOW_S)}
    for name, data in packets.items():
        assert one(data, armed).refused == (Refusal.NONE if name in armed else Refusal.NOT_ARMED)


def test_a_sequence_count_is_accepted_once_of_each_source() -> None:
    link = uplink()
    told_ = [told(Order.MARK, 1), told(Order.STOP), told(Order.MARK, 1, source=3), told(Order.MARK, 1, count=6)]
    found = [link.feed(data, NOW_NS)[0].refused for data in told_]
    assert found == [Refusal.NONE, Refusal.DUPLICATE, Refusal.NONE, Refusal.NONE]


@given(st.integers(1, 7), st.binary(max_size=40), st.integers(0, 60))
def test_commands_are_found_whatever_lies_between(step: int, junk: bytes, cut: int) -> None:
    data = (
        junk.replace(b"\x19", b"") + told(Order.MARK, 1) + junk[:cut].replace(b"\x19", b"") + told(Order.STOP, count=6)
    )
    link, found = uplink(), []
    for at in range(0, len(data), step):
        found += link.feed(data[at : at + step], NOW_NS)
    assert [command.order for command in found] == [Order.MARK, Order.STOP]
    assert link.skipped == len(data) - len(told(Order.MARK, 1)) - len(told(Order.STOP))


@given(st.integers(0, 8 * len(told(Order.SPAN, 10, 20)) - 1), st.integers(0, 8 * len(told(Order.SPAN, 10, 20)) - 1))
def test_bits_that_were_turned_never_make_a_command(first: int, second: int) -> None:
    data = bytearray(told(Order.SPAN, NOW_S - 60, NOW_S))
    for bit in {first, second}:
        data[bit // 8] ^= 1 << bit % 8
    link = uplink()
    assert link.feed(bytes(data), NOW_NS) == []
    assert [command.order for command in link.feed(bytes(64) + told(Order.STOP), NOW_NS)] == [Order.STOP]


def test_a_flood_is_left_out() -> None:
    link = uplink()
    flood = b"".join(told(Order.MARK, 1, count=count) for count in range(3000))
    assert len(link.feed(flood, NOW_NS)) == MOST_AT_ONCE
    assert (link.left_out, link.skipped) == (3000 - MOST_AT_ONCE, 0)
    assert [command.refused for command in link.feed(told(Order.STOP, count=4000), NOW_NS)] == [Refusal.NONE]


@given(st.binary(max_size=400))
def test_no_bytes_are_a_bug(data: bytes) -> None:
    link = uplink()
    for piece in (data[:7], data[7:], b"\x19\x08\xc0" + data, bytes(66_000)):
        link.feed(piece, NOW_NS)
    assert [command.order for command in link.feed(told(Order.STOP), NOW_NS)] == [Order.STOP]


def reports(*given_: tuple[int, dict[str, Any]]) -> list[bytes]:
    link = downlink(bytes_s=10_000)
    list(link.packets(START_NS))
    for subtype, why in given_:
        link.report(subtype, by_hand(128, 2, b"\0\7")[:4], 2, **why)
    found = []
    for step in range(1, 12):
        now_ns = START_NS + step * 100_000_000
        found += [data for data in link.packets(now_ns) if data[1] in (262 & 0xFF, 263 & 0xFF)]
    return found


def test_reports_are_those_of_service_1() -> None:
    """As the library reads them: the command that they are of, and why it was refused."""
    given_ = [(1, {}), (3, {}), (7, {}), (2, {"code": 1, "why": "arm it"}), (8, {"code": 8, "why": "x" * 99})]
    found = reports(*given_)
    assert len(found) == 5
    counts: list[tuple[int, int]] = []
    for data, (subtype, why) in zip(found, given_, strict=True):
        read = Service1Tm.unpack(
            bytes(data), ManagedParams(SECONDARY.size, has_checksum=True), ManagedParamsVerification()
        )
        assert (read.service, read.message_subtype) == (1, subtype)
        assert (read.tc_req_id.tc_packet_id.apid, read.tc_req_id.tc_psc.seq_count) == (APID, 5)
        assert read.pus_tm.pus_tm_sec_header.dest_id == 2
        counts.append((read.pus_tm.apid, read.pus_tm.seq_count))
        if why:
            assert read.error_code is not None
            assert read.failure_notice is not None
            assert read.error_code.val == why["code"]
            assert read.failure_notice.data.rstrip(b"\0").decode() == why["why"][:63]
    assert counts == [(262, 0), (262, 1), (262, 2), (263, 0), (263, 1)]


def test_reports_take_no_more_than_their_share() -> None:
    """A flood of commands that are refused leaves status and answers their rates."""
    link = downlink()
    taken: list[str] = []
    for step in range(400):
        now_ns = START_NS + step * 50_000_000
        for _ in range(5):
            link.report(2, bytes(4), 1, code=1, why="arm it")
        taken += [packet.kind.name for packet in sent(link, now_ns)]
    assert taken.count("failure") * KINDS["failure"].length <= 0.11 * 1200 * 20
    assert taken.count("status") == 20
    assert taken.count("failure") > 15


def bits_of(root: ET.Element, name: str, values: dict[str, int]) -> str:
    """The bits of a command by the mission database alone."""
    space = {"x": "http://www.omg.org/spec/XTCE/20180204"}
    [command] = root.findall(f".//x:MetaCommand[@name='{name}']", space)
    found = ""
    sizes = {one.attrib["name"]: one.attrib["argumentTypeRef"] for one in command.findall(".//x:Argument", space)}
    for entry in command.findall(".//x:EntryList/*", space):
        if entry.tag.endswith("FixedValueEntry"):
            size = int(entry.attrib["sizeInBits"])
            found += f"{int(entry.attrib['binaryValue'], 16):0{size}b}"[-size:]
        else:
            argument = entry.attrib["argumentRef"]
            [coded] = root.findall(f".//x:*[@name='{sizes[argument]}']//x:IntegerDataEncoding", space)
            found += f"{values[argument]:0{int(coded.attrib['sizeInBits'])}b}"
    return found


@pytest.mark.parametrize(
    ("order", "given_"), [(Order.MARK, {"number": 33}), (Order.STOP, {}), (Order.SPAN, {"begin": 10, "end": 20})]
)
def test_the_mission_database_has_the_commands(order: Order, given_: dict[str, int], tmp_path: Any) -> None:
    text = xtce.database("rocksat", Telemetry().apids, (), APID)
    (tmp_path / "heft.xml").write_text(text)
    assert validate_xtce(tmp_path / "heft.xml", level="all").valid
    bits = bits_of(ET.fromstring(text), order.name.lower(), given_ | {"source": 2, "session": SESSION})
    data = bytearray(told(order, *given_.values(), count=0)[:-2])  # without the CRC
    data[4:6] = bytes(2)  # and the length
    assert int(bits, 2).to_bytes(len(bits) // 8, "big") == data
    assert len(data) == 13 - 2 + LAYOUTS[order].size


def test_without_an_armed_command_the_database_has_none() -> None:
    assert "MetaCommand" not in xtce.database("rocksat", Telemetry().apids)


def test_the_board_says_what_became_of_a_command() -> None:
    link = downlink(bytes_s=10_000)
    stream, series = Splitter(Telemetry().apids), Series()
    board, now_ns = PacketBoard(stream, series), START_NS
    for subtype, why in ((1, {}), (8, {"code": 8, "why": "see the log"})):
        link.report(subtype, told(Order.STOP, count=77)[:4], 2, **why)
        now_ns += SECOND_NS
        for packet in stream.feed(b"".join(link.packets(now_ns))):
            assert series.place(packet).new
            board.add(packet)
    screen = console()
    with screen.capture() as captured:
        screen.print(board.render())
    shown = " ".join(captured.get().split())
    assert "command 77 of source 2: accepted" in shown
    assert "command 77 of source 2: not carried out, not done: see the log" in shown


def test_the_mission_database_verifies_commands_by_their_reports(tmp_path: Any) -> None:
    path = tmp_path / "heft.xml"
    path.write_text(xtce.database("rocksat", Telemetry().apids, (), APID))
    space = {"x": "http://www.omg.org/spec/XTCE/20180204"}
    root, kinds = ET.parse(path).getroot(), ("Accepted", "Execution", "Complete", "Failed")
    for order in Order:
        [command] = root.findall(f".//x:MetaCommand[@name='{order.name.lower()}']", space)
        names = {
            kind: [one.attrib["containerRef"] for one in command.findall(f".//x:{kind}Verifier/x:ContainerRef", space)]
            for kind in kinds
        }
        begun = ["report_begun"] if order is Order.SPAN else []
        assert list(names.values()) == [["report_accepted"], begun, ["report_completed"], ["failure"]]
    link, what = downlink(bytes_s=10_000), XtcePacketDefinition.from_xtce(path, root_container_name=xtce.ROOT)
    for number, subtype in enumerate((1, 3, 7, 2, 8)):  # an independent reader tells the reports apart
        link.report(subtype, told(Order.SPAN, 1, 2, count=77)[:4], 2, **({} if subtype % 2 else {"code": 8, "why": ""}))
        data = b"".join(link.packets(START_NS + (number + 1) * SECOND_NS))
        read = [what.parse_bytes(packet) for packet in ccsds_generator(data)]
        [found] = [packet for packet in read if "pus_subtype" in packet]
        assert found["pus_subtype"] == subtype
