"""The ground's side of commands: their packets, one after the other, and what is reported on them."""

from collections import deque
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from typing import NamedTuple

from onboard.channels import Order
from onboard.telemetry.board import reported
from onboard.telemetry.packets import COUNTS, Packet
from onboard.telemetry.uplink import telecommand

FORMS = "mark NUMBER, stop, or span BEGIN END (UTC, 2026-01-31T12:00:00, or seconds before the flight's time: -60 -30)"
_FINAL = {2: False, 7: True, 8: False}  # by subtype: whether it is done
_MARKS = 1 << 16


class OperatorCommand(NamedTuple):
    """A command of the operator; times of a span in seconds, those below 0 before now."""

    order: Order
    arguments: tuple[float, ...] = ()


def parse(text: str) -> OperatorCommand:
    """``mark 3``, ``stop``, ``span -60 -30``.

    Raises:
        ValueError: it is none; the message gives the forms.
    """
    try:
        word, *given = text.split()
        order = Order[word.upper()]
        numbers = tuple(_seconds(one) if order is Order.SPAN else float(int(one)) for one in given)
    except (KeyError, ValueError) as error:
        raise ValueError(f"--command {text}: write {FORMS}") from error
    if len(numbers) != {Order.MARK: 1, Order.STOP: 0, Order.SPAN: 2}[order]:
        raise ValueError(f"--command {text}: write {FORMS}")
    if order is Order.MARK and not 0 <= numbers[0] < _MARKS:
        raise ValueError(f"--command {text}: a mark has a number from 0 to {_MARKS - 1}")
    return OperatorCommand(order, numbers)


def _seconds(text: str) -> float:
    if text == "0" or text.startswith("-"):
        return float(text)
    at = datetime.fromisoformat(text)
    return (at if at.tzinfo else at.replace(tzinfo=UTC)).timestamp()


class Commander:
    """Sends commands, each when the one before is done or has failed.

    Args:
        asked: by the operator.
        apid: ``command_apid`` of the vehicle file.
        source: who asks, 16 bits.
        count: of the first one.
        out: takes packets.
        say: called with what is reported.

    Attributes:
        done: whether each that is over was carried out.
    """

    def __init__(
        self,
        asked: Sequence[OperatorCommand],
        apid: int,
        source: int,
        count: int,
        out: deque[bytes],
        say: Callable[[str], None],
    ) -> None:
        self._asked, self._apid, self._source, self._count = deque(asked), apid, source, count
        self._out, self._say = out, say
        self._under_way: bytes | None = None  # its first four bytes
        self._total = len(asked)
        self.done: list[bool] = []

    @property
    def over(self) -> bool:
        """Whether nothing more is to come."""
        return len(self.done) == self._total

    def heard(self, packet: Packet) -> None:
        """A packet came: the session is known, or a command is reported on."""
        values = packet.values
        if self._under_way is None and self._asked:
            order, given = self._asked.popleft()
            now_s = packet.at_ns * 1e-9
            arguments = [round(now_s + one if order is Order.SPAN and one <= 0 else one) for one in given]
            data = telecommand(order, self._apid, packet.session, self._count, self._source, *arguments)
            self._count = (self._count + 1) % COUNTS
            self._under_way = data[:4]
            self._out.append(data)
        elif packet.kind.lead and values["destination"] == self._source:
            request = b"".join(values[name].to_bytes(2, "big") for name in ("packet_id", "sequence_control"))
            if request != self._under_way:
                return
            self._say(reported(packet))
            if values["subtype"] in _FINAL:
                self.done.append(_FINAL[values["subtype"]])
                self._under_way = None
