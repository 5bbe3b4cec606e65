"""SYNCs whose answers are decoded as arrays give the rows, gaps and events that the same frames give one by one."""

import numpy as np
import pytest

from drivers.canopen_pdo import CanopenBus, Cia402Config, SyncConfig, rounds
from tests.drivers.batches import of
from tests.drivers.can_peers import MS, ArmController, Bench, Drive, Encoder, LoadCell, u8
from tests.drivers.three_nodes import CELL, JOINT, PHASE

DRIVE = Cia402Config(4, 500_000, position="joint_2", velocity="joint_2_rate", torque="joint_2_torque")
CHANNELS = ("can_sync", "joint_1", "load_cell", "joint_2", "joint_2_rate", "joint_2_torque", "arm_phase")
SYNCHRONOUS = (0x281, 0x182, 0x184, 0x284)
MS_A_PUMP = 110  # 22 SYNCs


class Rare:
    """Pumps a bus every 110 ms once its nodes have been set up."""

    def __init__(self, bus: CanopenBus) -> None:
        self.bus, self.start, self.stop = bus, bus.start, bus.stop

    def pump(self, now_ns):
        return self.bus.pump(now_ns) if now_ns // MS < 1_700 or now_ns // MS % MS_A_PUMP < 10 else []


def flown(clock, seed, monkeypatch, *, fewest):
    """A bus that loses frames, whose nodes reboot and send what is no TPDO; its bench, and SYNCs taken as rounds."""
    taken = []
    take = rounds.Rounds.take

    def counted(self, frames, first):
        count = take(self, frames, first)
        taken.append(sum(frame.identifier == 0x080 for frame in frames[first : first + count]))
        return count

    with monkeypatch.context() as patch:
        patch.setattr(rounds, "FEWEST", fewest)
        patch.setattr(rounds.Rounds, "take", counted)
        rng = np.random.default_rng(seed)
        nodes = Encoder(offset=2**32 - 900), LoadCell(), ArmController(), Drive()
        bench = Bench(clock, lambda port: Rare(CanopenBus(port, [JOINT, CELL, PHASE, DRIVE], SyncConfig())), *nodes)
        lost = {(int(number), int(rng.choice([0x080, *SYNCHRONOUS]))) for number in rng.integers(250, 3_000, 60)}
        bench.start()
        bench.run(1_100)
        bench.drop = lambda number, identifier: (number, identifier) in lost
        for _ in range(60):
            bench.run(int(rng.integers(40, 400)))
            match rng.integers(0, 7):
                case 0:
                    bench.put([bench.nodes[3].change(int(rng.integers(0, 9)))])
                case 1:
                    bench.put([(int(rng.choice(SYNCHRONOUS)), bytes(8))])
                case 2:
                    bench.put([(0x281, bytes(3))])
                case 3:
                    bench.put([(0x082, bytes.fromhex("10 81 11 00 00 00 00 00"))])
                case 4:
                    bench.put([(0x080, u8(int(rng.integers(0, 241))))])
                case 5:
                    bench.put([(0x702, b"\0")])
                case 6:
                    bench.port.put(clock(), 0x080, bytes(8), is_error=True)
        bench.stop()
    return bench, sum(taken)


def whole_bytes(batches, channel):
    """All rows of a channel, padding included."""
    return b"".join(batch.rows.tobytes() for batch in batches if batch.channel == channel)


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(one, marks=pytest.mark.campaign) for one in (1, 2, 3))]
)  # other frames that are lost
def test_rounds_say_what_their_frames_say_one_by_one(clock, monkeypatch, seed):
    many, taken = flown(type(clock)(), seed, monkeypatch, fewest=rounds.FEWEST)
    single, none = flown(type(clock)(), seed, monkeypatch, fewest=10**9)
    assert taken > 500
    assert none == 0
    assert len(of(many.batches, "gap")) > 10
    for channel in (*CHANNELS, "gap", "event"):
        rows = whole_bytes(many.batches, channel)
        assert rows
        assert rows == whole_bytes(single.batches, channel), channel
