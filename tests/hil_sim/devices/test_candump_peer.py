"""The twins' CAN traffic as python-can records it for candump's users, and our driver on that record.

``tests/kernel/test_canopen.py`` has it from candump itself.
"""

import re

import can
import numpy as np
import pytest

from drivers.canopen_pdo import CanopenBus, Cia404Config, Cia406Config, SyncConfig
from drivers.transports import open_can
from hil_sim.buses.in_process import in_process
from tests.drivers import batches as rows_of
from tests.drivers.candump import decoded
from tests.hil_sim.devices.twin_bench import BUSES, MS, START_NS, SmallMission

NODES = (Cia406Config("joint_1", 1, 500_000), Cia404Config("load_cell", 2, 1000.0))
CHANNELS = ("can_sync", "joint_1", "load_cell")


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """A second and a half of the twins with our driver on them: its batches, and the log of a third on the bus."""
    folder = tmp_path_factory.mktemp("candump")
    mission, now = SmallMission(2.0), [START_NS]
    log = folder / "twins.log"
    with in_process(BUSES, folder, lambda: now[0], name="candump") as buses:
        mission.plug(buses.buses, START_NS)
        port = open_can(buses.urls["can_0"], lambda: now[0])
        bus = CanopenBus(port, NODES, SyncConfig())
        with (
            can.Bus("candump_can_0", interface="virtual", preserve_timestamps=True) as third,
            can.CanutilsLogWriter(log, channel="vcan0") as writer,
        ):
            batches = bus.start(now[0])
            for _ in range(1500):
                now[0] += MS
                mission.advance(now[0])
                batches += bus.pump(now[0])
                while (message := third.recv(0)) is not None:
                    message.channel = None  # the writer's
                    writer(message)
            # after stop nothing is recorded: what the nodes still say is heard by the driver alone
            batches += bus.stop(now[0])
        port.close()
    return batches, log


def test_the_log_is_in_candumps_format(flown):
    _, log = flown
    lines = log.read_text(encoding="ascii").splitlines()
    assert len(lines) > 800
    line = re.compile(r"\(\d+\.\d{6}\) vcan0 [0-7][0-9A-F]{2}#([0-9A-F]{2}){0,8} [RT]")
    assert [text for text in lines if not line.fullmatch(text)] == []


def test_our_driver_makes_the_same_rows_of_the_log_as_it_did_live(flown):
    live, log = flown
    again, port = decoded(log, NODES)
    assert port.sent[: len(port.theirs)] == port.theirs, "it asks the same, in the same order"
    assert len(port.theirs) > 20
    for channel in CHANNELS:
        one, two = rows_of.of(live, channel), rows_of.of(again, channel)
        assert len(one) > 200, channel
        for field in one.dtype.names:
            if field == "host_ns":
                assert np.abs(one[field] - two[field]).max() <= 500, "candump writes microseconds"
            else:
                np.testing.assert_array_equal(one[field], two[field], err_msg=f"{channel} {field}")
    assert rows_of.codes(again) == rows_of.codes(live)


def test_rows_are_those_that_the_frames_say(flown):
    """Past the driver: what the load cell and the encoder sent, taken out of the text by hand."""
    _, log = flown
    again, _ = decoded(log, NODES)
    text = log.read_text(encoding="ascii")
    for identifier, channel in (("281", "joint_1"), ("182", "load_cell")):
        data = [bytes.fromhex(found) for found in re.findall(rf" {identifier}#([0-9A-F]+)", text)]
        said = [int.from_bytes(raw[:4], "little", signed=channel == "load_cell") for raw in data]
        rows = rows_of.of(again, channel)
        assert rows["value_raw"].tolist() == said[-len(rows) :], channel
