"""What nodes answer the next SYNCs with, computed for many SYNCs at once.

As long as nothing but SYNC happens on a bus, its traffic is known: each SYNC is sent when its box's crystal says so,
and the nodes answer it with objects whose future is known as far as the plant is computed. Their frames follow each
other in the order of their identifiers. Whatever else happens (a frame of the flight computer, a heartbeat, a timer)
ends a train where it stands, and the wire goes on frame by frame; so both ways give the same frames at the same times.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import chain, repeat
from typing import Final, NamedTuple, Protocol, TypeGuard, cast, runtime_checkable

import numpy as np

from hil_sim.devices.can_bus.frame_length import INTERMISSION_BITS, frame_bits, frames_bits
from hil_sim.devices.can_bus.tpdo import ANSWER_NS, Tpdo

SYNC = 0x080
_MOST_SYNCS = 256  # computed at once
_FEWEST_SYNCS = 8  # for fewer it does not pay
_ANSWERING: Final[dict[type, bool]] = {}  # whether nodes of a class know what they answer


@runtime_checkable
class AnswersAhead(Protocol):
    """A node that knows what it answers SYNCs with.

    Attributes:
        revision: Changes with all that its answers depend on, but for the plant.
    """

    revision: int

    def answers(self, now_ns: int) -> Sequence[Tpdo] | None:
        """The TPDOs that it answers each SYNC from now on with, as it stands; None: it does something else on one."""

    def knows_until(self, now_ns: int) -> int:
        """Up to when that holds, if nothing but SYNC happens; ``now_ns`` or before: not at all."""

    def hears(self, identifier: int) -> bool:
        """Whether a PDO of another node does anything to it."""


@runtime_checkable
class SendsSyncs(Protocol):
    """A box whose next SYNCs are known."""

    @property
    def due_ns(self) -> int:
        """When it next does something."""

    def next_syncs(self, before_ns: int, most: int) -> list[tuple[int, bytes]]:
        """Times and data of the SYNCs after the last one sent, before ``before_ns``; none if that is not known."""

    def have_sent(self, count: int) -> None:
        """So many of these were sent, each at its time."""


class WireFrame(NamedTuple):
    """A frame that has been on the wire, and when its last bit was there."""

    end_ns: int
    identifier: int
    data: bytes


_frame_of: Final = cast(Callable[[tuple[int, int, bytes]], WireFrame], partial(tuple.__new__, WireFrame))


def wire_frames(ends_ns: Iterable[int], identifiers: Iterable[int], data: Iterable[bytes]) -> list[WireFrame]:
    """Frames of columns that may be longer than the shortest; half the time that their own class takes."""
    return list(map(_frame_of, zip(ends_ns, identifiers, data, strict=False)))


def _answers_ahead(node: object) -> TypeGuard[AnswersAhead]:
    """Whether a node is one, found once of each class: Python 3.11 takes longer for that than the wire for a SYNC."""
    kind = type(node)
    if kind not in _ANSWERING:
        _ANSWERING[kind] = isinstance(node, AnswersAhead)
    return _ANSWERING[kind]


class Train(NamedTuple):
    """The answers to one SYNC.

    Attributes:
        ready_ns: When they are offered to the bus.
        frames: In the order of the wire, as they are if nothing comes between.
        begins_ns: When each begins.
        senders: Places of their nodes on the wire.
    """

    ready_ns: int
    frames: Sequence[WireFrame]
    begins_ns: Sequence[int]
    senders: Sequence[int]


class SyncTrains:
    """Trains by the end of the SYNC that they answer, and whole rounds: SYNCs with their trains.

    Args:
        bit_ns: Length of a bit.

    Attributes:
        box: What sends the SYNCs that are known; None while none is.
    """

    def __init__(self, bit_ns: float) -> None:
        self.box: SendsSyncs | None = None
        self._bit_ns = bit_ns
        self._gap_ns = round(INTERMISSION_BITS * bit_ns)
        self._tpdos: list[Tpdo] = []
        self._nodes: list[AnswersAhead] = []
        self._revisions: list[int] = []
        self._forget()

    def take(self, sync_end_ns: int, nodes: Sequence[object], box: object, known_ns: int) -> Train | None:
        """The train that answers the SYNC that ends now; None where it is not known.

        Args:
            sync_end_ns: When.
            nodes: All on the wire.
            box: That of them that sent it.
            known_ns: Before when the plant is computed.
        """
        if self._is_other():
            self._forget()
        place = self._places.get(sync_end_ns)
        if place is None and sync_end_ns < known_ns:
            self._compute(sync_end_ns, nodes, box, known_ns)
            place = self._places.get(sync_end_ns)
        if place is None:
            return None
        self._next = place + 1
        for tpdo in self._tpdos:
            tpdo.answered(1)
        first = place * (1 + len(self._senders))
        frames = self._frames[first + 1 : first + 1 + len(self._senders)]
        return Train(sync_end_ns + ANSWER_NS, frames, self._begins_ns[place], self._senders)

    def run(self, start_ns: int, until_ns: int) -> list[WireFrame]:
        """SYNCs, the first of them sent at ``start_ns`` on an idle bus, and their answers, up to ``until_ns``.

        They are those that are whole by then, and have been sent afterwards; none where they are not known.
        """
        first, size = self._next, 1 + len(self._senders)
        if self.box is None or first >= len(self._starts_ns) or self._starts_ns[first] != start_ns or self._is_other():
            return []
        self._next = bisect_right(self._lasts_ns, until_ns, first)
        if self._next > first:
            self.box.have_sent(self._next - first)
            for tpdo in self._tpdos:
                tpdo.answered(self._next - first)
        return self._frames[first * size : self._next * size]

    def _is_other(self) -> bool:
        """Whether a node does not stand as it stood."""
        return [node.revision for node in self._nodes] != self._revisions

    def _forget(self) -> None:
        self.box = None
        self._places: dict[int, int] = {}  # by the end of the SYNC
        self._starts_ns: list[int] = []  # of SYNCs
        self._lasts_ns: list[int] = []  # ends of rounds, as far as no round delays the next one
        self._frames: list[WireFrame] = []  # round by round
        self._begins_ns: list[Sequence[int]] = []  # of the answers
        self._senders: list[int] = []  # their places on the wire
        self._next = 0  # the first round that has not been on the wire

    def _compute(self, sync_end_ns: int, nodes: Sequence[object], box: object, known_ns: int) -> None:
        """Compute the trains of the SYNC that ends now and of those after it."""
        self._forget()
        self._nodes, self._tpdos = [], []
        senders: list[tuple[Tpdo, int]] = []
        for place, node in enumerate(nodes):
            if node is box:
                continue
            if not _answers_ahead(node) or (answers := node.answers(sync_end_ns)) is None:
                return
            known_ns = min(known_ns, node.knows_until(sync_end_ns))
            self._nodes.append(node)
            senders += [(tpdo, place) for tpdo in answers]
        senders.sort(key=lambda one: one[0].cob_id)
        identifiers = [tpdo.cob_id for tpdo, _ in senders]
        is_process_data = all(0x180 < identifier < 0x580 for identifier in identifiers)
        if not is_process_data or len(set(identifiers)) < len(identifiers) or not isinstance(box, SendsSyncs):
            return
        if any(node.hears(identifier) for node in self._nodes for identifier in identifiers):
            return
        self._revisions = [node.revision for node in self._nodes]
        self._tpdos = [tpdo for tpdo, _ in senders]
        syncs = [(-1, b""), *box.next_syncs(known_ns, _MOST_SYNCS)]
        ends_ns = [sync_end_ns]
        ends_ns += [start_ns + round(frame_bits(SYNC, data) * self._bit_ns) for start_ns, data in syncs[1:]]
        count = bisect_left(ends_ns, known_ns)
        if count >= _FEWEST_SYNCS:
            self.box = box
            self._fill(syncs[:count], ends_ns[:count], senders)

    def _fill(self, syncs: list[tuple[int, bytes]], ends_ns: list[int], senders: list[tuple[Tpdo, int]]) -> None:
        times_ns = np.array(ends_ns, np.int64)
        begin_ns = times_ns + max(self._gap_ns, ANSWER_NS)
        last_ns = times_ns
        columns = [wire_frames(ends_ns, repeat(SYNC), [data for _, data in syncs])]
        begins: list[list[int]] = []
        for tpdo, _ in senders:
            contents = tpdo.samples(times_ns)
            identifier, size = tpdo.cob_id, contents.shape[1]
            last_ns = begin_ns + np.rint(frames_bits(identifier, contents) * self._bit_ns).astype(np.int64)
            whole = contents.tobytes()
            pieces = [whole[at : at + size] for at in range(0, len(whole), size)]
            columns.append(wire_frames(last_ns.tolist(), repeat(identifier), pieces))
            begins.append(begin_ns.tolist())
            begin_ns = last_ns + self._gap_ns
        self._frames = list(chain.from_iterable(zip(*columns, strict=True)))
        self._begins_ns = list(zip(*begins, strict=True)) if begins else [()] * len(syncs)
        self._senders = [place for _, place in senders]
        self._places = {end_ns: place for place, end_ns in enumerate(ends_ns)}
        self._starts_ns = [start_ns for start_ns, _ in syncs]
        late = np.flatnonzero(np.array(self._starts_ns[1:]) < last_ns[:-1] + self._gap_ns)
        self._lasts_ns = last_ns[: late[0] if len(late) else None].tolist()
