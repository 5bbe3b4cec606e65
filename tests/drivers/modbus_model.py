"""A Laumas transmitter typed from its manual: function 3 and 16 on a map of holding registers, exceptions 1 to 3."""


def crc16(data: bytes) -> int:
    """CRC-16/MODBUS, bit by bit."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return crc


def framed(body: bytes) -> bytes:
    return body + crc16(body).to_bytes(2, "little")


class TransmitterModel:
    """Registers 40001..40032; ``gross`` and ``net`` in counts, division 0.001 kg."""

    def __init__(self, address: int = 1, gross: int = 0, net: int = 0, sign: str = "status") -> None:
        self.address, self.gross, self.net, self.sign = address, gross, net, sign
        self.errors = 0  # status bits 0..5
        self.division, self.unit = 15, 0
        self.deaf = False
        self.exception = 0
        self.requests: list[bytes] = []
        self.registers = 32

    def register(self, number: int) -> int:
        """Holding register 4xxxx."""
        if number == 40007:
            if self.sign != "status":
                return self.errors
            return self.errors | (self.gross < 0) << 7 | (self.net < 0) << 8
        if number in {40008, 40009, 40010, 40011}:
            value = self.gross if number < 40010 else self.net
            value = abs(value) if self.sign == "status" else value & 0xFFFFFFFF
            return value >> 16 if number % 2 == 0 else value & 0xFFFF
        if number == 40014:
            return self.unit << 8 | self.division
        return 0

    def receive(self, request: bytes) -> bytes:
        self.requests.append(request)
        if self.deaf or request[0] != self.address:
            return b""
        assert crc16(request[:-2]) == int.from_bytes(request[-2:], "little"), request.hex(" ")
        function, start, count = request[1], int.from_bytes(request[2:4], "big"), int.from_bytes(request[4:6], "big")
        if self.exception:
            return framed(bytes([self.address, function | 0x80, self.exception]))
        if function != 3:
            return framed(bytes([self.address, function | 0x80, 1]))
        if count > 32:
            return framed(bytes([self.address, function | 0x80, 3]))
        if start + count > self.registers:
            return framed(bytes([self.address, function | 0x80, 2]))
        values = [self.register(40001 + start + place) for place in range(count)]
        body = b"".join(value.to_bytes(2, "big") for value in values)
        return framed(bytes([self.address, 3, 2 * count]) + body)
