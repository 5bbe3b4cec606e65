"""What nodes answer the next SYNCs with, computed for many SYNCs at once.

As long as nothing but SYNC happens on a bus, its traffic is known: each SYNC is sent when its box's crystal says so,
and the nodes answer it with objects whose future is known as far as the plant is computed. Their frames follow each
other in the order of their identifiers. Whatever else happens (a frame of the flight computer, a heartbeat, a timer)
ends a train where it stands, and the wire goes on frame by frame; so both ways give the same frames at the same times.
"""

from collections.abc import Sequence
from itertools import repeat
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from hil_sim.devices.canopen.frame_length import INTERMISSION_BITS, frame_bits, frames_bits
from hil_sim.devices.canopen.tpdo import ANSWER_NS, Tpdo

_MOST_SYNCS = 256  # computed at once
_FEWEST_SYNCS = 8  # for fewer it does not pay


@runtime_checkable
class AnswersAhead(Protocol):
    """A node that knows what it answers SYNCs with.

    Attributes:
        revision: Changes with all that its answers depend on, but for the plant.
    """

    revision: int

    def answers(self) -> Sequence[Tpdo] | None:
        """The TPDOs that it answers each SYNC with, as it stands; None: it does something else on a SYNC."""

    def hears(self, identifier: int) -> bool:
        """Whether a PDO of another node does anything to it."""


@runtime_checkable
class SendsSyncs(Protocol):
    """A box whose next SYNCs are known."""

    def next_syncs(self, before_ns: int, most: int) -> list[tuple[int, bytes]]:
        """Times and data of the SYNCs after the last one sent, before ``before_ns``; none if that is not known."""


class WireFrame(NamedTuple):
    """A frame that has been on the wire, and when its last bit was there."""

    end_ns: int
    identifier: int
    data: bytes


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
    """Trains by the end of the SYNC that they answer.

    Args:
        bit_ns: Length of a bit.
    """

    def __init__(self, bit_ns: float) -> None:
        self._bit_ns = bit_ns
        self._trains: dict[int, Train] = {}
        self._tpdos: list[Tpdo] = []
        self._nodes: list[AnswersAhead] = []
        self._revisions: list[int] = []

    def take(self, sync_end_ns: int, nodes: Sequence[object], box: object, known_ns: int) -> Train | None:
        """The train that answers the SYNC that ends now; None where it is not known.

        Args:
            sync_end_ns: When.
            nodes: All on the wire.
            box: That of them that sent it.
            known_ns: Before when the plant is computed.
        """
        if self._trains and [node.revision for node in self._nodes] != self._revisions:
            self._trains = {}
        train = self._trains.pop(sync_end_ns, None)
        if train is None and sync_end_ns < known_ns:
            self._compute(sync_end_ns, nodes, box, known_ns)
            train = self._trains.pop(sync_end_ns, None)
        if train is not None:
            for tpdo in self._tpdos:
                tpdo.answered()
        return train

    def _compute(self, sync_end_ns: int, nodes: Sequence[object], box: object, known_ns: int) -> None:
        """Compute the trains of the SYNC that ends now and of those after it."""
        self._trains, self._nodes, self._tpdos = {}, [], []
        senders: list[tuple[Tpdo, int]] = []
        for place, node in enumerate(nodes):
            if node is box:
                continue
            if not isinstance(node, AnswersAhead) or (answers := node.answers()) is None:
                return
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
        ends_ns = [sync_end_ns]
        for start_ns, data in box.next_syncs(known_ns, _MOST_SYNCS):
            ends_ns.append(start_ns + round(frame_bits(0x080, data) * self._bit_ns))
        times_ns = np.array([end_ns for end_ns in ends_ns if end_ns < known_ns], np.int64)
        if len(times_ns) >= _FEWEST_SYNCS:
            self._fill(times_ns, senders)

    def _fill(self, times_ns: NDArray[np.int64], senders: list[tuple[Tpdo, int]]) -> None:
        gap_ns = round(INTERMISSION_BITS * self._bit_ns)
        begin_ns = times_ns + max(gap_ns, ANSWER_NS)
        columns: list[list[WireFrame]] = []
        begins: list[list[int]] = []
        for tpdo, _ in senders:
            contents = tpdo.samples(times_ns)
            identifier, size = tpdo.cob_id, contents.shape[1]
            end_ns = begin_ns + np.rint(frames_bits(identifier, contents) * self._bit_ns).astype(np.int64)
            whole = contents.tobytes()
            pieces = [whole[at : at + size] for at in range(0, len(whole), size)]
            columns.append(list(map(WireFrame, end_ns.tolist(), repeat(identifier), pieces)))
            begins.append(begin_ns.tolist())
            begin_ns = end_ns + gap_ns
        places = [place for _, place in senders]
        frames = zip(*columns, strict=True) if columns else repeat(())
        begin = zip(*begins, strict=True) if begins else repeat(())
        ready = (times_ns + ANSWER_NS).tolist()
        self._trains = {
            sync_end_ns: Train(ready_ns, of_sync, begins_ns, places)
            for sync_end_ns, ready_ns, of_sync, begins_ns in zip(times_ns.tolist(), ready, frames, begin, strict=False)
        }
