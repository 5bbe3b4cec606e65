"""What drives are sent keeps every limit: random axes, motions and starts; calls that are late, SYNCs that are lost.

The drives are ideal: where the last target put them at a SYNC, they are. What is looked at is what they were
told at each SYNC, so that no property of a drive hides a step. A drive that gets no target stands: the stop is not the
player's; how it goes on from there is.
"""

from typing import NamedTuple

import hypothesis.strategies as st
import numpy as np
from hypothesis import example, given, settings

from drivers.canopen_pdo.play.drive_axis import Cia402AxisConfig, DriveAxis
from drivers.canopen_pdo.profiles.cia402 import MODE, POSITION, STATUS, Cia402Config
from drivers.canopen_pdo.sync import SyncCounter
from drivers.play.master import MasterState
from drivers.play.player import Player, PlayerConfig
from drivers.reporter import Reporter

PERIOD_NS = 5_000_000
PERIOD_S = 1e-9 * PERIOD_NS
ENABLED, CYCLIC = 0x27, 8


class Case(NamedTuple):
    """What is played, and what goes wrong."""

    seed: int
    axes: int
    away: float  # of what the limits leave: how far the arm stands from the start
    slow: float  # of an acceleration of 5 rad/s2
    late: tuple[tuple[int, int], ...]  # SYNCs after the start, and for how many no call comes
    lost: tuple[int, ...]  # SYNCs that the drives hear, and the player does not


class Wire:
    """A player, and ideal drives."""

    def __init__(self, case: Case) -> None:
        rng = np.random.default_rng(case.seed)
        n, axes, columns, stands = round(rng.uniform(0.3, 1.0) / PERIOD_S), [], [], []
        for node in range(1, case.axes + 1):
            per_rev = int(rng.choice([20_000, 1_048_576, 1 << 24]))
            per_rad, zero = per_rev / (2.0 * np.pi), int(rng.integers(-90_000, 90_000))
            rate, acceleration = rng.uniform(0.05, 1.5) * per_rad, 5.0 * case.slow * per_rad
            half = rng.uniform(0.2, 2.0) * per_rad
            motion = self.motion(rng, n, rate, acceleration, half)
            near = min(half - np.abs(motion).max(), 0.5 * per_rad)
            low, high = round(zero - half), round(zero + half)
            drive = Cia402Config(node, per_rev, position=f"axis_{node}", status=f"status_{node}")
            limits = {"rate": rate, "acceleration": acceleration, "quick_stop": acceleration}
            axes.append(
                Cia402AxisConfig(drive, "sent", low, high, following_error=per_rev, start_within=per_rev, **limits)
            )
            columns.append(np.round(zero + motion).astype(np.int64))
            stands.append(int(columns[-1][0] + case.away * rng.choice([-1, 1]) * max(near - 2.0, 0.0)))
        counts = np.stack(columns, 1)
        again = counts[-1] + np.round((counts - counts[0]) * 0.5).astype(np.int64)  # a segment from its end
        self.config = PlayerConfig(
            tuple(axes), np.arange(len(counts)), counts, sync_limit_ms=1000.0, segments={"again": again}
        )
        self.demand, self.told = np.array(stands), list(stands)
        self.held, self.heard = [self.demand.copy()], [True]  # demands at each SYNC, and whether a target came before
        self.came = True
        self.report = Reporter("can_0")
        self.sync = SyncCounter(PERIOD_NS)
        axes_of = [DriveAxis(axis, CYCLIC, self.sync, 100, self.send, self.report) for axis in axes]
        self.player = Player(self.config, axes_of, self.sync, self.report)
        self.now = 0

    @staticmethod
    def motion(rng, n, rate, acceleration, half):
        """From rest to rest, as fast as a limit allows."""
        u = np.linspace(0.0, 1.0, n)
        raw = np.sin(np.pi * u) ** 4 * sum(
            rng.standard_normal() * np.sin(f * np.pi * u + rng.uniform(0, 6)) for f in (1, 2, 4)
        )
        bend = np.abs(np.diff(raw, 2, prepend=[0, 0], append=[0, 0])).max() / PERIOD_S**2
        return raw * min(
            rate * PERIOD_S / np.abs(np.diff(raw)).max(), acceleration / bend, 0.9 * half / np.abs(raw).max()
        )

    def send(self, cob_id, data):
        if 0x300 < cob_id <= 0x37F:
            self.told[cob_id - 0x301] = int.from_bytes(data, "little", signed=True)
            self.came = True

    def tick(self, called=True, heard=True):
        """One SYNC: demands take effect, drives answer, and the player is called in time, or not."""
        self.now += 1
        at_ns = self.now * PERIOD_NS
        self.demand = np.array(self.told)
        came, self.came = self.came, False
        if heard:
            self.sync.advance((self.now - 1) % 240 + 1, at_ns)
        self.held.append(self.demand.copy())
        self.heard.append(came)
        for axis, counts in zip(self.player.axes, self.demand.tolist(), strict=True):
            words = {POSITION: counts.to_bytes(4, "little", signed=True), STATUS: ENABLED.to_bytes(2, "little")}
            words[MODE] = bytes([CYCLIC])
            for cob_id, entries in axis.places.items():
                data = bytearray(8)
                for entry, place in entries:
                    data[place.start : place.start + place.size] = words[entry]
                axis.on_tpdo(cob_id, at_ns, bytes(data[: entries[0][1].length]))
        if called and heard:
            self.player.step(at_ns + 1_000_000)


def played(case: Case) -> Wire:
    wire = Wire(case)
    for axis in wire.player.axes:
        axis.started()
    wire.tick(called=False)
    wire.player.arm()
    late = {start + k for start, count in case.late for k in range(count)}
    for k in range(6000):
        wire.tick(k not in late, k not in case.lost)
        if wire.player.state is MasterState.HOLDING:
            break
        assert wire.player.state is not MasterState.STOPPED, wire.player.stopped_by
    assert wire.player.state is MasterState.HOLDING
    wire.player.request("again")
    for k in range(6000):
        wire.tick(k not in late, k not in case.lost)
        if wire.player.state is MasterState.HOLDING:
            break
    for _ in range(3):
        wire.tick()
    return wire


CASES = st.builds(
    Case,
    st.integers(0, 2**32 - 1),
    st.integers(1, 3),
    st.sampled_from([0.0, 0.3, 1.0]),
    st.sampled_from([0.02, 0.2, 1.0, 4.0]),
    st.lists(st.tuples(st.integers(2, 500), st.integers(1, 12)), max_size=3).map(tuple),
    st.lists(st.integers(2, 500), max_size=3).map(tuple),
)


@example(Case(1, 2, 1.0, 0.1, (), ()))  # a blend that its limits make long
@example(Case(2, 2, 0.0, 1.0, ((230, 8),), ()))  # late in mid-motion
@settings(max_examples=12)
@given(CASES)
def test_no_target_leaves_a_limit(case):
    wire = played(case)
    demands, came = np.array(wire.held, np.float64), np.array(wire.heard)
    steps = np.diff(demands, axis=0)
    bends = np.diff(steps, axis=0)
    stood = ~came[2:] | (steps[1:] == 0.0).all(axis=1)  # no target came for this SYNC: it stops there
    for k, axis in enumerate(wire.config.axes):  # rows are whole counts, and targets between two of them are again
        assert axis.low <= demands[:, k].min()
        assert demands[:, k].max() <= axis.high
        assert np.abs(steps[:, k]).max() <= axis.rate * PERIOD_S + 2.0
        assert np.abs(bends[~stood, k]).max(initial=0.0) <= axis.acceleration * PERIOD_S**2 + 4.0
        assert demands[-1, k] == wire.config.segments["again"][-1, k]
    assert (np.ptp(demands, axis=0) >= 0.98 * np.ptp(wire.config.counts, axis=0) - 2.0).all()  # all of it is played
