"""A bus with an encoder, a load cell and an arm controller, as the driver is configured for it."""

from drivers.canopen_pdo import CanopenBus, CanopenObjectConfig, Cia404Config, Cia406Config, SyncConfig
from tests.drivers.batches import of

JOINT = Cia406Config("joint_1", 1, 500_000)
CELL = Cia404Config("load_cell", 2, 50.0)
PHASE = CanopenObjectConfig("arm_phase", 3, tpdo=1, byte_offset=0, format="u8", index=0x2000, subindex=1)


def make(port):
    return CanopenBus(port, [JOINT, CELL, PHASE], SyncConfig(), "can_0")


def sources(batches, code):
    rows = of(batches, "event")
    return [row["source"].decode() for row in rows if row["code"].decode() == code]
