"""RDT requests and records, big-endian. No port, no clock.

Requests: Net F/T manual, table 10.1 and section 10.2. A record is 36 bytes; in buffered mode a datagram has several.
The port puts the length of each datagram before it: see ``drivers.transports.network``.
"""

import struct

import numpy as np

from drivers.errors import FrameError

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
MOST_RECORDS = 40  # in a datagram, of buffered mode
_HEADER, _REQUEST, _LENGTH = 0x1234, struct.Struct(">HHI"), struct.Struct(">H")


def request(command: int, records: int = 0) -> bytes:
    """A request; ``records``: how many are sent, 0 for no end."""
    return _REQUEST.pack(_HEADER, command, records)


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
