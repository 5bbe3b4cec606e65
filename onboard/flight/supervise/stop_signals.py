"""Signals that a terminal or a service manager sends to a flight's supervisor."""

import os
import signal
from collections.abc import Callable
from types import FrameType

from drivers.records import Severity
from onboard.flight.supervise.runner_forks import OF_TERMINAL


class StopSignals:
    """SIGINT and SIGTERM ask for an end; SIGHUP, of a terminal that is gone (a lost ssh session), does not.

    Children get those of a terminal too: they ignore them, we tell them.
    """

    def __init__(self) -> None:
        self.seen = self._hung_up = False
        self._before = {number: signal.signal(number, self._note) for number in OF_TERMINAL}

    def _note(self, number: int, frame: FrameType | None) -> None:
        if number == signal.SIGHUP:
            self._hung_up = True
        else:
            self.seen = True

    def tell_hangup(self, tell: Callable[[Severity, str, str, str], None]) -> None:
        """Say that the terminal has gone, if it has since the last call; what is written to it then goes nowhere."""
        if not self._hung_up:
            return
        self._hung_up = False
        for descriptor in (0, 1, 2):
            try:
                os.write(descriptor, b"")
            except OSError:
                os.dup2(os.open(os.devnull, os.O_RDWR), descriptor)
        text = f"the terminal is gone; the flight goes on: kill -TERM {os.getpid()} ends it"
        tell(Severity.WARNING, "hangup", "flight", text)

    def restore(self) -> None:
        """As before."""
        for number, handler in self._before.items():
            signal.signal(number, handler)
