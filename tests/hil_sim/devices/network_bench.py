"""A simulated device on a virtual network, and a client of it, for tests."""

from hil_sim.buses.network import NetworkBus
from hil_sim.faults import Fault, FaultPlan
from tests.hil_sim.devices.twin_bench import MS, START_NS


class NetworkSession:
    """The twin that ``make`` makes of its faults, its bus at ``end``, advanced by milliseconds; ``cable``: the bus."""

    def __init__(self, end, make, name, faults=()) -> None:
        self.end, self.bus, self.now_ns = end, NetworkBus(end), START_NS
        plan = FaultPlan([Fault(*fault) for fault in faults], START_NS)
        self.twin = make(plan.of(name))
        self.bus.add(self.twin)
        self.bus.inject(plan.of("cable"))

    def pass_ms(self) -> None:
        self.now_ns += MS
        self.bus.advance(self.now_ns)

    def close(self) -> None:
        self.end.close()


def sessions(kind):
    """Of a fixture: makes sessions of this kind, of faults, and closes them afterwards."""
    made = []

    def make(*faults, **how):
        made.append(kind(faults, **how))
        return made[-1]

    yield make
    for one in made:
        one.close()
