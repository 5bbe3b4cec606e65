"""The sync line as a pulse-per-second source of the kernel (RFC 2783): a serial port's DCD, a GPIO, a timer."""

import errno
import fcntl
import os
import struct
from collections.abc import Callable

from drivers.ports import Edge
from drivers.transports.clock import realtime_minus_monotonic

# linux/pps.h: struct pps_fdata = pps_kinfo (two sequences, assert and clear stamp, mode), then the timeout, a pps_ktime
_FDATA = struct.Struct("=II qiI qiI i4x qiI")
PPS_FETCH = 3 << 30 | struct.calcsize("P") << 16 | ord("p") << 8 | 0xA4  # _IOWR('p', 0xa4, struct pps_fdata *)
SHORTEST_WAIT_NS = 10_000_000  # one tick at 100 Hz: the kernel rounds down to 0 below that


class PpsPort:
    """A ``PulsePort`` on ``/dev/ppsN``: assert edges, stamped in the interrupt with CLOCK_REALTIME.

    The stamp is moved to CLOCK_MONOTONIC by an offset taken at the receive. The kernel keeps the last edge only, so a
    receive returns at most one; ``line_sequence`` is the kernel's assert sequence, so missed edges appear as a jump.
    Edges before the port was opened are not returned.
    """

    def __init__(self, path: str, clock: Callable[[], int]) -> None:
        self._clock = clock
        self._fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        try:
            self._last, _ = self._fetch(0)
        except OSError:
            os.close(self._fd)
            raise

    def receive(self, timeout_s: float) -> list[Edge]:
        """The last edge, if it is a new one; waits up to ``timeout_s`` for it. Raises OSError."""
        sequence, realtime_ns = self._fetch(0)
        if sequence == self._last and timeout_s > 0.0:
            try:
                sequence, realtime_ns = self._fetch(max(round(timeout_s * 1e9), SHORTEST_WAIT_NS))
            except OSError as error:
                if error.errno not in {errno.ETIMEDOUT, errno.EINTR}:
                    raise
                return []
        if sequence == self._last:
            return []
        self._last = sequence
        host_ns = self._clock()
        return [Edge(realtime_ns - realtime_minus_monotonic(self._clock), host_ns, sequence)]

    def close(self) -> None:
        """Close the source."""
        os.close(self._fd)

    def _fetch(self, timeout_ns: int) -> tuple[int, int]:
        """Assert sequence and stamp (CLOCK_REALTIME, ns), after the next event or the timeout."""
        seconds, nanoseconds = divmod(timeout_ns, 1_000_000_000)
        data = bytearray(_FDATA.pack(*[0] * 9, seconds, nanoseconds, 0))
        fcntl.ioctl(self._fd, PPS_FETCH, data)
        sequence, _, assert_s, assert_ns, *_ = _FDATA.unpack(data)
        return sequence, assert_s * 1_000_000_000 + assert_ns
