"""A QSB typed from the "QSB Command List": its registers with factory values, replies, streams, capture."""

import re
from collections.abc import Callable

FACTORY = {
    **{0x00: 0, 0x01: 0xF, 0x02: 0, 0x03: 0x4F, 0x04: 0, 0x05: 0, 0x06: 0x0A, 0x08: 0x1F3, 0x0B: 0, 0x0C: 0xFFFF},
    **{0x0D: 0, 0x0E: 0, 0x14: 0x12345_0_0E, 0x15: 0xB, 0x16: 0},
}
READ_ONLY = {0x01, 0x05, 0x06, 0x0E, 0x14}
COMMAND = re.compile(r"([RWS])([0-9A-F]{2})([0-9A-F]{0,8})")


class QsbModel:
    """An adapter with an encoder on it; ``count`` is what the encoder has turned, x4."""

    def __init__(self, clock: Callable[[], int], count=lambda ns: 0, tick_ns: int = 1_953_125) -> None:
        self.clock, self.encoder, self.tick_ns = clock, count, tick_ns
        self.commands: list[str] = []
        self.refuse: dict[str, bytes] = {}  # answers that are not what they should be
        self.deaf = False
        self.acknowledges_streams = True
        self.serial = 0
        self.power_up()

    def power_up(self) -> bytes:
        """What a reset makes of it; what it says then."""
        self.registers = dict(FACTORY)
        self.streams: list[int] = []
        self.zero_ns = self.clock()
        self.zero_count = self.encoder(self.clock())
        self._input = ""
        self.line_tick = 0
        self._level = 0
        return b"QSB-D  0E!\r\n"

    @property
    def tick(self) -> int:
        return (self.clock() - self.zero_ns) // self.tick_ns

    def counter(self) -> int:
        turned = self.encoder(self.clock()) - self.zero_count
        turned >>= {3: 0, 2: 1, 1: 2}.get(self.registers[0x03] & 3, 0)
        if self.registers[0x04] & 0x100:
            turned = -turned
        if self.registers[0x03] & 0xC == 0xC:
            return turned % (self.registers[0x08] + 1)
        return turned % 2**32

    def line(self, kind: str, register: int, data: int, tick: int | None = None) -> bytes:
        eor = self.registers[0x15]
        fields = [kind, f"{register:02X}", f"{data & 0xFFFFFFFF:08X}"]
        if eor & 4:
            fields.append(f"{(self.tick if tick is None else tick) & 0xFFFFFFFF:08X}")
        text = (" " if eor & 8 else "").join([*fields, "!"])
        return (text + ("\r" if eor & 2 else "") + ("\n" if eor & 1 else "")).encode()

    def receive(self, data: bytes) -> bytes:
        """Commands in, replies out."""
        if self.deaf:
            return b""
        self._input += data.decode()
        *lines, self._input = re.split("[\r\n]", self._input)
        return b"".join(self._command(line) for line in lines if line)

    def _command(self, text: str) -> bytes:
        self.commands.append(text)
        if text in self.refuse:
            return self.refuse[text]
        match = COMMAND.fullmatch(text)
        assert match is not None, text
        kind, register, data = match[1], int(match[2], 16), int(match[3] or "0", 16)
        if register not in FACTORY:
            return self.line("x", register, data)
        if kind == "R":
            self.streams = [stream for stream in self.streams if stream != register]
            return self.line("r", register, self._value(register))
        if kind == "S":
            self.streams.append(register)
            self.line_tick = self.tick
            return self.line("s", register, self._value(register)) if self._acknowledges(register) else b""
        if register in READ_ONLY:
            return self.line("e", register, data)
        if register == 0x0D:
            if data == 1:
                self.zero_ns = self.clock()
        elif register == 0x16:
            if data == 1:
                self.streams.clear()
        else:
            self.registers[register] = data
        return self.line("w", register, data)

    def _acknowledges(self, register: int) -> bool:
        return self.acknowledges_streams or register == 0x0E

    def _value(self, register: int) -> int:
        if register == 0x0E:
            return self.counter()
        if register == 0x0D:
            return self.tick
        if register == 0x01:
            return self._level | 0xE
        return self.registers[register]

    def edge(self, rising: bool = True) -> bytes:
        """The sync line changes; what the adapter says, in order of time: first the positions of before."""
        now_ns, clock = self.clock(), self.clock
        self.clock = lambda: now_ns
        said = b"".join(self.due())
        self._level = int(rising)
        mode = self.registers[0x02]
        if (mode, rising) in {(0x010, True), (0x011, False)}:
            before, self.registers[0x05] = self.registers[0x05], self.counter()
            if 0x05 in self.streams and self.registers[0x05] != before:
                said += self.line("s", 0x05, self.registers[0x05])
        if 0x01 in self.streams:
            said += self.line("s", 0x01, self._value(0x01))
        self.clock = clock
        return said

    def due(self) -> list[bytes]:
        """Position lines since the last call, a line an interval."""
        lines = []
        interval = self.registers[0x0C]
        if 0x0E not in self.streams or interval == 0xFFFF:
            return lines
        while self.line_tick + interval <= self.tick:
            self.line_tick += interval
            at_ns = self.zero_ns + self.line_tick * self.tick_ns
            now, self.clock = self.clock, lambda at=at_ns: at
            lines.append(self.line("s", 0x0E, self.counter(), self.line_tick))
            self.clock = now
        return lines
