"""One CAN bus of CANopen nodes as one device: routes frames to nodes, numbers SYNCs, returns rows once per pump."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial

from drivers.canopen_pdo import frame
from drivers.canopen_pdo.bus_port import DRAIN_S, DRAINS, BusPort
from drivers.canopen_pdo.guarding import Guard, GuardConfig
from drivers.canopen_pdo.node import Node
from drivers.canopen_pdo.play.torque_master import Play, master_of
from drivers.canopen_pdo.profiles.channel import NodeConfig, PdoChannel
from drivers.canopen_pdo.profiles.event_channel import EventChannel
from drivers.canopen_pdo.profiles.mapped_object import MappedObject
from drivers.canopen_pdo.profiles.sync_channel import SyncChannel
from drivers.canopen_pdo.rounds import Rounds, cut_at_stalls
from drivers.canopen_pdo.sync import SyncConfig, SyncCounter
from drivers.canopen_pdo.sync_rows import SyncRows
from drivers.device import COALESCED_NS
from drivers.errors import ConfigurationError, FrameError
from drivers.ports import CanFrame, CanPort
from drivers.records import Batch, Severity
from drivers.reporter import Reporter

OVERDUE = 2.5  # SYNC periods without SYNC after which held TPDOs become rows
STALLED = 100.0  # SYNC periods without SYNC after which all waiting frames are read before numbering
MOST_RECEIVES = 64
SYNC_LIMIT_NS = 1_000_000_000
STOOD_NS = 500_000_000  # between two pumps: the process stood still (SIGSTOP), or got no CPU
PLAYING_S = 0.005  # longest wait for a frame while drives are driven
REST_S, RESTS, SILENT_RESTS = 0.01, 150, 3  # receives in ``stop``, until the drives have stopped
LONGEST_REST_NS = 100_000_000  # a tenth of the heartbeats' limit, and a fifth of the time between two checks


class CanopenBus:
    """All CANopen nodes of one CAN bus, and its SYNC.

    Args:
        port: The bus.
        nodes: What is on it; several entries may share a node.
        sync: The SYNC producer.
        name: Source of the events of the bus itself.
        guards: How nodes without heartbeat are watched.
        play: What its drives are driven by, if they are: a motion, or a law of torques.

    Attributes:
        unclaimed: Frames with a COB-ID of no configured node or channel.
        player: Of ``play``; None without.

    Raises:
        ConfigurationError: Duplicate channel name, node number outside 1..127, guard of a node without a channel, or
            guard on a port that sends no remote frames.
    """

    def __init__(
        self,
        port: CanPort,
        nodes: Sequence[NodeConfig],
        sync: SyncConfig,
        name: str = "canopen",
        guards: Sequence[GuardConfig] = (),
        play: Play | None = None,
    ) -> None:
        self.name, self.unclaimed = name, 0
        self._report = Reporter(name)
        self._port = BusPort(port, self._report)
        self._period_ns = sync.period_ns
        self._sync = SyncCounter(sync.period_ns)
        self._sync_rows = SyncRows(sync, self._report)
        self._sync_sent_ns: int | None = None
        self._sync_missed = False
        self._bad_syncs = 0  # since the last one that could be read
        self._pumped_ns: int | None = None
        self._started_ns = self._stood_from_ns = self._stood_to_ns = 0  # stood: the last time that nobody pumped
        self._channels: list[PdoChannel] = []
        self._synchronous: list[SyncChannel] = []
        values = [data for config in nodes for data in config.process_data()]
        names = [sync.name, *(data.name for data in values)]
        if len(set(names)) < len(names):
            raise ConfigurationError(
                f"bus {name} has two channels of the same name ({', '.join(sorted(names))}): rename either"
            )
        by_node: dict[int, list[PdoChannel]] = {}
        for data in values:
            if not 1 <= data.node <= 127:
                raise ConfigurationError(f"{data.name}: node = {data.node}: CANopen has 1..127")
            channel: PdoChannel
            if isinstance(data, MappedObject) and not data.synchronous:
                channel = EventChannel(data, self._report, self._sync)
            else:
                channel = SyncChannel(data, self._report, self._sync)
                self._synchronous.append(channel)
            self._channels.append(channel)
            by_node.setdefault(data.node, []).append(channel)
        guarding = self._guards(guards, by_node)
        send, report = self._port.send, self._report
        self.player = None if play is None else master_of(play, self._sync, send, report)
        self._axes = () if self.player is None else self.player.axes
        self._nodes = []
        for number, channels in by_node.items():
            axis = next((axis for axis in self._axes if axis.node == number), None)
            by = send if axis is None else axis.send
            self._nodes.append(Node(number, channels, by, report, guarding.get(number), axis))
        self._handlers = self._routes()
        self._rounds = Rounds(self._synchronous, self._nodes, self._sync, self._sync_rows)
        others = {channel.data.cob_id for channel in self._channels if isinstance(channel, EventChannel)}
        self._may_round = self.player is None and others.isdisjoint(each.data.cob_id for each in self._synchronous)

    @property
    def period_ns(self) -> int:
        """Time between two pumps, ns; 0: ``pump`` waits on the port. Non-zero only while the port fails."""
        return self._port.period_ns

    @property
    def coalesces_ns(self) -> int:
        """See ``drivers.device.Coalesces``: nothing while a drive is driven, a node is asked or the port fails."""
        busy = self._plays or self._port.period_ns > 0 or any(node.asks for node in self._nodes)
        return 0 if busy else COALESCED_NS

    @property
    def _plays(self) -> bool:
        return self.player is not None and self.player.is_active

    def start(self, now_ns: int) -> list[Batch]:
        """Begin the set-up of all nodes in parallel. See ``drivers.device.Device``."""
        self._port.now_ns = self._started_ns = now_ns
        self._port.start()
        if self.player is not None:
            self.player.set_time(now_ns)
        for node in self._nodes:
            node.begin(now_ns)
        return self._report.take()

    def pump(self, now_ns: int, timeout_s: float = 0.0) -> list[Batch]:
        """Receive the waiting frames and return their batches; waits up to ``timeout_s`` for the first frame.

        Where it may wait and no node is asked anything, the frames of 50 ms are taken at once: a pump costs much more
        than a frame.
        """
        self._port.now_ns = now_ns
        if self._pumped_ns is not None:
            self._note_standstill(self._pumped_ns, now_ns)
        self._pumped_ns = now_ns
        timeout_s = min(timeout_s, PLAYING_S) if self._plays else timeout_s
        frames = self._port.receive(timeout_s)
        if frames and timeout_s > 0.0 and (coalesced_ns := self.coalesces_ns):
            frames += self._port.gather(1e-9 * coalesced_ns)
        awaited_ns = now_ns + round(timeout_s * 1e9)
        if self.player is not None:
            self.player.set_time(max(now_ns, frames[0].host_ns) if frames else awaited_ns)
        parts = cut_at_stalls(frames, STALLED * self._period_ns) if frames else []
        for part in parts:  # it may also have stood still within the read
            self._note_standstill(awaited_ns, part[-1].host_ns)
            awaited_ns = part[-1].host_ns
            self._pumped_ns = max(now_ns, awaited_ns)
            self._dispatch(self._whole(part, all_read=part is not parts[-1]))
        for node in self._nodes:
            node.poll(now_ns)
        if self.player is not None:
            self.player.step(max(now_ns, awaited_ns))
        self._watch_sync(now_ns)
        return self._handed_over()

    def rests_until(self, now_ns: int) -> int:
        """See ``drivers.device.Rests``. An event that comes meanwhile is read back so much later at most."""
        busy = self.player is not None or self._sync_missed or self._sync.tick is None
        busy = busy or self._port.period_ns > 0 or self._sync.silence(now_ns) > OVERDUE
        return now_ns if busy else min([now_ns + LONGEST_REST_NS, *(node.rests_until(now_ns) for node in self._nodes)])

    def _note_standstill(self, from_ns: int, to_ns: int) -> None:
        if to_ns - from_ns > STOOD_NS:
            self._stood_from_ns, self._stood_to_ns = from_ns, to_ns
            text = f"not read for {1e-9 * (to_ns - from_ns):.1f} s: the process stood still"
            self._report.event(to_ns, Severity.WARNING, "not_read", text)

    def stop(self, now_ns: int) -> list[Batch]:
        """Stop the nodes, read the remaining frames, record unanswered SYNCs as gaps."""
        self._port.now_ns = now_ns
        self._dispatch(self._receive(0.0))
        self._stop_drives(now_ns)
        self._read_past_a_sync()
        for node in self._nodes:
            node.stop()
        self._dispatch(self._receive(0.0))
        last = self._sync.tick  # up to here a node that was not stopped yet had to answer, and may have been cut off
        for _ in range(DRAINS):  # a busy node stops late, and answers meanwhile
            if not self._read_past_a_sync() or all(channel.is_silent for channel in self._synchronous):
                break
        self._port.mute()
        for _ in range(DRAINS):
            if not (frames := self._receive(DRAIN_S)):
                break
            self._dispatch(frames)
        last = self._lost_at_the_end(now_ns, last)
        for channel in self._synchronous:
            channel.finish(now_ns, last)
        for each in self._channels:
            if isinstance(each, EventChannel):
                each.finish(now_ns)
            each.live = False
        if self.player is not None:
            self.player.hand_over()
        text = f"stopped after {self._sync_rows.count} SYNCs, {self.unclaimed} unclaimed frames"
        self._report.event(now_ns, Severity.INFO, "stopped", text)
        self._report.flush(now_ns)
        return self._handed_over()

    def _read_past_a_sync(self) -> bool:
        """Read on to the next SYNC and its answers: a node that is stopped between them loses a sample unseen.

        It may be some periods late. Returns whether it came. A channel that did not answer the one before is not
        waited for.
        """
        before, silent = self._sync.tick, 0
        for _ in range(RESTS):
            self._dispatch(frames := self._receive(2e-9 * self._period_ns))
            silent = 0 if frames else silent + 1
            there = self._sync.tick != before and not any(channel.is_awaited for channel in self._synchronous)
            if there or silent > SILENT_RESTS:
                break
        return self._sync.tick != before

    def _stop_drives(self, now_ns: int) -> None:
        """Quick stop, and its frames read until the drives have left the enabled state."""
        if self.player is None:
            return
        self.player.step(now_ns)
        self.player.stop("the flight ends")
        self.player.step(now_ns)
        silent, rests = 0, 0
        while self.player.is_moving and silent <= SILENT_RESTS and rests < RESTS:
            frames = self._receive(REST_S)
            silent, rests = 0 if frames else silent + 1, rests + 1
            self._dispatch(frames)
            self.player.step(max(now_ns, frames[-1].host_ns) if frames else now_ns)

    def _guards(self, configs: Sequence[GuardConfig], nodes: Mapping[int, object]) -> dict[int, Guard]:
        guards = {}
        for config in configs:
            if config.node not in nodes:
                raise ConfigurationError(f"bus {self.name} guards node {config.node} and has no channel of it: drop it")
            if not self._port.can_request:
                raise ConfigurationError(f"bus {self.name}: its port sends no remote frames: use heartbeats")
            guards[config.node] = Guard(config, partial(self._port.request, frame.HEARTBEAT + config.node))
        return guards

    # Frames

    def _routes(self) -> dict[int, tuple[Callable[[int, bytes], None], ...]]:
        routes: dict[int, tuple[Callable[[int, bytes], None], ...]] = {frame.SYNC: (self._on_sync,)}
        for node in self._nodes:
            routes[frame.EMERGENCY + node.number] = (node.on_emergency,)
            routes[frame.SDO_REPLY + node.number] = (node.on_sdo,)
            routes[frame.HEARTBEAT + node.number] = (node.on_heartbeat,)
        for channel in self._channels:
            cob_id = channel.data.cob_id
            routes[cob_id] = (*routes.get(cob_id, ()), channel.accept)
        for axis in self._axes:
            for cob_id, route in axis.routes():
                routes[cob_id] = (*routes.get(cob_id, ()), route)
        return routes

    def _dispatch(self, frames: list[CanFrame]) -> None:
        at = 0
        if self._may_round and self._rounds.pay(len(frames)):
            frames = self._rounds.without_beats(frames)
            for place, (host_ns, identifier, _, is_error) in enumerate(frames):
                if place >= at and identifier == frame.SYNC and not is_error and self._rounds.pay(len(frames) - place):
                    self._each(frames[at:place])
                    at = place + (self._rounds.take(frames, place) if self._is_even(host_ns) else 0)
        self._each(frames[at:])

    def _each(self, frames: list[CanFrame]) -> None:
        handlers = self._handlers
        for host_ns, identifier, data, is_error in frames:
            if is_error:
                self._port.report_error_frame(host_ns, identifier, data)
                continue
            routes = handlers.get(identifier, ())
            self.unclaimed += not routes
            for route in routes:
                route(host_ns, data)

    def _is_even(self, host_ns: int) -> bool:
        """Whether no event and no correction of the SYNCs before is pending."""
        is_told = not (self._sync_missed or self._bad_syncs) and self._sync_sent_ns is None
        return is_told and host_ns >= self._stood_to_ns + STOOD_NS

    def _on_sync(self, host_ns: int, data: bytes) -> None:
        try:
            counter = frame.decode_sync(data)
        except FrameError as error:
            self._report.event(host_ns, Severity.WARNING, "bad_sync", str(error))
            self._bad_syncs += 1
            return
        if counter == 0:
            text = "SYNC carries no counter, losses are counted by arrival time only: write 240 to its 1019h"
            self._report.event(host_ns, Severity.WARNING, "sync_uncounted", text)
        before_tick, before_ns = self._sync.tick, self._sync.host_ns
        stood = self._stood_from_ns <= host_ns < self._stood_to_ns + STOOD_NS  # it may lack what the bus did carry
        silence = self._sync.silence(host_ns)
        tick, lost, restarted = self._sync.advance(counter, host_ns, self._sync_sent_ns, stood)
        self._sync_sent_ns = None
        if before_tick is None and tick * self._period_ns <= host_ns - self._started_ns:
            lost = tick  # as its counter says, the producer began after us: these were for us
        if restarted:  # as many as time allows, of which those that could not be read are known
            lost = max(round(silence) - 1, self._bad_syncs)
        self._bad_syncs = 0
        if self._sync_missed:
            self._sync_missed = False
            self._report.event(host_ns, Severity.INFO, "sync_recovered", f"SYNC received again, number {tick}")
        if self._sync.pause_ns and not stood:
            pause_ms = self._sync.pause_ns // 1_000_000
            text = f"SYNC paused for {pause_ms} ms, none is missing: its producer paused, or frames were delayed"
            self._report.event(host_ns, Severity.WARNING, "sync_paused", text)
        if before_tick is not None:
            next_tick = before_tick + 1 if restarted else tick
            for channel in self._synchronous:
                channel.close(before_tick, before_ns, next_tick)
        if restarted and before_tick is not None:
            why = "frames were lost while the process stood still" if stood else "its producer restarted"
            text = f"SYNC counter {counter} does not continue number {before_tick}: {why}"
            self._report.event(host_ns, Severity.ERROR, "sync_restarted", text)
            for channel in self._synchronous:
                channel.sync_restarted(host_ns, before_tick + lost, tick)
        self._sync_rows.lose(host_ns, lost, "not_read" if stood else "no_sync")
        self._sync_rows.add(host_ns, tick, counter)

    def _lost_at_the_end(self, now_ns: int, last: int | None) -> int | None:
        """Number of the run's last SYNC; those that should have come after ``last``, the last one seen, are a gap."""
        lost = int(self._sync.silence(now_ns) - 0.5)
        if last is None or lost < OVERDUE:
            return last
        self._sync_rows.lose(now_ns, lost)
        return last + lost

    def _watch_sync(self, now_ns: int) -> None:
        if self._sync.silence(now_ns) > OVERDUE:
            for channel in self._synchronous:
                channel.settle()
        heard_ns = max(self._started_ns if self._sync.tick is None else self._sync.host_ns, self._stood_to_ns)
        if not self._sync_missed and now_ns - heard_ns > SYNC_LIMIT_NS:
            self._sync_missed = True
            text = f"no SYNC for {(now_ns - heard_ns) // 1_000_000} ms: check its producer"
            self._report.event(now_ns, Severity.ERROR, "sync_lost", text)

    def _receive(self, timeout_s: float) -> list[CanFrame]:
        frames = self._port.receive(timeout_s)
        return self._whole(frames) if frames else []

    def _whole(self, frames: list[CanFrame], *, all_read: bool = False) -> list[CanFrame]:
        """Frames just read; after a long silence all that wait, to decide whether SYNCs were lost or only read late.

        A port that stamps at the read (slcan) gives queued frames the stamp of the end of the stall, which looks like a
        loss. Of n SYNCs in the queue the first was sent at the latest n - 1 periods before the last one arrived.
        """
        if self._sync.silence(frames[-1].host_ns) <= STALLED:
            return frames
        for _ in range(0 if all_read else MOST_RECEIVES):
            if not (more := self._port.receive(0.0)):
                break
            frames += more
        syncs = [host_ns for host_ns, identifier, _, is_error in frames if identifier == frame.SYNC and not is_error]
        if syncs:
            self._sync_sent_ns = min(syncs[0], syncs[-1] - (len(syncs) - 1) * self._period_ns)
        return frames

    def _handed_over(self) -> list[Batch]:
        self._sync_rows.hand_over()
        for channel in self._channels:
            channel.hand_over()
        return self._report.take()
