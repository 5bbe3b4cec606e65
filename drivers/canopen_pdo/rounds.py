"""SYNCs that every node answers once are taken together: the answers of a channel are decoded as an array.

A round is a SYNC and one TPDO of each synchronous channel. Where rounds follow each other with nothing between them,
their rows are those that the same frames give one by one. Whatever is not so (a lost SYNC or answer, a node that is set
up, an emergency, an answer too many) is left to the bus, which goes on frame by frame.
"""

from collections.abc import Sequence

from drivers.canopen_pdo.frame import HEARTBEAT, SYNC
from drivers.canopen_pdo.node import Node
from drivers.canopen_pdo.profiles.sync_channel import SyncChannel
from drivers.canopen_pdo.sync import SyncCounter
from drivers.canopen_pdo.sync_rows import SyncRows
from drivers.ports import CanFrame

FEWEST = 8  # SYNCs: for fewer an array costs more than it saves


class Rounds:
    """The synchronous channels of a bus, by rounds.

    Args:
        channels: Those of the bus.
        nodes: What is on it.
        sync: Numbers its SYNCs.
        rows: Where SYNCs go.
    """

    def __init__(
        self, channels: Sequence[SyncChannel], nodes: Sequence[Node], sync: SyncCounter, rows: SyncRows
    ) -> None:
        self._alive = {HEARTBEAT + node.number: node for node in nodes}
        self._sync = sync
        self._rows = rows
        self._channels: dict[int, list[SyncChannel]] = {}  # by COB-ID
        for channel in channels:
            self._channels.setdefault(channel.data.cob_id, []).append(channel)

    def pay(self, count: int) -> bool:
        """Whether so many frames may have rounds enough."""
        return count > (FEWEST - 1) * (1 + len(self._channels))

    def without_beats(self, frames: list[CanFrame]) -> list[CanFrame]:
        """Frames without heartbeats of nodes that go on as they did: when one was heard hangs on no other frame."""
        rest = []
        for each in frames:
            host_ns, identifier, data, is_error = each
            node = self._alive.get(identifier)
            if node is not None and not is_error and node.only_lives(data):
                node.on_heartbeat(host_ns, data)
            else:
                rest.append(each)
        return rest

    def take(self, frames: Sequence[CanFrame], first: int) -> int:
        """Take the rounds that begin with the SYNC at ``first``.

        Returns:
            How many frames were taken: up to the SYNC of the last round, whose answers are still to come; 0 where
            they are to be taken one by one.
        """
        size, tick, sync_ns = 1 + len(self._channels), self._sync.tick, self._sync.host_ns
        if size == 1 or tick is None:
            return 0
        if not all(channel.awaits_sync(tick) for each in self._channels.values() for channel in each):
            return 0
        identifiers = [-1 if frame.is_error else frame.identifier for frame in frames[first:]]
        pattern = identifiers[:size]
        if sorted(pattern[1:]) != sorted(self._channels):
            return 0
        rounds = len(identifiers) // size
        if identifiers[: rounds * size] != pattern * rounds:
            rounds = next(at for at in range(rounds) if identifiers[at * size : (at + 1) * size] != pattern)
        syncs = frames[first : first + rounds * size + 1 : size]
        if syncs[-1].identifier != SYNC:
            syncs = syncs[:-1]
        numbered = self._sync.advance_evenly([(sync.host_ns, sync.data) for sync in syncs], FEWEST)
        if not numbered:
            return 0
        last = first + (numbered - 1) * size
        syncs_ns = [sync_ns, *(sync.host_ns for sync in syncs[:numbered])]
        for place, identifier in enumerate(pattern[1:], first + 1):
            for channel in self._channels[identifier]:
                channel.close_rounds(tick, syncs_ns, frames[place:last:size])
        self._rows.add_rounds(syncs_ns[1:], tick + 1, [sync.data[0] for sync in syncs[:numbered]])
        return last + 1 - first


def cut_at_stalls(frames: list[CanFrame], stalled_ns: float) -> list[list[CanFrame]]:
    """Frames cut where a long silence lies between two of them."""
    cuts = [0]
    if frames[-1].host_ns - frames[0].host_ns > stalled_ns:
        cuts += [at for at in range(1, len(frames)) if frames[at].host_ns - frames[at - 1].host_ns > stalled_ns]
    return [frames[first:last] for first, last in zip(cuts, [*cuts[1:], len(frames)], strict=True)]
