"""Kinds of packets, and a packet's bytes and values.

A packet is a CCSDS space packet (133.0-B-2): primary header (6 bytes), secondary header, fields, and a packet error
control (CRC-16, polynomial 0x1021, preset 0xFFFF, over all before it; ECSS-E-ST-70-41C annex B). The secondary header
is a CUC time code (301.0-B-4) with its P-field: level 2, epoch 1970-01-01, 4 bytes of seconds, 3 bytes of 2^-24 s;
then the number of these definitions, and the session, a number drawn by each process that sends. Sequence counts go by
APID and session.

Reports on commands are those of PUS service 1 (ECSS-E-ST-70-41C): a PUS header stands before the secondary one, which
is its time field with the spare bytes that follow.

All numbers are big-endian. Texts are UTF-8 in a field of fixed size, with a zero at their end. So each kind has one
length, which a decoder holds every packet to.
"""

import binascii
import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from spacepackets.ccsds.spacepacket import SequenceFlags, SpacePacketHeader

from drivers.records import Severity
from onboard.channels import Refusal

VERSION = 2  # of these definitions: another one for every change of a field
P_FIELD = 0x2F  # 0, level 2 (010), 4 bytes of seconds (11), 3 bytes of fraction (11)
FRACTION = 1 << 24
COUNTS = 1 << 14  # sequence counts before they begin again
HEADER_BYTES, SECONDARY, CRC_BYTES = 6, struct.Struct(">BI3sBH"), 2
_LARGEST = 3.4028234e38  # of single precision
UNKNOWN_MODE, UNKNOWN_PHASE = 255, -1
PUS_C = 2 << 4  # version of the PUS, and 0: status of the time reference is not reported

# Words of onboard.flight.supervise.modes and onboard.identification.standing, without what those import: a process that
# only sends stays small. A test compares them.
MODES = (*enumerate(("boot", "checkout", "armed", "run", "safe", "stopped")), (UNKNOWN_MODE, "unknown"))
LEVELS = tuple(enumerate(("good", "weak", "do not use")))
REFUSALS = tuple((int(one), one.name.lower().replace("_", " ")) for one in Refusal)


class PacketError(ValueError):
    """Bytes that are no packet of ours, or one that was damaged."""


class Field(NamedTuple):
    """A field: ``code`` is that of :mod:`struct`; ``choices`` are the words for its numbers."""

    name: str
    code: str
    meaning: str
    unit: str = ""
    choices: tuple[tuple[int, str], ...] = ()

    @property
    def is_text(self) -> bool:
        """Whether it is a text, else a number."""
        return self.code.endswith("s")

    @property
    def bits(self) -> int:
        """Its size."""
        return 8 * struct.calcsize(">" + self.code)


class PacketKind(NamedTuple):
    """A kind of packet."""

    name: str
    meaning: str
    fields: tuple[Field, ...]
    lead: tuple[Field, ...] = ()  # before the secondary header

    @property
    def format(self) -> struct.Struct:
        """Of its fields, without headers and CRC."""
        return _format(self.fields)

    @property
    def secondary_at(self) -> int:
        """Where the secondary header begins, bytes."""
        return HEADER_BYTES + _format(self.lead).size

    @property
    def length(self) -> int:
        """Of the whole packet, bytes."""
        return self.secondary_at + SECONDARY.size + self.format.size + CRC_BYTES


def _format(fields: tuple[Field, ...]) -> struct.Struct:
    return struct.Struct(">" + "".join(field.code for field in fields))


STATUS = PacketKind(
    "status",
    "health of the flight and of this downlink",
    (
        Field("latched", "I", "status word, all bits since the start; 0: nothing failed; bit 31: health not known"),
        Field("word", "I", "status word of the last second"),
        Field("health_age", "f", "since the health record that these are of; NaN: there was none", "s"),
        Field("mode", "B", "mode of the flight", choices=MODES),
        Field("phase", "i", "phase of the mission; -1: not known"),
        Field("rows", "Q", "rows of all devices since the start"),
        Field("rows_hz", "f", "the same in the last second", "1/s"),
        Field("slowest", "f", "of its nominal rate, the slowest channel", "%"),
        Field("gaps", "I", "gap records since the start"),
        Field("missing", "Q", "rows in them"),
        Field("not_recorded", "Q", "rows that the recorder lost"),
        Field("recorder_backlog", "f", "rows not yet in the log, of the fullest ring", "%"),
        Field("estimator_lag", "f", "since the last sample that the estimator took in", "s"),
        Field("estimator_skipped", "f", "of the devices' rows left out, since the start", "s"),
        Field("restarts", "I", "of workers, since the start"),
        Field("clocks_locked", "B", "clocks of devices that are locked"),
        Field("clocks_not_locked", "B", "that are not"),
        Field("computer_idle", "f", "of all cores", "%"),
        Field("memory_free", "f", "of the computer", "MB"),
        Field("disk_free", "f", "where the log is written", "MB"),
        Field("temperature", "f", "the hottest zone", "deg C"),
        Field("sent", "I", "packets of this session before this"),
        Field("unsent_answers", "I", "answers replaced by newer answers before they were sent; the log has them"),
        Field("unsent_events", "I", "events that were not sent; the log has them"),
        Field("unsent_phases", "I", "changes of mode or phase that were not sent; the log has them"),
        Field("unsent_reasons", "I", "reasons of answers that were not sent; the log has them"),
        Field("overdue", "I", "periods that passed while status or an answer was due"),
        Field("unread", "I", "rows that were overwritten in a ring before they were read here"),
    ),
)
ANSWER = PacketKind(
    "answer",
    "an estimate with its 95 and 99.9 % intervals; NaN where it is not determined or not to be used",
    (
        Field("quantity", "33s", "what it is of, as in the log"),
        Field("unit", "16s", "of the numbers"),
        Field("supported", "B", "0: not determined (yet), or not to be used", choices=((0, "no"), (1, "yes"))),
        Field("level", "B", "how good it is", choices=LEVELS),
        Field("value", "f", "estimate"),
        Field("low", "f", "lower end of the 95 % interval"),
        Field("high", "f", "upper end"),
        Field("low_999", "f", "lower end of the 99.9 % interval"),
        Field("high_999", "f", "upper end"),
        Field("sigma", "f", "standard deviation"),
    ),
)
PHASE = PacketKind(
    "phase",
    "mode of the flight and phase of the mission: when they change, and now and then",
    (
        Field("mode", "B", "mode of the flight", choices=MODES),
        Field("phase", "i", "phase of the mission; -1: not known"),
        Field("age", "f", "since the last change of either", "s"),
    ),
)
EVENT = PacketKind(
    "event",
    "an event of the log",
    (
        Field("severity", "B", "how serious", choices=tuple((int(one), one.name.lower()) for one in Severity)),
        Field("code", "32s", "kind of event"),
        Field("source", "33s", "who says it"),
        Field("text", "161s", "what was said"),
    ),
)
REASON = PacketKind(
    "reason",
    "why an answer is no better: when it changes, and now and then",
    (
        Field("quantity", "33s", "which answer"),
        Field("level", "B", "how good it is", choices=LEVELS),
        Field("why", "129s", "it is no better"),
    ),
)
FLIGHT = PacketKind(
    "flight",
    "which flight this is; vehicle time of a packet is its time less wall_clock plus monotonic",
    (
        Field("flight", "33s", "id of the flight"),
        Field("vehicle", "33s", "its name"),
        Field("log", "65s", "name of the log's first file"),
        Field("wall_clock", "Q", "CLOCK_REALTIME at the start, since 1970", "ns"),
        Field("monotonic", "Q", "CLOCK_MONOTONIC at the same instant, by which the log's host_ns goes", "ns"),
    ),
)
_PUS = (
    Field("pus", "B", "PUS version 2 (C), and 0: status of the time reference is not reported"),
    Field("service", "B", "PUS service, 1: verification"),
    Field("subtype", "B", "of the message"),
    Field("counter", "H", "messages of this service and subtype before it in this session"),
    Field("destination", "H", "source identifier of the command"),
)
_REQUEST = (
    Field("packet_id", "H", "first two bytes of the command"),
    Field("sequence_control", "H", "its next two bytes: sequence flags and count"),
)
REPORT = PacketKind("report", "a command was accepted (subtype 1), is begun (3), is completed (7)", _REQUEST, _PUS)
FAILURE = PacketKind(
    "failure",
    "a command was not accepted (subtype 2), or could not be completed (8)",
    (*_REQUEST, Field("code", "B", "why", choices=REFUSALS), Field("why", "64s", "and what to do")),
    _PUS,
)
KINDS = {kind.name: kind for kind in (STATUS, ANSWER, PHASE, EVENT, REASON, FLIGHT, REPORT, FAILURE)}
LONGEST = max(kind.length for kind in KINDS.values())  # bytes


@dataclass(frozen=True)
class Packet:
    """A packet that came whole."""

    kind: PacketKind
    count: int  # of its APID and session, modulo 2^14
    session: int
    at_ns: int  # since 1970, to 60 ns
    values: dict[str, Any]  # by field: numbers, texts, words of choices


def crc(data: bytes) -> int:
    """CRC-16 of ``data``; 0 over a packet with its own."""
    return binascii.crc_hqx(data, 0xFFFF)


def encode(kind: PacketKind, apid: int, count: int, session: int, at_ns: int, values: Mapping[str, Any]) -> bytes:
    """A packet. A text that is too long is cut, a number that is too large is the largest of its field (infinity).

    Args:
        kind: of packet.
        apid: it is sent with.
        count: of packets with this APID before it in this session.
        session: 16 bits.
        at_ns: its time, since 1970.
        values: by field.
    """
    seconds, rest_ns = divmod(at_ns, 1_000_000_000)
    fraction = rest_ns * FRACTION // 1_000_000_000
    head = SpacePacketHeader.tm(
        apid=apid, seq_count=count % COUNTS, data_len=kind.length - HEADER_BYTES - 1, sec_header_flag=True
    ).pack()
    secondary = SECONDARY.pack(P_FIELD, seconds % (1 << 32), fraction.to_bytes(3, "big"), VERSION, session)
    body = bytes(head) + _packed(kind.lead, values) + secondary + _packed(kind.fields, values)
    return body + crc(body).to_bytes(CRC_BYTES, "big")


def _packed(fields: tuple[Field, ...], values: Mapping[str, Any]) -> bytes:
    found = [_text(values[f.name], f) if f.is_text else _number(values[f.name], f) for f in fields]
    return _format(fields).pack(*found)


def _text(value: str, field: Field) -> bytes:
    room = field.bits // 8 - 1
    whole = value.replace("\0", " ").encode(errors="replace")[:room]
    return whole.decode(errors="ignore").encode()  # no part of a character


def _number(value: float, field: Field) -> float:
    if field.code == "f":
        single = abs(value) <= _LARGEST or not math.isfinite(value)
        return value if single else math.copysign(math.inf, value)
    half = 1 << (field.bits - 1)
    low, high = (-half, half - 1) if field.code.islower() else (0, 2 * half - 1)
    return min(max(int(value), low), high)


def decode(data: bytes, kinds: Mapping[int, PacketKind]) -> Packet:
    """The packet that ``data`` is.

    Args:
        data: a whole packet.
        kinds: by APID.

    Raises:
        PacketError: it is none of ``kinds``, of other definitions, or damaged.
    """
    if len(data) < HEADER_BYTES + SECONDARY.size + CRC_BYTES:
        raise PacketError(f"{len(data)} bytes are no packet")
    if crc(data):
        raise PacketError("its CRC is wrong: damaged on the way")
    head = SpacePacketHeader.unpack(data[:HEADER_BYTES])
    kind = kinds.get(head.apid)
    at = HEADER_BYTES if kind is None or len(data) != kind.length else kind.secondary_at
    p_field, seconds, fraction, version, session = SECONDARY.unpack_from(data, at)
    if kind is None or head.seq_flags is not SequenceFlags.UNSEGMENTED or not head.sec_header_flag:
        raise PacketError(f"APID {head.apid} is none of this downlink: see [telemetry] of the vehicle file")
    if version != VERSION or p_field != P_FIELD:
        raise PacketError(f"its definitions are number {version}, these are {VERSION}: use the heft that flew")
    if len(data) != kind.length:
        raise PacketError(f"a packet {kind.name} has {kind.length} bytes, this packet {len(data)}")
    found = _format(kind.lead).unpack_from(data, HEADER_BYTES) + kind.format.unpack_from(data, at + SECONDARY.size)
    fraction_ns = (int.from_bytes(fraction, "big") * 1_000_000_000 + FRACTION - 1) // FRACTION
    values = {field.name: _value(field, value) for field, value in zip((*kind.lead, *kind.fields), found, strict=True)}
    return Packet(kind, head.seq_count, session, seconds * 1_000_000_000 + fraction_ns, values)


def _value(field: Field, value: Any) -> Any:
    if field.is_text:
        return bytes(value).partition(b"\0")[0].decode(errors="replace")
    if not field.choices:
        return value
    word = dict(field.choices).get(value)
    if word is None:
        raise PacketError(f"{field.name} {value} is none of {', '.join(word for _, word in field.choices)}")
    return word


def plain(packet: Packet) -> dict[str, Any]:
    """A packet as values that JSON has: a number that is none, or infinite, is None."""
    return {
        "packet": packet.kind.name,
        "time_ns": packet.at_ns,
        "session": packet.session,
        "count": packet.count,
        **{
            name: None if isinstance(value, float) and not math.isfinite(value) else value
            for name, value in packet.values.items()
        },
    }
