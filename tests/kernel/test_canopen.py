"""CANopen nodes of the simulator on vcan0: the canopen package as a stranger, then our driver.

candump beside our driver on vcan0: ``can.LogReader`` reads what it recorded, and our driver makes the same of it.
"""

import itertools
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import can
import canopen
import numpy as np
import pytest

from drivers.canopen_pdo import CanopenBus, Cia404Config, Cia406Config, SyncConfig
from drivers.canopen_pdo.profiles.channel import NodeConfig
from drivers.records import Batch
from drivers.transports import open_can
from drivers.transports.can.can_reopen import ReopeningCanPort
from tests.drivers import batches as rows_of
from tests.drivers.candump import decoded
from tests.kernel.conftest import Served
from tests.kernel.devices import NEWTONS, TURN_PER_S

NODES: list[NodeConfig] = [
    Cia406Config("joint_1", node=1, counts_per_revolution=500_000),
    Cia404Config("load_cell", node=2, capacity_N=50.0),
]


def test_our_driver_makes_the_same_rows_of_a_candump_log_as_it_did_live(
    serve: Callable[..., Served], tmp_path: Path
) -> None:
    served = serve(nodes=True)
    time.sleep(max(0.0, 0.1 - served.age_s))  # the nodes are up after 50 ms
    log = tmp_path / "vcan0.log"
    port = open_can(served.urls["can_0"], time.monotonic_ns)
    with log.open("wb") as file, subprocess.Popen(["candump", "-L", "vcan0"], stdout=file) as dump:
        deadline = time.monotonic() + 5.0
        while not log.stat().st_size:  # it is there, and hears the SYNCs
            assert time.monotonic() < deadline
            time.sleep(0.01)
        port.receive(0.0)
        bus = CanopenBus(port, NODES, SyncConfig())
        live: list[Batch] = bus.start(time.monotonic_ns())
        end = time.monotonic() + 2.5
        while time.monotonic() < end:
            live += bus.pump(time.monotonic_ns(), 0.05)
        dump.terminate()
        dump.wait(5)
        live += bus.stop(time.monotonic_ns())
    port.close()

    again, recorded = decoded(log, NODES)
    assert recorded.sent[: len(recorded.theirs)] == recorded.theirs
    # The driver went on for longer than candump, and both began at some SYNC: what both have is compared by number.
    for channel in ("can_sync", "joint_1", "load_cell"):
        one, two = rows_of.of(live, channel), rows_of.of(again, channel)
        common = np.intersect1d(one["tick"], two["tick"])
        assert len(common) > 300, channel
        one, two = (rows[np.isin(rows["tick"], common)] for rows in (one, two))
        for field in one.dtype.names or ():
            if field not in {"host_ns", "sequence"}:
                np.testing.assert_array_equal(one[field], two[field], err_msg=f"{channel} {field}")
        assert (np.diff(one["sequence"]) == np.diff(two["sequence"])).all()
        # One kernel stamp, of two clocks: candump's is CLOCK_REALTIME in microseconds.
        offset_ns = one["host_ns"].astype(np.int64) - two["host_ns"].astype(np.int64)
        assert np.ptp(offset_ns) < 1_000_000, channel


COUNTS = 500_000
BOOT_S = 0.1  # the nodes are up 50 ms after power-up, and hear nothing before


@pytest.fixture
def nodes(serve: Callable[..., Served]) -> Served:
    served = serve(nodes=True)
    time.sleep(max(0.0, BOOT_S - served.age_s))
    return served


@pytest.fixture
def network(nodes: Served) -> Iterator[canopen.Network]:
    del nodes
    network = canopen.Network()
    network.connect(interface="socketcan", channel="vcan0")
    yield network
    network.disconnect()


def test_canopen_reads_identity_and_position_by_sdo(network: canopen.Network) -> None:
    encoder, cell = network.add_node(1).sdo, network.add_node(2).sdo
    assert encoder.upload(0x1000, 0)[:2] == b"\x96\x01"  # CiA 406
    assert cell.upload(0x1000, 0)[:2] == b"\x94\x01"  # CiA 404
    assert cell.upload(0x6131, 1) == b"\x00\x00\x21\x00"  # newton
    before = int.from_bytes(encoder.upload(0x6004, 0), "little")
    time.sleep(0.5)
    assert int.from_bytes(encoder.upload(0x6004, 0), "little") - before > 0.4 * COUNTS * TURN_PER_S
    with pytest.raises(canopen.SdoAbortedError) as caught:
        encoder.upload(0x5FFF, 0)
    assert caught.value.code == 0x0602_0000


def test_canopen_starts_the_nodes_and_hears_their_heartbeat(network: canopen.Network) -> None:
    node = network.add_node(1)
    node.sdo.download(0x1017, 0, (50).to_bytes(2, "little"))
    node.nmt.state = "OPERATIONAL"
    for _ in range(3):
        state = node.nmt.wait_for_heartbeat(2.0)
    assert state == "OPERATIONAL"


def test_python_can_receives_sync_and_the_answers_to_it(nodes: Served) -> None:
    del nodes
    with can.Bus("vcan0", interface="socketcan") as bus:
        bus.send(can.Message(arbitration_id=0x000, data=[1, 0], is_extended_id=False))
        started = time.monotonic()
        messages = []
        while time.monotonic() - started < 1.0:
            message = bus.recv(0.1)
            if message is not None:
                messages.append(message)
    syncs = [m.data[0] for m in messages if m.arbitration_id == 0x080]
    assert len(syncs) > 150
    assert all((b - a) % 240 == 1 for a, b in itertools.pairwise(syncs))
    forces = [m.data for m in messages if m.arbitration_id == 0x182]
    assert len(forces) > 150
    assert {int.from_bytes(data[:4], "little", signed=True) for data in forces} == {round(NEWTONS * 1e4)}


def test_our_driver_gets_every_sync_and_both_answers(nodes: Served) -> None:
    port = open_can(nodes.urls["can_0"], time.monotonic_ns)
    channels: list[NodeConfig] = [
        Cia406Config("joint_1", node=1, counts_per_revolution=COUNTS),
        Cia404Config("load_cell", node=2, capacity_N=50.0),
    ]
    bus = CanopenBus(port, channels, SyncConfig())
    batches: list[Batch] = bus.start(time.monotonic_ns())
    end = time.monotonic() + 3.0
    while time.monotonic() < end:
        batches += bus.pump(time.monotonic_ns(), 0.05)
    batches += bus.stop(time.monotonic_ns())
    assert isinstance(port, ReopeningCanPort)
    assert port.lost_frames == 0
    port.close()
    told = [row[["code", "text"]].item() for batch in batches if batch.channel == "event" for row in batch.rows]
    assert [code for code, *_ in told] == [b"started", b"started", b"stopped"], told
    assert not [batch for batch in batches if batch.channel == "gap"]
    syncs, joint, cell = (
        np.concatenate([batch.rows for batch in batches if batch.channel == channel])
        for channel in ("can_sync", "joint_1", "load_cell")
    )
    assert len(syncs) > 400
    assert (np.diff(syncs["tick"].astype(np.int64)) == 1).all()
    assert (np.diff(syncs["host_ns"]) > 0).all()
    for rows in (joint, cell):
        assert len(rows) > 300
        assert (np.diff(rows["tick"].astype(np.int64)) == 1).all()
    per_sync = COUNTS * TURN_PER_S * 0.005  # 25 counts
    assert (np.abs(np.diff(joint["value_raw"]) - per_sync) <= 1).all()
    assert set(np.rint(cell["value_raw"] * cell["scale"] * 1e4)) == {round(NEWTONS * 1e4)}
