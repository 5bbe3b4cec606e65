"""Opens buses by URL. The only package that imports smbus2, can, serial and gpiod and that stamps arrivals.

A port transfers bytes, stamps them with the given clock and turns its library's exceptions into OSError; it makes no
decisions. Bus libraries are imported when a port is opened.
"""

import time
from collections.abc import Callable

from drivers.errors import UrlError
from drivers.ports import CanPort, ClockedPort, I2cPort, PulseOutputPort, PulsePort, SerialAdapter, SerialPort, SpiPort
from drivers.transports.url import BusUrl, parse

Clock = Callable[[], int]

I2C_URLS = {"i2c": ("path",), "i2c+unix": ("path", "timeout_s")}
SPI_URLS = {"spi": ("path", "speed", "second"), "spi+unix": ("path", "second")}
CAN_URLS = {
    "can+socketcan": ("host", "bitrate", "receive_buffer"),
    "can+virtual": ("host", "timestamps"),
    "can+slcan": ("path", "bitrate", "baud"),
    "can+python": ("path", "bitrate"),
}
PULSE_URLS = {"gpio": ("path", "line"), "pps": ("path",), "gpio+unix": ("path",)}
PAIR_URLS = {"gpio-pair": ("path", "data", "clock"), "gpio-pair+unix": ("path",)}
PULSE_OUTPUT_URLS = {"gpio-out": ("path", "line"), "gpio-out+unix": ("path",)}
SERIAL_URLS = {"serial": ("path", "baud", "parity", "stop_bits", "timeout_s")}


def open_i2c(url: str, clock: Clock) -> I2cPort:
    """Open an I2C bus.

    Args:
        url: ``i2c:///dev/i2c-1`` (kernel node) or ``i2c+unix:///path.sock`` (stream socket; ``timeout_s=1``).
        clock: CLOCK_MONOTONIC, ns.

    Raises:
        UrlError: The URL is not one of these.
        OSError: The node or socket cannot be opened.
    """
    bus = parse(url, I2C_URLS)
    if bus.kind == "i2c":
        from drivers.transports.i2c import SmbusPort  # noqa: PLC0415 - smbus2 only where it is used

        return SmbusPort(bus.path, clock)
    from drivers.transports.i2c_unix import UnixI2cPort  # noqa: PLC0415

    return UnixI2cPort(bus.path, clock, bus.number("timeout_s", 1.0))


def open_spi(url: str, clock: Clock, mode: int, *, second: bool = False) -> SpiPort:
    """Open an SPI master with one chip's select line. A node that went is opened again when it is back.

    Args:
        url: ``spi:///dev/spidev0.0`` (kernel node; ``speed=1000000`` Hz), or ``spi+unix:///path.sock`` (a simulator's).
        clock: CLOCK_MONOTONIC, ns.
        mode: CPOL x 2 + CPHA, of the chip.
        second: The node of a chip's second select line, ``second=/dev/spidev0.1`` of either URL.

    Raises:
        UrlError: The URL is not one of these.
        OSError: The node cannot be opened.
    """
    bus = parse(url, SPI_URLS)
    if second and "second" not in bus.options:
        raise UrlError(f"bus URL {url!r} has one select line: add '?second=/dev/spidev0.1'")
    path = bus.options["second"] if second else bus.path
    from drivers.transports.spi import ReopeningSpi, SpidevPort, UnixSpi  # noqa: PLC0415

    if bus.kind == "spi+unix":
        return UnixSpi(path, clock)
    speed_hz = bus.integer("speed", 1_000_000)
    return ReopeningSpi(lambda: SpidevPort(path, clock, mode, speed_hz), clock)


def open_can(url: str, clock: Clock) -> CanPort:
    """Open a CAN bus. The port opens it again when its adapter or interface went and came back.

    Args:
        url: ``can+socketcan://can0?bitrate=500000`` (the bit rate is what ``ip link`` was given; it is not set here;
            ``receive_buffer=4194304`` bytes are asked of the kernel), ``can+virtual://NAME?timestamps=monotonic``
            (python-can's in-process bus; without ``timestamps`` its stamps are the wall clock's),
            ``can+slcan:///dev/ttyACM0?bitrate=500000`` (ASCII adapter on a tty; ``baud=115200``), or
            ``can+python:///pcan/PCAN_USBBUS1?bitrate=500000`` (any interface and channel that python-can knows).
        clock: CLOCK_MONOTONIC, ns.

    Raises:
        UrlError: The URL is not one of these.
        OSError: The interface or tty cannot be opened.
    """
    from drivers.transports.can.can_reopen import ReopeningCanPort  # noqa: PLC0415

    return ReopeningCanPort(lambda: _can(parse(url, CAN_URLS), clock), clock)


def _can(bus: BusUrl, clock: Clock) -> CanPort:
    if bus.kind == "can+socketcan":
        from drivers.transports.can.can_socket import SocketcanPort  # noqa: PLC0415

        return SocketcanPort.open(bus.host, clock, bus.integer("receive_buffer", 4 << 20))
    if bus.kind in {"can+virtual", "can+python"}:
        from drivers.transports.can.can_library import LibraryCanPort  # noqa: PLC0415 - python-can takes 0.1 s

        return LibraryCanPort.open(bus, clock)
    from drivers.transports.can.can_slcan import SlcanPort  # noqa: PLC0415

    return SlcanPort.open(bus, clock)


def open_pulse(url: str, clock: Clock) -> PulsePort:
    """Open the sync line. A GPIO line or PPS source that went is opened again when it is back.

    Args:
        url: ``gpio:///dev/gpiochip0?line=17`` (rising edges, stamped by the kernel with CLOCK_MONOTONIC),
            ``pps:///dev/pps0`` (assert edges of a PPS source), or ``gpio+unix:///path.sock`` (edges as datagrams
            ``<qI``: edge ns, line sequence; bound here).
        clock: CLOCK_MONOTONIC, ns.

    Raises:
        UrlError: The URL is not one of these.
        OSError: The line or socket cannot be opened.
    """
    from drivers.transports.gpio_reopen import ReopeningPulsePort  # noqa: PLC0415

    bus = parse(url, PULSE_URLS)
    if bus.kind == "gpio":
        from drivers.transports.gpio import GpiodPort  # noqa: PLC0415

        line = bus.integer("line")
        return ReopeningPulsePort(lambda: GpiodPort.open(bus.path, line, clock), clock)
    if bus.kind == "pps":
        from drivers.transports.pps import PpsPort  # noqa: PLC0415

        return ReopeningPulsePort(lambda: PpsPort(bus.path, clock), clock)
    from drivers.transports.gpio_unix import UnixPulsePort  # noqa: PLC0415

    return UnixPulsePort(bus.path, clock)


def open_pulse_output(url: str, clock: Clock) -> PulseOutputPort:
    """Open the line that drives the sync line. A GPIO line that went is opened again when it is back.

    Args:
        url: ``gpio-out:///dev/gpiochip0?line=27``, or ``gpio-out+unix:///path.sock`` (rising edges as datagrams
            ``<qI``: edge ns, line sequence; to a socket that is bound there).
        clock: CLOCK_MONOTONIC, ns.

    Raises:
        UrlError: The URL is not one of these.
        OSError: The line cannot be opened.
    """
    bus = parse(url, PULSE_OUTPUT_URLS)
    if bus.kind == "gpio-out+unix":
        from drivers.transports.gpio_unix import UnixPulseOutput  # noqa: PLC0415

        return UnixPulseOutput(bus.path, clock)
    line = bus.integer("line")
    from drivers.transports.gpio import GpiodOutput  # noqa: PLC0415
    from drivers.transports.gpio_reopen import ReopeningPulseOutput  # noqa: PLC0415

    return ReopeningPulseOutput(lambda: GpiodOutput.open(bus.path, line, clock), clock)


def open_pair(url: str, clock: Clock) -> ClockedPort:
    """Open a clock line and a data line. A GPIO chip that went is opened again when it is back.

    Args:
        url: ``gpio-pair:///dev/gpiochip0?data=5&clock=6``, or ``gpio-pair+unix:///path.sock`` (a simulator's).
        clock: CLOCK_MONOTONIC, ns.

    Raises:
        UrlError: The URL is not one of these.
        OSError: The lines cannot be opened.
    """
    bus = parse(url, PAIR_URLS)
    from drivers.transports.gpio_pair import GpiodPair, ReopeningPair, UnixPair  # noqa: PLC0415

    if bus.kind == "gpio-pair+unix":
        return UnixPair(bus.path, clock)
    data, clock_line = bus.integer("data"), bus.integer("clock")
    if data == clock_line:
        raise UrlError(f"bus URL {url!r} has the same line for both: correct data or clock")
    return ReopeningPair(lambda: GpiodPair.open(bus.path, data, clock_line, clock), clock)


def rest(seconds: float) -> None:
    """Wait, while nothing has to be read."""
    time.sleep(seconds)


def open_serial(url: str) -> SerialPort:
    """Open a serial port.

    Args:
        url: ``serial:///dev/ttyUSB0?baud=115200``; options ``parity`` (N, E, O), ``stop_bits`` (1, 2) and
            ``timeout_s`` (how long a read waits for its first byte; default 0: no wait).

    Raises:
        UrlError: The URL is not of this form.
        OSError: The port cannot be opened (``serial.SerialException`` is one).
    """
    bus = parse(url, SERIAL_URLS)
    from drivers.transports.serial_port import open_port  # noqa: PLC0415

    return open_port(bus)


def serial_adapters() -> list[SerialAdapter]:
    """Serial ports of this computer, links of udev that keep their names included; none is opened."""
    from drivers.transports.serial_port import adapters  # noqa: PLC0415

    return adapters()
