"""A twin that sends back what it hears, behind an adapter in virtual time."""

from hil_sim.buses.serial_bus import SerialBus
from hil_sim.buses.serial_port import VirtualSerial
from hil_sim.devices.serial_line.serial_twin import SerialTwin
from hil_sim.devices.serial_wire import LineFormat
from hil_sim.faults import NO_FAULTS, FaultPlan
from tests.hil_sim.devices.twin_bench import MS, START_NS

FAST = LineFormat(115_200)


class Echo(SerialTwin):
    """Sends back what it hears."""

    def __init__(self, start_ns=START_NS, line=FAST):
        super().__init__(line, start_ns, NO_FAULTS)
        self.heard = bytearray()

    def _on_byte(self, byte, now_ns):
        self.heard.append(byte)
        self._send(bytes([byte]), now_ns)


class Rig:
    """An echo behind a T0 adapter."""

    def __init__(self, *faults, seed=0, device=None, latency_ns=0):
        self.adapter = VirtualSerial("/dev/hil-echo")
        self.bus = SerialBus(self.adapter, seed, latency_ns=latency_ns)
        self.device = device or Echo()
        self.bus.add(self.device)
        self.bus.inject(FaultPlan(faults, START_NS).of("line"))
        self.now_ns = START_NS
        self.bus.advance(START_NS)

    def run(self, ms):
        self.now_ns += round(ms * MS)
        self.bus.advance(self.now_ns)
