"""Messages to a service manager (``sd_notify``): ready, how the flight stands, and that every worker answers.

Datagrams to ``$NOTIFY_SOCKET``, as systemd documents them; without that variable nothing is sent. With ``WatchdogSec``
in the unit, systemd ends a flight that has not been fed for so long: it is fed twice in that time, and only while every
worker answers.
"""

import contextlib
import os
import socket
from collections.abc import Mapping


class Notifier:
    """Tells the service manager.

    Args:
        environment: of the process.
    """

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        self._path = environment.get("NOTIFY_SOCKET", "")
        watchdog_us = environment.get("WATCHDOG_USEC", "")
        ours = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        self._period_s = 0.5e-6 * int(watchdog_us) if watchdog_us.isdigit() and ours else 0.0
        self._fed_s, self._status = 0.0, ""

    def ready(self) -> None:
        """Every worker is at work."""
        self._send("READY=1")

    def status(self, text: str) -> None:
        """How the flight stands, in one line; it is sent where it has changed."""
        if text != self._status:
            self._status = text
            self._send("STATUS=" + " ".join(text.split()))

    def stopping(self) -> None:
        """The flight is being ended."""
        self._send("STOPPING=1")

    def feed(self, now_s: float, *, answering: bool) -> None:
        """Feed the watchdog if it is due and every worker is ``answering``."""
        if self._period_s and answering and now_s - self._fed_s >= self._period_s:
            self._fed_s = now_s
            self._send("WATCHDOG=1")

    def _send(self, text: str) -> None:
        if not self._path.startswith(("/", "@")):
            return
        address = "\0" + self._path[1:] if self._path.startswith("@") else self._path
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
            sender.setblocking(False)  # the manager may be busy: the flight is not
            sender.sendto(text.encode(), address)
