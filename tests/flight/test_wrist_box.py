"""The driver of a wrist sensor and the simulated box: a pulled cable, no supply; every record is accounted for."""

import numpy as np
import pytest

from drivers.net_ft import NetFt, NetFtChannel, NetFtConfig
from drivers.records import SampleStatus
from drivers.transports.network import UdpPort
from hil_sim.buses.network import NetworkBus
from hil_sim.buses.udp_ends import UdpEnd
from hil_sim.devices.network.net_box import NetBox
from hil_sim.faults import Fault, FaultPlan
from tests.conftest import VirtualClock
from tests.drivers.batches import codes, of, whole
from tests.hil_sim.devices.twin_bench import RateClock

MS = 1_000_000
CASES = {  # fault, seconds of the flight, events in their order, rows after a reset, records that may be miscounted
    "a short pull": (("unplug", "cable", 1.0, 1.4), 3, ["started", "stopped"], 0, 0),
    "a long pull": (("unplug", "cable", 1.0, 4.0), 6, ["started", "silent", "bus_recovered", "stopped"], 1, 2),
    "no supply": (("off", "box", 1.0, 1.2), 5, ["started", "silent", "bus_recovered", "restarted", "stopped"], 1, 2),
}


@pytest.mark.parametrize(("fault", "seconds", "events", "resets", "most"), CASES.values(), ids=CASES)
def test_it_comes_back_and_every_record_is_accounted_for(fault, seconds, events, resets, most):
    clock, end = VirtualClock(), UdpEnd("wrist-box")
    plan = FaultPlan([Fault(*fault)], clock())
    bus, rate = NetworkBus(end), 200.0
    box = NetBox(
        {2: lambda t: (1e6 * t, False)}, RateClock(start_ns=clock()), clock(), rate_hz=rate, faults=plan.of("box")
    )
    bus.add(box)
    bus.inject(plan.of("cable"))
    fz = NetFtChannel("fz", 2, 1e-6, "N")
    driver = NetFt("wrist", [fz], lambda: UdpPort.open("udp://wrist-box:49152"), clock, NetFtConfig(rate))
    try:
        batches = driver.start(clock())
        for _ in range(1000 * seconds):
            clock.advance(MS)
            bus.advance(clock())
            batches += driver.pump(clock())
        batches += driver.stop(clock())
    finally:
        end.close()
    rows = whole(batches, "fz")
    assert sorted(codes(batches), key=events.index) == events
    assert np.count_nonzero(rows["status"] & SampleStatus.AFTER_RESET) == resets
    assert abs(int(rows["sequence"][-1]) + 1 - round(rate * seconds)) <= most + 1  # one before the first request
    numbers = rows["sequence"] / rate
    assert rows["value_raw"] * rows["scale"] - numbers == pytest.approx(1.0 / rate, abs=(most + 1) / rate)
    lost = sum(int(gap["last_missing"] - gap["first_missing"]) + 1 for gap in of(batches, "gap"))
    assert len(rows) + lost == int(rows["sequence"][-1]) + 1
