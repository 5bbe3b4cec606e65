"""Modbus-RTU frames of a master that reads holding registers. No port, no clock.

Source: MODBUS Application Protocol 1.1b3, section 6.3; Modbus over Serial Line 1.02, section 2.5.1.
"""

from drivers.errors import ConfigurationError, DriverError, FrameError

READ = 0x03
EXCEPTION = 0x80
MOST_REGISTERS = 125
EXCEPTIONS = {
    1: "illegal function: it does not know the function code",
    2: "illegal data address: it has no such register, check that it has the Laumas map",
    3: "illegal data value: check the register count",
    4: "device failure: check the transmitter",
    6: "device busy: poll more slowly",
}


class ModbusException(DriverError, RuntimeError):  # noqa: N818 - the protocol's name
    """The device refused a request.

    Attributes:
        code: The exception code.
    """

    def __init__(self, code: int) -> None:
        super().__init__(f"Modbus exception {code}, {EXCEPTIONS.get(code, 'unknown: see the manual of the device')}")
        self.code = code


def _crc_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = (crc >> 1) ^ 0xA001 if crc & 1 else crc >> 1
        table.append(crc)
    return tuple(table)


_TABLE = _crc_table()


def crc16(data: bytes) -> int:
    """CRC-16/MODBUS of ``data``; 4B37h for ``123456789``. It is sent low byte first."""
    crc = 0xFFFF
    for byte in data:
        crc = (crc >> 8) ^ _TABLE[(crc ^ byte) & 0xFF]
    return crc


def read_request(address: int, register: int, count: int) -> bytes:
    """Function 3: read ``count`` holding registers from wire address ``register`` on (40001 is 0).

    Raises:
        ConfigurationError: An argument outside the range of the protocol.
    """
    if not (1 <= address <= 247 and 0 <= register <= 0xFFFF and 1 <= count <= MOST_REGISTERS):
        raise ConfigurationError(f"address {address}, register {register}, count {count}: use 1..247, 0..65535, 1..125")
    body = bytes([address, READ]) + register.to_bytes(2, "big") + count.to_bytes(2, "big")
    return body + crc16(body).to_bytes(2, "little")


class ModbusReply:
    """Gathers the answer to one request.

    Args:
        request: As sent, with its CRC.
        echoes: The adapter hears what it sends: the request comes back before the answer.
    """

    def __init__(self, request: bytes, echoes: bool = False) -> None:
        self._address = request[0]
        count = int.from_bytes(request[4:6], "big")
        self._length = 5 + 2 * count
        self._echo = request if echoes else b""
        self._buffer = b""

    @property
    def missing(self) -> int:
        """Bytes still to come if the device does not refuse."""
        return max(1, len(self._echo) + self._length - len(self._buffer))

    def receive(self, data: bytes) -> tuple[int, ...] | None:
        """More bytes: the registers read when the answer is whole, None while it is not.

        Raises:
            FrameError: The bytes are not the answer to this request; wait for silence on the line before the next
                request.
            ModbusException: The device refused.
        """
        self._buffer += data
        if not self._buffer.startswith(self._echo[: len(self._buffer)]):
            raise FrameError("the request does not come back as it was sent: set echo only if the adapter hears itself")
        answer = self._buffer[len(self._echo) :]
        if not answer:
            return None
        if answer[0] != self._address:
            raise FrameError(f"answer from address {answer[0]}, not {self._address}: is another master on the line?")
        if len(answer) < 2:
            return None
        refused = answer[1] == READ | EXCEPTION
        if not refused and answer[1] != READ:
            raise FrameError(f"answer to function {answer[1]}, not {READ}: it is late, or bytes were lost")
        length = 5 if refused else self._length
        if len(answer) > 2 and not refused and answer[2] != length - 5:
            raise FrameError(f"{answer[2]} bytes of registers, not {length - 5}: it is late, or bytes were lost")
        if len(answer) < length:
            return None
        if len(answer) > length:
            raise FrameError(f"{len(answer) - length} bytes after the answer: is another master on the line?")
        if crc16(answer[:-2]) != int.from_bytes(answer[-2:], "little"):
            raise FrameError("CRC of the answer is wrong: check wiring, termination and baud rate")
        if refused:
            raise ModbusException(answer[2])
        return tuple(int.from_bytes(answer[at : at + 2], "big") for at in range(3, length - 2, 2))
