"""DYNAMIXEL X servos on a line as the e-manual has them, for the driver's tests; packets put together by hand."""

import struct


def crc(data: bytes) -> bytes:
    """Polynomial 8005h, high bit first, from 0; low byte first on the wire."""
    value = 0
    for byte in data:
        value ^= byte << 8
        for _ in range(8):
            value = (value << 1 ^ (0x8005 if value >> 15 else 0)) & 0xFFFF
    return value.to_bytes(2, "little")


def status(identifier: int, error: int, data: bytes) -> bytes:
    """A status packet, stuffed."""
    body = bytes([0x55, error]) + data
    body = body.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
    packet = b"\xff\xff\xfd\x00" + bytes([identifier]) + struct.pack("<H", len(body) + 2) + body
    return packet + crc(packet)


def fast_status(blocks: list[tuple[int, int, bytes]], asked: int) -> bytes:
    """What servos make together of a Fast Sync Read; of ``asked`` servos the first ones answer."""
    size = 4 + len(blocks[0][2]) if blocks else 0
    packet = b"\xff\xff\xfd\x00\xfe" + struct.pack("<H", 1 + asked * size) + b"\x55" if blocks else b""
    for identifier, error, data in blocks:
        packet += bytes([error, identifier]) + data
        packet += crc(packet)
    return packet


class ServoModel:
    """Registers of one servo: XM430-W350 (1020) with firmware 45."""

    def __init__(self, *, model: int = 1020, firmware: int = 45) -> None:
        self.memory = bytearray(256)
        self.memory[0:2] = struct.pack("<H", model)
        self.memory[6], self.memory[9], self.memory[31] = firmware, 250, 80
        self.memory[144:147] = struct.pack("<HB", 119, 33)
        self.error = 0
        self.deaf = False

    def present(self, current: int = 0, velocity: int = 0, position: int = 0) -> None:
        """Set what is measured."""
        self.memory[126:136] = struct.pack("<hii", current, velocity, position)

    def hardware_error(self, bits: int) -> None:
        """Set Hardware Error Status, and the alert bit with it."""
        self.memory[70], self.error = bits, 0x80 if bits else 0


class ChainModel:
    """Servos by ID. ``requests``: what they were asked, without header and CRC."""

    def __init__(self, **servos: ServoModel) -> None:
        self.servos = {int(name.removeprefix("id_")): servo for name, servo in servos.items()}
        self.requests: list[bytes] = []

    def receive(self, packet: bytes) -> bytes:
        """The answer to an instruction packet."""
        assert packet[:4] == b"\xff\xff\xfd\x00"
        assert packet[-2:] == crc(packet[:-2])
        assert len(packet) == 7 + struct.unpack("<H", packet[5:7])[0]
        self.requests.append(packet[4:5] + packet[7:-2])
        identifier, instruction = packet[4], packet[7]
        address, count = struct.unpack("<HH", packet[8:12])
        if instruction == 0x02:
            return self._status(identifier, address, count)
        assert identifier == 0xFE
        asked = list(packet[12:-2])
        if instruction == 0x82:
            return self._in_turn(asked, address, count)
        assert instruction == 0x8A
        blocks = []
        for one in asked:
            servo = self.servos.get(one)
            if servo is None or servo.deaf or servo.memory[6] < 45:
                break
            blocks.append((one, servo.error, bytes(servo.memory[address : address + count])))
        return fast_status(blocks, len(asked))

    def _in_turn(self, asked: list[int], address: int, count: int) -> bytes:
        """Each waits for the one before it, and for ever where that is silent."""
        said = b""
        for one in asked:
            answer = self._status(one, address, count)
            if not answer:
                break
            said += answer
        return said

    def _status(self, identifier: int, address: int, count: int) -> bytes:
        servo = self.servos.get(identifier)
        if servo is None or servo.deaf:
            return b""
        return status(identifier, servo.error, bytes(servo.memory[address : address + count]))
