"""Carries out what an operator has asked for: a mark in the log, the end of the flight.

Who takes orders has judged them; what the vehicle file does not arm is refused here again. Every order is an event of
the log, with who gave it. A mark is a line in the log: the phases by which rows are identified are those of the phase
channel alone, which a device has said.
"""

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from drivers.records import Batch, Severity
from onboard import config
from onboard.channels import ORDER_REPLY, Order, Refusal
from onboard.flight.store.orders import PAGE, REPLY, UPLINK, refusal
from onboard.recording.format.texts import printable
from onboard.ring import RingReader


class Orders:
    """Of one flight.

    Args:
        vehicle: whose file arms commands.
        directory: of its rings.
        tell: publishes an event: severity, code, source, text.
        publish: takes replies.
    """

    def __init__(
        self,
        vehicle: config.Vehicle,
        directory: Path,
        tell: Callable[[Severity, str, str, str], None],
        publish: Callable[[Iterable[Batch]], None],
    ) -> None:
        self._armed = vehicle.file.telemetry.commands
        self._tell, self._publish = tell, publish
        named = (UPLINK, PAGE) if self._armed else ()
        self._rings = [RingReader(directory / f"{name}.ring") for name in named]
        self._replied = 0

    def step(self, now_ns: int) -> str:
        """Carry out what has come; why the flight is to end, empty if it is not."""
        ends = [self._carry_out(ring.name, row, now_ns) for ring in self._rings for row in ring.read()[0]]
        return next(filter(None, ends), "")

    def _carry_out(self, channel: str, row: np.void, now_ns: int) -> str:
        who, refused = printable(row["who"]), Refusal(row["refused"]) or refusal(row, self._armed)
        said = _in_words(row)
        if refused:
            text = f"{said}, asked by {who}: refused, {refused.name.lower().replace('_', ' ')}"
            self._tell(Severity.WARNING, "order_refused", "operator", text)
        else:
            self._tell(Severity.INFO, Order(row["order"]).name.lower(), "operator", f"{said}, asked by {who}")
        reply = np.zeros(1, ORDER_REPLY)
        reply["sequence"], reply["host_ns"], reply["channel"] = self._replied, now_ns, channel.encode()
        reply["order_sequence"], reply["refused"] = row["sequence"], refused
        self._replied += 1
        self._publish([Batch(REPLY, reply)])
        return f"stop, asked by {who}" if not refused and row["order"] == Order.STOP else ""


def _in_words(row: np.void) -> str:
    if row["order"] == Order.MARK:
        return f"mark {row['number']}"
    if row["order"] == Order.SPAN:
        return f"span of {(int(row['end_ns']) - int(row['begin_ns'])) * 1e-9:.0f} s of the log"
    return "stop" if row["order"] == Order.STOP else "a command that is none"
