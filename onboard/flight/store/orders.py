"""Orders of an operator as rows in rings of the flight, and the supervisor's replies.

Each process that takes orders (the downlink's, the page's) is the one writer of a ring of its own, which the supervisor
has made; so the recorder has every order, with who gave it and when, refused ones too. There are none in a flight whose
vehicle file arms no command.
"""

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from onboard.channels import ORDER, ORDER_REPLY, Order, Refusal
from onboard.ring import RingReader, RingWriter

if TYPE_CHECKING:  # a process that gives orders stays small
    from onboard import config

UPLINK, PAGE, REPLY = "order_uplink", "order_page", "order_reply"


def order_channels(vehicle: "config.Vehicle") -> dict[str, np.dtype[np.void]]:
    """Records by channel; none where no command is armed."""
    armed = vehicle.file.telemetry.commands
    return dict.fromkeys((UPLINK, PAGE), ORDER) | {REPLY: ORDER_REPLY} if armed else {}


def order_row(now_ns: int, order: int, who: str, refused: Refusal = Refusal.NONE, **fields: int) -> np.void:
    """An ORDER row without its number."""
    row = np.zeros(1, ORDER)
    row["host_ns"], row["order"], row["refused"], row["who"] = now_ns, order, refused, who.encode()
    for name, value in fields.items():
        row[name] = value
    found: np.void = row[0]
    return found


def refusal(row: np.void, armed: Collection[str]) -> Refusal:
    """Whether the vehicle file stands against an order."""
    known = {int(one): one.name.lower() for one in Order}
    name = known.get(int(row["order"]))
    return Refusal.UNKNOWN if name is None else Refusal.NONE if name in armed else Refusal.NOT_ARMED


class OrderBook:
    """The end of a process that takes orders.

    Args:
        directory: of a flight.
        channel: its own.

    Raises:
        OSError: the flight takes no orders, or its rings are just being made.
    """

    def __init__(self, directory: Path, channel: str) -> None:
        self._channel = channel.encode()
        made = RingReader(directory / f"{channel}.ring")
        self._orders = RingWriter(made.path, ORDER, made.capacity)
        made.close()
        self._replies = RingReader(directory / f"{REPLY}.ring")

    def give(self, row: np.void) -> int:
        """Hand an order in; its number."""
        number = self._orders.published
        row["sequence"] = number
        self._orders.push(np.array([row], ORDER))
        return number

    def replies(self) -> Mapping[int, Refusal]:
        """New replies, by the number of their order."""
        rows = self._replies.read()[0]
        return {int(row["order_sequence"]): Refusal(row["refused"]) for row in rows if row["channel"] == self._channel}

    def close(self) -> None:
        """Close both rings."""
        self._orders.close()
        self._replies.close()
