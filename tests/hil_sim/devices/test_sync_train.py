"""Answers to SYNCs that are computed ahead: the same frames at the same times as one by one, whatever comes between."""

import math

import numpy as np
import pytest

from hil_sim.devices.can_bus.frame_length import frame_bits, frames_bits
from hil_sim.devices.can_bus.object_dictionary import DataType
from hil_sim.devices.canopen.arm_controller import ArmController
from hil_sim.devices.canopen.drive402 import Drive402
from hil_sim.devices.canopen.encoder406 import Encoder406
from hil_sim.devices.canopen.loadcell404 import LoadCell404
from hil_sim.devices.canopen.measured_object import MeasuredObject
from hil_sim.devices.sync.sync_box import SyncBox
from hil_sim.faults import MEMORYLESS, NEVER, FaultPlan
from hil_sim.faults.vocabulary import Fault, FaultKind
from tests.hil_sim.devices.twin_bench import MS, START_NS, Analog, CanRig, RateClock

AHEAD_NS = 300 * MS
FAULTS = {  # and their values
    **dict.fromkeys([FaultKind.STUCK, FaultKind.SILENT, FaultKind.GARBAGE, FaultKind.OFF], 0.0),
    **dict.fromkeys([FaultKind.DELAYED, FaultKind.INTERMITTENT, FaultKind.WRONG, FaultKind.SLIPPED], 0.05),
    FaultKind.SATURATED: -1.0,
}


class Swing:
    """A scalar input that is asked one by one, or for many instants at once."""

    def __init__(self, scale):
        self.scale = scale

    def value(self, time_s):
        return self.scale * math.sin(3.0 * time_s)

    def values(self, times_s):
        return np.array([self.value(time_s) for time_s in times_s.tolist()])


class Counted(CanRig):
    """A rig whose plant is known ahead, in pieces, and which counts the trains."""

    def __init__(self, *nodes, ahead):
        super().__init__(*nodes)
        self.trains = self.rounds = self.cut = 0
        if not ahead:
            return
        self.wire.know_ahead(lambda: (self.now_ns // AHEAD_NS + 1) * AHEAD_NS)
        take, dissolve, run = self.wire.trains.take, self.wire.dissolve, self.wire.trains.run

        def counted(*arguments):
            train = take(*arguments)
            self.trains += train is not None
            return train

        def whole(*arguments):
            frames = run(*arguments)
            self.rounds += sum(frame.identifier == 0x080 for frame in frames)
            return frames

        def cut(until_ns):
            self.cut += 1
            dissolve(until_ns)

        self.wire.trains.take, self.wire.trains.run, self.wire.dissolve = counted, whole, cut


def rig(*, ahead, pins=None):
    box = SyncBox(RateClock(2e-5), START_NS)
    if pins is not None:
        box.connect_pin(lambda edge_ns, high_ns: pins.append((edge_ns, high_ns)))
    nodes = (
        box,
        Encoder406(1, Swing(2.0), START_NS, zero_count=7),
        LoadCell404(2, Swing(60.0), START_NS, flags_overload=True),
        Encoder406(3, Analog(lambda t: -0.3 * t), START_NS),
        Drive402(4, Swing(1.0), Swing(3.0), START_NS, commands=[(0.0, 6), (0.9, 7), (1.3, 15)], trips=[(2.2, 0x2310)]),
        ArmController(5, [(0.5 + 0.1551 * k, k) for k in range(20)], START_NS),
        MeasuredObject(6, 0x0002_0192, 0x606C_00_20, DataType.I32, Swing(40.0), START_NS, step=0.01),
    )
    made = Counted(*nodes, ahead=ahead)
    made.nodes = nodes[1:]
    return made


def flown(seed, *, ahead):
    """A rig driven at random: steps of the clock, SDO transfers, NMT commands, RPDOs; and its pulses."""
    rng, pins = np.random.default_rng(seed), []
    made = rig(ahead=ahead, pins=pins)
    made.run(80)
    for node in (1, 3):
        made.wire.send(0x600 + node, bytes.fromhex("23 00 18 01 81 01 00 80"), made.now_ns)  # the timer's TPDO off
        made.wire.send(0x600 + node, bytes.fromhex("2B 17 10 00 F4 01 00 00"), made.now_ns)  # heartbeat, 500 ms
        made.run(3)
    made.send(0x000, 1, 0)
    requests = (
        "40 04 60 00 00 00 00 00",
        "23 03 60 00 2A 00 00 00",
        "2F 01 18 02 02 00 00 00",
        "2F 01 18 02 01 00 00 00",
    )
    while made.now_ns < START_NS + 4_000 * MS:
        made.run(float(rng.choice([0.13, 0.9, 5.0, 20.0, 60.0])))
        match rng.integers(0, 12):
            case 0:
                made.wire.send(0x600 + int(rng.choice([1, 3])), bytes.fromhex(requests[rng.integers(4)]), made.now_ns)
            case 1:
                made.send(0x000, int(rng.choice([1, 1, 1, 2, 128])), int(rng.integers(0, 7)))
            case 2:
                made.send(0x204, int(rng.choice([6, 7, 15])), 0)
    return made, pins


@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(one, marks=pytest.mark.campaign) for one in (2, 3, 4, 5))]
)  # other frames between
def test_trains_are_what_the_wire_carries_frame_by_frame(seed):
    (ahead, ahead_pins), (plain, plain_pins) = flown(seed, ahead=True), flown(seed, ahead=False)
    assert ahead.trains > 20
    assert ahead.rounds > 20
    assert ahead.cut > 0
    assert len(plain.frames) > 1500
    assert ahead.frames == plain.frames
    assert ahead_pins == plain_pins
    assert [node.produced for node in ahead.nodes] == [node.produced for node in plain.nodes]
    assert ahead.wire.overwritten == plain.wire.overwritten


def test_a_frame_that_comes_between_contends_with_what_is_left_of_a_train():
    def order(*, ahead):
        made = rig(ahead=ahead)
        made.run(80)
        made.send(0x000, 1, 0)
        made.run(1000)
        while made.wire.advance(made.now_ns + 1) == []:  # to the end of the first frame of a train, a SYNC
            made.now_ns += 1000
        made.now_ns += 1
        made.run(0.1)  # into the second one
        made.send(0x010, 1)
        return made, made.run(3)

    (ahead, frames), (_, plain) = order(ahead=True), order(ahead=False)
    assert ahead.cut > 0
    assert len(frames) >= 4
    assert frames == plain


@pytest.mark.parametrize("kind", FAULTS)
def test_trains_before_in_and_after_a_fault_are_what_the_wire_carries_frame_by_frame(kind):
    def flight(*, ahead):
        faults = FaultPlan([Fault(kind, "n", 0.5, 0.9, FAULTS[kind])], START_NS).of("n")
        faulty = LoadCell404 if kind is FaultKind.SATURATED else Encoder406
        nodes = Encoder406(1, Swing(1.0), START_NS), faulty(9, Swing(1.0), START_NS, faults=faults)
        made = Counted(SyncBox(RateClock(), START_NS), *nodes, ahead=ahead)
        made.run(80)
        for node in (1, 9):
            made.wire.send(0x600 + node, bytes.fromhex("23 00 18 01 81 01 00 80"), made.now_ns)  # the timer's TPDO off
            made.run(3)
        made.send(0x000, 1, 0)
        counts = []
        for until_ms in (498, 890, 1500):
            before = made.trains + made.rounds
            made.run(until_ms - (made.now_ns - START_NS) / MS)
            counts.append(made.trains + made.rounds - before)
        return made, counts, [node.produced for node in nodes]

    (ahead, (before, during, after), made), (plain, _, expected) = flight(ahead=True), flight(ahead=False)
    assert min(before, after) > 50
    assert (during > 50) == (kind in MEMORYLESS)
    assert (ahead.frames, made) == (plain.frames, expected)


def test_no_train_beyond_what_is_known():
    swing = Swing(1.0)
    box, node = SyncBox(RateClock(), START_NS), Encoder406(1, swing, START_NS)
    made = CanRig(box, node)
    made.wire.know_ahead(lambda: START_NS + 400 * MS)
    asked = []
    values = swing.values
    swing.values = lambda times_s: (asked.extend(times_s.tolist()), values(times_s))[1]
    made.run(80)
    made.wire.send(0x601, bytes.fromhex("23 00 18 01 81 01 00 80"), made.now_ns)
    made.send(0x000, 1, 0)
    made.run(1000)
    assert 0.37 < max(asked) < 0.4
    assert node.produced > 190


def test_the_next_syncs_are_those_that_the_box_sends():
    box = SyncBox(RateClock(3e-5), START_NS)
    made = CanRig(box)
    made.run(52)
    told = box.next_syncs(START_NS + 1_500 * MS, 1000)
    assert box.next_syncs(START_NS + 1_500 * MS, 7) == told[:7]
    sent = [(frame.end_ns - 2000 * frame_bits(0x080, frame.data), frame.data) for frame in made.run(1_448.2)]
    assert len(sent) > 280
    assert told == sent
    assert (
        SyncBox(RateClock(), START_NS, faults=FaultPlan([Fault(FaultKind.OFF, "n", 1.0)], START_NS).of("n")).next_syncs(
            NEVER, 9
        )
        == []
    )


@pytest.mark.parametrize("size", range(9))
def test_lengths_of_many_frames_are_those_of_each(size, rng):
    for identifier in (0x000, 0x080, 0x181, 0x57F, 0x7FF):
        data = rng.integers(0, 256, (40, size), dtype=np.uint8)
        data[::4], data[1::4] = 0, 255
        assert frames_bits(identifier, data).tolist() == [frame_bits(identifier, row.tobytes()) for row in data]
