"""Samples one by one out of the data registers, for buses where the FIFO is not to be trusted (clones, long transfers).

One transfer of 15 bytes is one sample: INT_STATUS (3Ah), then 3Bh..48h, which the chip holds still from START to STOP
(RM 4.18). DATA_RDY there says that the sample is new; reading clears it, so none is taken twice. Polls are a tenth
shorter than the sample period, so that a chip up to 5 % fast makes at most one sample between two polls in time.

The chip does not count: a new sample is the next one, and how many went by unseen is told by host time over the
sample period that the stream has shown. Only what has surely been missed is named, for a number too high could
never be taken back; one too low is mended within a few polls. Known wart: a sample made in the 70 us between START and
INT_STATUS may be flagged and not yet shown.
"""

from drivers.mpu6050 import registers as reg
from drivers.mpu6050.bus import RegisterBus
from drivers.mpu6050.decode import PACKET_BYTES, decode_packets
from drivers.mpu6050.registers import Chip, Mpu6050Config
from drivers.mpu6050.stream import SampleStream

POLL = 0.9  # sample periods
SLOWEST = 1.05  # nominal sample periods: internal oscillator, before the stream has shown the chip's own
DOUBT = 0.25  # sample periods by which the fitted clock may be off
CHECK_EVERY = 32  # samples in time between two looks at the clock
WARY = 12  # samples after a late poll before it is believed again: polls have been everywhere in the sample period


class Burst:
    """The data registers of a chip that has been set up.

    Args:
        config: How the chip was set up.
        bus: Its registers.
        stream: Numbers its samples.

    Attributes:
        chip: The die.
        running: Samples are counted.
        registers: What holds besides the configuration while it runs.
    """

    registers = reg.BURST_RUNS

    def __init__(self, config: Mpu6050Config, bus: RegisterBus, stream: SampleStream) -> None:
        self.chip: Chip = reg.CHIPS[0x68]
        self.running = False
        self._config = config
        self._bus = bus
        self._stream = stream
        self._asked_ns = 0  # of the last poll
        self._stamped_ns = 0
        self._unchecked = 0
        self._wary = 0

    @property
    def period_ns(self) -> int:
        """Time between two polls."""
        return int(POLL * self._config.sample_period_ns)

    def restart(self, now_ns: int, at_least: int = 0) -> None:
        """Begin with the next new sample, after naming what was surely missed before. Raises OSError."""
        self.running = False
        for register, value in self.registers.items():
            self._bus.write(register, value)
        reply = self._bus.read(reg.INT_STATUS)
        stream, clock = self._stream, self._stream.clock
        if clock:
            stream.lose(now_ns, max(clock.surely_produced(now_ns), stream.next + at_least))
            if stream.after_reset:
                clock.forget_phase()
        clock.observe(reply.host_ns, stream.next, now_ns)
        self._asked_ns, self._stamped_ns = now_ns, reply.host_ns
        self._unchecked = 0
        self.running = True

    def take(self, now_ns: int) -> bool:
        """Hand over the sample in the registers. False: it is not a new one. Raises OSError."""
        reply = self._bus.read(reg.INT_STATUS, 1 + PACKET_BYTES)
        stream, clock = self._stream, self._stream.clock
        is_new = bool(reply.data[0] & reg.DATA_RDY)
        asked_ns = min(now_ns, reply.host_ns)
        if is_new:
            missed = self._missed(asked_ns)
            if missed > 0:
                stream.cause = stream.cause or "missed"
                stream.lose(now_ns, stream.next + missed)
        clock.observe(reply.host_ns, stream.next + is_new, asked_ns)
        self._asked_ns, self._stamped_ns = asked_ns, reply.host_ns
        if is_new:
            stream.hand_over(decode_packets(reply.data[1:], self._config), reply.host_ns)
            stream.cause = ""
        return is_new

    def silence(self) -> None:
        """Nothing to stop."""

    def _missed(self, asked_ns: int) -> int:
        """Samples surely made before this new one, and after the last one taken."""
        stream, nominal_ns = self._stream, self._config.sample_period_ns
        missed = int((asked_ns - self._stamped_ns) // (SLOWEST * nominal_ns)) - 1
        self._unchecked += 1
        if asked_ns - self._asked_ns >= (1.0 + POLL) / 2.0 * nominal_ns:
            self._wary = WARY
        if not self._wary and self._unchecked < CHECK_EVERY:
            return missed
        self._wary = max(self._wary - 1, 0)
        self._unchecked = 0
        if stream.clock.slope_known:
            surely_made = stream.clock.surely_produced(asked_ns - int(DOUBT * nominal_ns))
            missed = max(missed, surely_made - stream.next - 1)
        return missed
