"""Opens serial ports with pyserial. Its SerialException is an OSError, so no wrapper is needed."""

import contextlib

import serial
from serial.tools import list_ports

from drivers.errors import UrlError
from drivers.ports import SerialAdapter
from drivers.transports.url import BusUrl


def open_port(url: BusUrl) -> serial.Serial:
    """Open the tty of ``url`` exclusively, non-blocking unless a timeout is given.

    USB adapters delay bytes by up to 16 ms by default; the low-latency mode is switched on where the driver offers it.

    Args:
        url: ``baud``, ``parity`` (N, E, O), ``stop_bits`` (1, 2), ``timeout_s``.

    Raises:
        UrlError: An option has no such value.
        OSError: The tty cannot be opened.
    """
    parity = url.options.get("parity", "N")
    stop_bits = url.integer("stop_bits", 1)
    baud = url.integer("baud")
    timeout_s = url.number("timeout_s", 0.0)
    try:
        port = serial.Serial(url.path, baud, parity=parity, stopbits=stop_bits, timeout=timeout_s, exclusive=True)
    except ValueError as error:
        raise UrlError(f"bus URL {url.text!r}: {error}: choose a rate that the port has") from error
    with contextlib.suppress(ValueError, OSError, NotImplementedError):  # a pty, or a driver without the mode
        port.set_low_latency_mode(True)
    return port


def adapters() -> list[SerialAdapter]:
    """See ``drivers.transports.serial_adapters``."""
    ports = sorted(list_ports.comports(include_links=True), key=lambda port: str(port.device))
    return [SerialAdapter(f"serial://{port.device}?baud=115200", port.description) for port in ports]
