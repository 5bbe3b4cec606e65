"""RDT requests and records, big-endian. No port, no clock.

Requests: Net F/T manual, table 10.1 and section 10.2; of OnRobot's box: its example ``highspeed_udp.c``. A record is
36 bytes; in buffered mode a datagram has several.
The port puts the length of each datagram before it: see ``drivers.transports.network``.
"""

import struct

import numpy as np

from drivers.errors import ConfigurationError, FrameError

RECORD = np.dtype(
    [
        ("rdt_sequence", ">u4"),  # of the stream, from 1
        ("ft_sequence", ">u4"),  # internal samples since power-up
        ("status", ">u4"),
        ("counts", ">i4", (6,)),  # force along x, y, z, torque about them
    ]
)
STOP, START = 0x0000, 0x0002
ERROR = 1 << 31  # of the status: set whenever another bit of an error is
ANY_BIT = (1 << 32) - 1  # of OnRobot's: its bits are not published, and its driver takes any for an error
ONROBOT_HZ, ONROBOT_FILTERS = 1000, 7  # sent per second at a SPEED of 1; 0 no filter, 1 to 6: 500 Hz to 1.5 Hz
MOST_RECORDS = 40  # in a datagram, of buffered mode
_BIAS, _FILTER, _SPEED = 0x0042, 0x0081, 0x0082
_HEADER, _REQUEST, _LENGTH = 0x1234, struct.Struct(">HHI"), struct.Struct(">H")


def request(command: int, records: int = 0) -> bytes:
    """A request; ``records``: how many are sent, 0 for no end."""
    return _REQUEST.pack(_HEADER, command, records)


def onrobot_set_up(rate_hz: float, low_pass: int) -> tuple[bytes, ...]:
    """Requests that OnRobot's Compute Box needs before START: its rate and filter, and that nothing is taken off.

    Raises:
        ConfigurationError: It has no such rate or filter.
    """
    speed = round(ONROBOT_HZ / rate_hz)
    if not speed or abs(speed * rate_hz - ONROBOT_HZ) > 1e-6 or low_pass not in range(ONROBOT_FILTERS):
        text = f"rate_hz = {rate_hz:g}, filter = {low_pass}: the rate is 1000 / n Hz with a whole n, the filter 0 to 6"
        raise ConfigurationError(text)
    return request(_SPEED, speed), request(_FILTER, low_pass), request(_BIAS, 0)


class RecordStream:
    """Splits what a UDP port reads into the contents of datagrams, each of whole records."""

    def __init__(self) -> None:
        self._data = bytearray()

    def receive(self, data: bytes) -> None:
        """See ``FrameDecoder``."""
        self._data += data

    def take(self) -> bytes | None:
        """Records of the next datagram; None: there is none.

        Raises:
            FrameError: It has another length than records have; it is discarded.
        """
        if len(self._data) < _LENGTH.size:
            return None
        (size,) = _LENGTH.unpack_from(self._data)
        if len(self._data) < _LENGTH.size + size:
            return None
        content = bytes(self._data[_LENGTH.size : _LENGTH.size + size])
        del self._data[: _LENGTH.size + size]
        if not size or size % RECORD.itemsize or size > MOST_RECORDS * RECORD.itemsize:
            raise FrameError(f"a datagram of {size} bytes: records have {RECORD.itemsize}; is it an RDT port?")
        return content
