"""Commands as PUS telecommands (ECSS-E-ST-70-41C, version C): their bytes, and what is accepted of what comes.

Service 128, subtypes by :class:`onboard.channels.Order`. The application data begin with the session of the downlink
(16 bits): who commands has heard this flight, and a recording of another flight's commands does nothing. Then a MARK
has its number (16 bits), a SPAN its begin and end (seconds since 1970, 32 bits each). A sequence count of a source is
accepted once in a session.

Anything else than a result out of :meth:`Uplink.feed` is a bug here, whatever the bytes are.
"""

import re
import struct
from collections.abc import Collection
from typing import NamedTuple

from spacepackets import BytesTooShortError
from spacepackets.ecss.req_id import RequestId
from spacepackets.ecss.tc import InvalidTcCrc16Error, PusTc

from onboard.channels import Order, Refusal
from onboard.telemetry.downlink import FlightIdentity

SERVICE = 128
LAYOUTS = {Order.MARK: struct.Struct(">HH"), Order.STOP: struct.Struct(">H"), Order.SPAN: struct.Struct(">HII")}
LONGEST_SPAN_S = 600
_HEAD_BYTES, _LONGEST = 6, 64  # of a command
MOST_AT_ONCE = 32  # commands of one call: each is a row and an event of the log
_SECOND_NS = 1_000_000_000
WHY = {
    Refusal.NOT_ARMED: "arm it: [telemetry] commands of the vehicle file",
    Refusal.OUT_OF_RANGE: f"begin before end, within the flight, {LONGEST_SPAN_S} s at most",
    Refusal.DUPLICATE: "this sequence count has come before: give another",
    Refusal.UNKNOWN: f"service {SERVICE}: 1 mark, 2 stop, 3 span",
    Refusal.MALFORMED: "its data have another length: see docs/ground.md",
    Refusal.OTHER_SESSION: "it is of another session: take that of the last packet",
    Refusal.BUSY: "a span is being sent: ask when it is done",
    Refusal.NOT_DONE: "it was accepted, and not carried out: see the log",
}


class Telecommand(NamedTuple):
    """A command that came whole.

    Attributes:
        order: :class:`Order`, 0 if it is none.
        request: its first four bytes, by which reports name it.
        acknowledge: which reports are wanted: 8 accepted, 4 begun, 1 completed.
    """

    order: int
    refused: Refusal
    request: bytes
    source: int
    acknowledge: int
    number: int = 0
    begin_ns: int = 0  # CLOCK_MONOTONIC
    end_ns: int = 0


def telecommand(order: Order, apid: int, session: int, count: int, source: int, *arguments: int) -> bytes:
    """The packet of a command.

    Args:
        order: what is asked.
        apid: ``command_apid`` of the vehicle file.
        session: of the downlink's packets.
        count: its sequence count, another one for each command of a source.
        source: who asks, 16 bits.
        arguments: number of a mark; begin and end of a span, seconds since 1970.
    """
    data = LAYOUTS[order].pack(session, *arguments)
    packet = PusTc(SERVICE, int(order), apid=apid, app_data=data, seq_count=count, source_id=source)
    return bytes(packet.pack())


class Uplink:
    """Commands in bytes that come piece by piece.

    Args:
        apid: of commands.
        session: of the downlink.
        armed: names of the orders that are taken.
        flight: its clocks and its begin.

    Attributes:
        skipped: bytes that belong to no whole command.
        left_out: commands beyond :data:`MOST_AT_ONCE`, neither judged nor reported on.
    """

    def __init__(self, apid: int, session: int, armed: Collection[str], flight: FlightIdentity) -> None:
        identity = (0x1800 | apid).to_bytes(2, "big")  # version 0, telecommand, with a secondary header
        self._head = re.compile(re.escape(identity) + b"[\xc0-\xff].\x00", re.DOTALL)
        self._session, self._armed, self._flight = session, armed, flight
        self._seen: set[tuple[int, int]] = set()
        self._waiting = b""
        self.skipped = self.left_out = 0

    def feed(self, data: bytes, now_ns: int) -> list[Telecommand]:
        """Commands that are whole with ``data``, at ``now_ns``, CLOCK_MONOTONIC."""
        found: list[Telecommand] = []
        data, at = self._waiting + data, 0
        while (match := self._head.search(data, at)) is not None:
            self.skipped += match.start() - at
            at = match.start()
            length = int.from_bytes(data[at + 4 : at + _HEAD_BYTES], "big") + _HEAD_BYTES + 1
            if len(data) - at < _HEAD_BYTES or (length <= _LONGEST and len(data) - at < length):
                break  # more is to come
            try:
                packet = PusTc.unpack(data[at : at + length]) if length <= _LONGEST else None
            except (BytesTooShortError, InvalidTcCrc16Error, ValueError):
                packet = None
            if packet is None:
                self.skipped += 1
                at += 1
            else:
                at += length
                if len(found) < MOST_AT_ONCE:
                    found.append(self._judged(packet, now_ns))
                else:
                    self.left_out += 1
        else:
            kept = min(_HEAD_BYTES - 1, len(data) - at)
            self.skipped += len(data) - at - kept
            at = len(data) - kept
        self._waiting = data[at:]
        return found

    def _judged(self, packet: PusTc, now_ns: int) -> Telecommand:
        count, data = packet.sp_header.seq_count, bytes(packet.app_data)
        request = RequestId.from_sp_header(packet.sp_header).pack()
        head = packet.pus_tc_sec_header
        found = Telecommand(0, Refusal.UNKNOWN, request, head.source_id, head.ack_flags)
        if packet.service != SERVICE or packet.message_subtype not in set(Order):
            return found
        order = Order(packet.message_subtype)
        found = found._replace(order=order, refused=Refusal.NONE)
        if len(data) != LAYOUTS[order].size:
            return found._replace(refused=Refusal.MALFORMED)
        session, *arguments = LAYOUTS[order].unpack(data)
        if session != self._session or (head.source_id, count) in self._seen:
            return found._replace(refused=Refusal.OTHER_SESSION if session != self._session else Refusal.DUPLICATE)
        self._seen.add((head.source_id, count))
        if order.name.lower() not in self._armed:
            return found._replace(refused=Refusal.NOT_ARMED)
        if order is Order.MARK:
            return found._replace(number=arguments[0])
        return self._span(found, arguments, now_ns) if order is Order.SPAN else found

    def _span(self, found: Telecommand, seconds: list[int], now_ns: int) -> Telecommand:
        later_ns = self._flight.monotonic_ns - self._flight.wall_clock_ns
        begin_ns, end_ns = (one * _SECOND_NS + later_ns for one in seconds)
        is_within = self._flight.monotonic_ns - _SECOND_NS <= begin_ns < end_ns <= now_ns + _SECOND_NS
        if not is_within or seconds[1] - seconds[0] > LONGEST_SPAN_S:
            return found._replace(refused=Refusal.OUT_OF_RANGE)
        return found._replace(begin_ns=begin_ns, end_ns=end_ns)
