"""Serial ports by pyserial. Its SerialException is an OSError already, so the port needs nothing around it."""

import contextlib

import serial

from drivers.errors import UrlError
from drivers.transports.url import BusUrl


def open_port(url: BusUrl) -> serial.Serial:
    """Open the tty of ``url`` for us alone, non-blocking unless it asks for a timeout.

    USB adapters hold bytes back for 16 ms by default; where the driver offers its low-latency mode it is switched on.

    Args:
        url: ``baud``, ``parity`` (N, E, O), ``stop_bits`` (1, 2), ``timeout_s``.

    Raises:
        UrlError: An option has no such value.
        OSError: The tty cannot be opened.
    """
    parity = url.options.get("parity", "N")
    stop_bits = url.integer("stop_bits", 1)
    if parity not in {"N", "E", "O"} or stop_bits not in {1, 2}:
        raise UrlError(f"bus URL {url.text!r}: use parity=N, E or O and stop_bits=1 or 2")
    baud = url.integer("baud")
    timeout_s = url.number("timeout_s", 0.0)
    try:
        port = serial.Serial(url.path, baud, parity=parity, stopbits=stop_bits, timeout=timeout_s, exclusive=True)
    except ValueError as error:
        raise UrlError(f"bus URL {url.text!r}: {error}: choose a rate that the port has") from error
    with contextlib.suppress(ValueError, OSError, NotImplementedError):  # a pty, or a driver without the mode
        port.set_low_latency_mode(True)
    return port
