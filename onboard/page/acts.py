"""What an operator may do on the page: a mark, the end of the flight; handed to the supervisor as those of the uplink.

Only where the vehicle file arms it, and on the loopback interface. Each is confirmed on the page and has a name, which
the log gets with the time.
"""

import asyncio
import contextlib
import json
from collections.abc import Sequence
from typing import Any

from onboard.channels import Order, Refusal
from onboard.flight.store.orders import PAGE, OrderBook, order_row
from onboard.page.follow import Followed

ACTS = ("mark", "stop")
LONGEST_NAME = 40  # characters
MOST_MARK = (1 << 16) - 1
_REPLY_S, _LOOK_S = 3.0, 0.05


class Acts:
    """Of one flight.

    Args:
        followed: which one.
        armed: what of :data:`ACTS` may be done.
    """

    def __init__(self, followed: Followed, armed: Sequence[str]) -> None:
        self.armed = list(armed)
        self._followed = followed
        self._book: OrderBook | None = None
        self._replies: dict[int, Refusal] = {}

    async def do(self, body: bytes) -> tuple[str, str]:
        """Do what is asked.

        Args:
            body: JSON with ``act``, ``who``, and the ``number`` of a mark.

        Returns:
            An HTTP status, and what became of it, in words.
        """
        try:
            order, who, number = self._read(json.loads(body))
        except ValueError as error:  # the body is no JSON, or asks for what is not done
            return "400 Bad Request", str(error)
        directory = self._followed.directory
        if self._book is None and directory is not None:
            with contextlib.suppress(OSError, ValueError):
                self._book = OrderBook(directory, PAGE)
        if self._book is None or self._followed.ended:
            return "409 Conflict", "the flight has ended" if self._followed.ended else "no flight takes orders yet"
        loop = asyncio.get_running_loop()
        given = self._book.give(order_row(int(loop.time() * 1e9), order, f"the page, {who}", number=number))
        until_s = loop.time() + _REPLY_S
        while loop.time() < until_s and given not in self._replies:
            self._replies |= self._book.replies()
            await asyncio.sleep(_LOOK_S)
        refused = self._replies.pop(given, Refusal.NOT_DONE)
        if refused is Refusal.NOT_DONE:
            return "504 Gateway Timeout", "the flight's supervisor does not answer: see the events"
        if refused:
            return "403 Forbidden", f"refused: {refused.name.lower().replace('_', ' ')}"
        return "200 OK", f"mark {number} is in the log" if order is Order.MARK else "the flight is being ended"

    def _read(self, asked: Any) -> tuple[Order, str, int]:
        if not isinstance(asked, dict) or asked.get("act") not in self.armed:
            raise ValueError(f"nothing but {', '.join(self.armed)} can be done here")
        who, number = asked.get("who"), asked.get("number", 0)
        if not isinstance(who, str) or not who.strip() or len(who) > LONGEST_NAME or not who.isprintable():
            raise ValueError(f"say who asks, in {LONGEST_NAME} characters at most")
        if not isinstance(number, int) or isinstance(number, bool) or not 0 <= number <= MOST_MARK:
            raise ValueError(f"a mark has a number from 0 to {MOST_MARK}")
        return Order[asked["act"].upper()], who.strip(), number
