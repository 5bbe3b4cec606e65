"""A node of two channels on a scripted line, as the tests of its device fly it."""

from drivers.node_frame import NodeFrame, NodeFrameConfig
from tests.drivers.batches import whole
from tests.drivers.node_model import NodeModel
from tests.drivers.serial_script import MS, ScriptedSerial, SerialFlight

S = 1_000_000_000
FORCE, ANGLE = ("force", "N", 5, 0, 1, -4), ("angle", "rad", 2, 1, 15, -4)
CHANNELS = [FORCE, ANGLE]


class Flight(SerialFlight):
    """One node of two channels, a data frame a millisecond, a descriptor a second."""

    def __init__(self, clock, node=None, **config) -> None:
        self.node = node or NodeModel(CHANNELS)
        self.tick_at_zero = 0
        config = {"channels": ("force", "angle"), **config}
        port = ScriptedSerial()
        super().__init__(clock, port, NodeFrame("rig", port.open, clock, NodeFrameConfig(**config)))

    def tick(self) -> int:
        return self.tick_at_zero + self.clock() // 1000

    def frame(self, **options) -> bytes:
        return self.node.data(self.tick(), *self.values(self.node.sequence), **options)

    @staticmethod
    def values(sequence: int) -> tuple[int, int]:
        return 3 * (sequence % 2**20) - 1000, 100 * sequence % 65536

    def fly(self, samples: int, lost=()) -> None:
        """``samples`` milliseconds, read every ten; the frames numbered in ``lost`` go astray."""
        for number in range(samples):
            self.clock.advance(MS)
            frame = self.frame()
            if number not in lost:
                self.port.say(frame)
            if self.clock() % (10 * MS) == 0:
                self.pump(0)

    def descend(self) -> None:
        self.port.say(self.node.descriptor(self.tick()))

    def rows(self, channel="rig_force"):
        """Rows of a channel, after a check that they and the gaps add up."""
        return whole(self.batches, channel)
