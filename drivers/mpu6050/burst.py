"""Reads single samples from the data registers, for buses where the FIFO is unreliable (clones, long transfers).

One transfer of 15 bytes is one sample: INT_STATUS (3Ah), then 3Bh..48h, which the chip does not update between START
and STOP (RM 4.18). DATA_RDY marks a new sample and is cleared by reading, so none is taken twice. The poll period is
0.9 sample periods, so that a chip up to 5 % fast makes at most one sample between two punctual polls.

The chip does not number its samples: the number missed is host time divided by the fitted sample period. The lower
bound is recorded, because a number too high cannot be corrected later; one too low is corrected within a few polls.
Known limit: a sample made in the 70 us between START and INT_STATUS may be flagged before its data are shown.
"""

from drivers.i2c.bus import RegisterBus
from drivers.inertial.packet import PACKET_BYTES
from drivers.inertial.stream import SampleStream
from drivers.mpu6050 import registers as reg
from drivers.mpu6050.fifo import decode_packets
from drivers.mpu6050.registers import Chip, Mpu6050Config

POLL = 0.9  # sample periods
SLOWEST = 1.05  # nominal sample periods: internal oscillator, until the period is fitted
CLOCK_ERROR = 0.25  # error bound of the fitted clock, sample periods
CHECK_EVERY = 32  # punctual samples between two comparisons with the clock
RECHECKS = 12  # samples compared with the clock after a late poll: polls then cover the whole sample period


class Burst:
    """Samples from the data registers of a configured chip.

    Args:
        config: How the chip was set up.
        bus: Its registers.
        stream: Numbers its samples.

    Attributes:
        chip: The die.
        running: Samples are counted.
        registers: Register values besides the configuration while it runs.
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
        self._rechecks = 0

    @property
    def period_ns(self) -> int:
        """Time between two polls."""
        return int(POLL * self._config.sample_period_ns)

    @property
    def rests_ns(self) -> int:
        """How long samples may wait in the chip: the next one takes the place of the last."""
        return 0

    def restart(self, now_ns: int, at_least: int = 0) -> None:
        """Start with the next new sample, after recording the samples certainly missed. Raises OSError."""
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
        """Read the data registers and add the sample if it is new; False if not. Raises OSError."""
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
        """Lower bound of the samples made between the last one taken and this new one."""
        stream, nominal_ns = self._stream, self._config.sample_period_ns
        missed = int((asked_ns - self._stamped_ns) // (SLOWEST * nominal_ns)) - 1
        self._unchecked += 1
        if asked_ns - self._asked_ns >= (1.0 + POLL) / 2.0 * nominal_ns:
            self._rechecks = RECHECKS
        if not self._rechecks and self._unchecked < CHECK_EVERY:
            return missed
        self._rechecks = max(self._rechecks - 1, 0)
        self._unchecked = 0
        if stream.clock.slope_known:
            surely_made = stream.clock.surely_produced(asked_ns - int(CLOCK_ERROR * nominal_ns))
            missed = max(missed, surely_made - stream.next - 1)
        return missed
