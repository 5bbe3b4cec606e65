"""Bytes to packets, whatever happened to the bytes on the way, and which packets are missing.

``Splitter`` finds packets by what is fixed in them: APID, length of the kind, CRC. Bytes between them are counted and
left out; it returns whole packets, none for "need more", and never raises for bytes. ``Series`` tells by sequence
counts what did not come, and refuses what came before.
"""

import re
from collections.abc import Mapping
from typing import NamedTuple

from onboard.telemetry.packets import COUNTS, HEADER_BYTES, KINDS, Packet, PacketError, PacketKind, crc, decode

_WINDOW = COUNTS // 2  # counts that lie ahead; those behind are of packets that came late or twice
_SILENCE_NS = 60_000_000_000  # so much later than the newest: counts have gone round since


class Splitter:
    """Packets in bytes that come piece by piece.

    Args:
        apids: by kind of packet.

    Attributes:
        skipped: bytes that belong to no whole packet.
        refused: why whole packets of other definitions were left out, and how many.
    """

    def __init__(self, apids: Mapping[str, int]) -> None:
        self._kinds: dict[int, PacketKind] = {apid: KINDS[name] for name, apid in apids.items()}
        self._head = re.compile(b"|".join(_head(kind, apid) for apid, kind in self._kinds.items()), re.DOTALL)
        self._waiting = b""
        self.skipped = 0
        self.refused: dict[str, int] = {}

    def feed(self, data: bytes) -> list[Packet]:
        """Packets that are whole with ``data``."""
        return self._take(self._waiting + data, at_end=False)

    def finish(self) -> list[Packet]:
        """Packets in what is left, when no more comes."""
        return self._take(self._waiting, at_end=True)

    def _take(self, data: bytes, *, at_end: bool) -> list[Packet]:
        found: list[Packet] = []
        at = 0
        while (match := self._head.search(data, at)) is not None:
            begin = match.start()
            kind = self._kinds[int.from_bytes(data[begin : begin + 2], "big") & 0x7FF]
            end = begin + kind.length
            if end > len(data) and not at_end:
                self.skipped += begin - at
                self._waiting = data[begin:]
                return found
            self.skipped += begin - at
            at = begin
            try:
                found.append(decode(data[begin:end], self._kinds))
                at = end
            except PacketError as error:
                if len(data) >= end and not crc(data[begin:end]):
                    self.refused[str(error)] = self.refused.get(str(error), 0) + 1
                    at = end
                else:  # not a packet, or one that was damaged: others may lie within
                    self.skipped += 1
                    at = begin + 1
        kept = 0 if at_end else min(HEADER_BYTES - 1, len(data) - at)  # a header may have begun
        self.skipped += len(data) - at - kept
        self._waiting = data[len(data) - kept :]
        return found


def _head(kind: PacketKind, apid: int) -> bytes:
    """What a primary header looks like: version 0, telemetry, with a secondary header, unsegmented, of this length."""
    identity, length = (0x0800 | apid).to_bytes(2, "big"), (kind.length - HEADER_BYTES - 1).to_bytes(2, "big")
    return re.escape(identity) + b"[\xc0-\xff]." + re.escape(length)


class PacketPlace(NamedTuple):
    """Where a packet stands in its series."""

    new: bool  # False: it came before
    missing: int  # packets between it and the one before


class Series:
    """Packets of every APID and session by their sequence counts.

    Attributes:
        missing: packets that did not come, by kind; one that comes late is taken off again.
        repeated: packets that came more than once.
        unheard: packets of a session that were sent before the first that came.
    """

    def __init__(self) -> None:
        self.missing: dict[str, int] = {}
        self.repeated = self.unheard = 0
        self._next: dict[tuple[int, str], int] = {}
        self._newest_ns: dict[tuple[int, str], int] = {}
        self._open: dict[tuple[int, str], dict[int, None]] = {}  # counts that are missing, the oldest first

    def place(self, packet: Packet) -> PacketPlace:
        """Where ``packet`` stands."""
        key, name = (packet.session, packet.kind.name), packet.kind.name
        expected = self._next.get(key)
        if expected is None:
            self.unheard += packet.count
            return self._ahead(key, packet, 0, packet.count)
        ahead = (packet.count - expected) % COUNTS
        if ahead < _WINDOW or packet.at_ns - self._newest_ns[key] > _SILENCE_NS:
            return self._ahead(key, packet, ahead, expected)
        if packet.count in self._open[key]:
            del self._open[key][packet.count]
            self.missing[name] -= 1
            return PacketPlace(new=True, missing=0)
        self.repeated += 1
        return PacketPlace(new=False, missing=0)

    def _ahead(self, key: tuple[int, str], packet: Packet, ahead: int, expected: int) -> PacketPlace:
        name = packet.kind.name
        left = self._open.setdefault(key, {})
        left.update(dict.fromkeys((expected + one) % COUNTS for one in range(ahead)))
        for old in [*left][: max(0, len(left) - _WINDOW)]:
            del left[old]
        left.pop(packet.count, None)
        self.missing[name] = self.missing.get(name, 0) + ahead
        self._next[key] = (packet.count + 1) % COUNTS
        self._newest_ns[key] = max(packet.at_ns, self._newest_ns.get(key, 0))
        return PacketPlace(new=True, missing=ahead)
