"""A controller that speaks RTDE, typed from Universal Robots' guide: what it answers, and its data packages.

``PACKED``: made on 2026-11-26 by Universal Robots' own ``serialize.DataConfig.pack`` (BSD, as in openur 0.3.0).
"""

import struct

PACKED = bytes.fromhex(  # recipe 1 of the outputs of the tests, at 100.032 s: robot_mode 7, safety_status_bits 1,
    "014059020c49ba5e350000000700000001"
    "3fb999999999999abff80000000000004002000000000000bfe80000000000003ff8000000000000c008000000000000"  # actual_q
    "3fe0000000000000bff40000000000003fe80000000000003fb999999999999abfc999999999999a3fd3333333333333"  # actual_current
    "3ff0000000000000c000000000000000c0414000000000003fd00000000000003fe0000000000000bfc0000000000000"  # ft_raw_wrench
)

OUTPUTS = {  # name: type of the guide's table, format, value; a vector has six of it, one more each
    "timestamp": ("DOUBLE", "d", 0.0),
    "actual_q": ("VECTOR6D", "6d", 0.5),
    "actual_qd": ("VECTOR6D", "6d", -0.25),
    "actual_current": ("VECTOR6D", "6d", 1.5),
    "target_moment": ("VECTOR6D", "6d", 20.0),
    "actual_TCP_force": ("VECTOR6D", "6d", -9.0),
    "ft_raw_wrench": ("VECTOR6D", "6d", -3.0),
    "robot_mode": ("INT32", "i", 7),
    "safety_status_bits": ("UINT32", "I", 1),
}


def framed(letter: str, payload: bytes = b"") -> bytes:
    """A package."""
    return struct.pack(">HB", 3 + len(payload), ord(letter)) + payload


def text(message: str, source: str = "Controller", level: int = 2) -> bytes:
    """A text message of protocol version 2."""
    parts = [bytes([len(part)]) + part.encode() for part in (message, source)]
    return framed("M", b"".join(parts) + bytes([level]))


class RtdeModel:
    """It answers each request as the guide says.

    Attributes:
        says: Answers that replace its own, by letter.
        lacks: Outputs that it has not, and what it says of them.
        values: What it measures; ``timestamp`` is seconds since it was switched on.
        asked: Requests so far, by letter and payload.
        sends: Names of the outputs in its data packages; empty before the start.
    """

    def __init__(self) -> None:
        self.says: dict[str, bytes] = {}
        self.lacks: dict[str, str] = {}
        self.values = {name: value for name, (_, _, value) in OUTPUTS.items()}
        self.asked: list[tuple[str, bytes]] = []
        self.rate_hz = 0.0
        self.names: list[str] = []
        self.sends: list[str] = []

    def receive(self, data: bytes) -> bytes:
        """The answers to requests, which come whole."""
        answers = b""
        while data:
            size, kind = struct.unpack_from(">HB", data)
            letter, payload, data = chr(kind), data[3:size], data[size:]
            self.asked.append((letter, payload))
            own = self._answer(letter, payload)
            answers += framed(letter, self.says.get(letter, own))
        return answers

    def _answer(self, letter: str, payload: bytes) -> bytes:
        if letter == "V":
            self.sends = []
            return bytes([payload == b"\0\2"])
        if letter == "v":
            return struct.pack(">4I", 5, 11, 1, 108318)
        if letter == "O":
            (self.rate_hz,) = struct.unpack_from(">d", payload)
            self.names = payload[8:].decode().split(",")
            types = [self.lacks.get(n, OUTPUTS.get(n, ("NOT_FOUND",))[0]) for n in self.names]
            return bytes(["NOT_FOUND" not in types and "IN_USE" not in types]) + ",".join(types).encode()
        assert letter in {"S", "P"}, f"{letter} would command it"
        self.sends = self.names if letter == "S" else []
        return b"\1"

    def data(self, time_s: float, recipe: int = 1, **values) -> bytes:
        """A data package of the outputs that were asked for."""
        said = {**self.values, "timestamp": time_s, **values}
        payload = bytes([recipe])
        for name in self.sends:
            form, value = OUTPUTS[name][1], said[name]
            six = [value + k for k in range(6)] if form == "6d" else [value]
            payload += struct.pack(">" + form, *six)
        return framed("U", payload)
