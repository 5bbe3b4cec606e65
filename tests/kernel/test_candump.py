"""candump beside our driver on vcan0: ``can.LogReader`` reads what it recorded, and our driver makes the same of it."""

import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from drivers.canopen_pdo import CanopenBus, Cia404Config, Cia406Config, SyncConfig
from drivers.canopen_pdo.profiles.channel import NodeConfig
from drivers.records import Batch
from drivers.transports import open_can
from tests.drivers import batches as rows_of
from tests.drivers.candump import decoded
from tests.kernel.conftest import Served

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
