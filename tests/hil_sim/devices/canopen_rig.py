"""CANopen twins on a wire, booted or operational."""

from hil_sim.devices.canopen.encoder406 import Encoder406
from hil_sim.devices.canopen.loadcell404 import LoadCell404
from hil_sim.faults import FaultPlan
from tests.hil_sim.devices.twin_bench import START_NS, Analog, CanRig

COUNTS = 500_000


def plan(*faults):
    return FaultPlan(faults, START_NS).of("node")


def encoder(angle=lambda t: 0.0, **options):
    return Encoder406(1, Analog(angle), START_NS, **options)


def cell(force=lambda t: 0.0, **options):
    return LoadCell404(2, Analog(force), START_NS, **options)


def booted(*nodes):
    rig = CanRig(*nodes)
    rig.run(100)
    return rig


def operational(*nodes):
    rig = booted(*nodes)
    rig.send(0x000, 1, 0)
    rig.run(1)
    return rig


def of(frames, identifier):
    return [frame for frame in frames if frame.identifier == identifier]


def sync(rig, counter=None, ms=5.0):
    rig.send(0x080, *([] if counter is None else [counter]))
    return rig.run(ms)
