"""Tier T0: the flight computer's bus ends in its own process, on a virtual clock.

smbus2 and spidev with their ioctl answered, libgpiod with a chip of two lines, python-can's ``virtual`` interface,
port objects for ``serial.Serial``, and pulse datagrams. Nothing here reads a clock or starts a thread.
"""

from collections.abc import Callable, Mapping
from pathlib import Path

from hil_sim.buses.gpio.pair import PairBus
from hil_sim.buses.i2c_dev import install_i2c
from hil_sim.buses.media import EdgeDatagrams, I2cBus, PulseLine
from hil_sim.buses.network import NetworkBus
from hil_sim.buses.ports import Port, Ports, open_ports, serial_options
from hil_sim.buses.serial_bus import SerialBus
from hil_sim.buses.serial_port import VirtualSerial, install_serial
from hil_sim.buses.spi import SpiBus, install_spi
from hil_sim.buses.tcp_ends import VirtualTcp
from hil_sim.buses.udp_ends import UdpEnd
from hil_sim.scenario import bus_tables


class _I2cPort(Port):
    def __init__(self, path: str, clock: Callable[[], int]) -> None:
        bus = I2cBus()
        self._installed = install_i2c(path, bus, clock)
        super().__init__(bus, f"i2c://{path}")

    def close(self) -> None:
        self._installed.uninstall()


class _PairPort(Port):
    def __init__(self, path: str, clock: Callable[[], int]) -> None:
        from hil_sim.buses.gpio.chip import install_pair  # noqa: PLC0415 - libgpiod, of all that have no such lines

        bus = PairBus()
        self._uninstall = install_pair(path, bus, clock)
        super().__init__(bus, f"gpio-pair://{path}?data=5&clock=6")

    def close(self) -> None:
        self._uninstall()


class _SpiPort(Port):
    def __init__(self, path: Path, clock: Callable[[], int]) -> None:
        second, other = SpiBus(), path.with_suffix(".second")
        bus = SpiBus(second)
        self._installed = [install_spi(path, bus, clock), install_spi(other, second, clock)]
        super().__init__(bus, f"spi://{path}?second={other}")

    def close(self) -> None:
        for uninstall in self._installed:
            uninstall()


class EdgePort(Port):
    """Edges as datagrams to ``path``; used in every tier."""

    def __init__(self, path: Path, seed: int) -> None:
        self._link = EdgeDatagrams(path)
        self._line = PulseLine(self._link, seed)
        super().__init__(self._line, f"gpio+unix://{path}")

    def counts(self) -> dict[str, int]:
        """See ``Port``."""
        return {"edges_seen": self._line.seen, "edges_without_receiver": self._link.lost}

    def close(self) -> None:
        """See ``Port``."""
        self._link.close()


class _SerialPort(Port):
    def __init__(self, path: str, table: bus_tables.SerialBusTable, seed: int) -> None:
        adapter = VirtualSerial(path)
        self._installed = install_serial(adapter)
        bus = SerialBus(adapter, seed, latency_ns=round(table.adapter_latency_ms * 1e6))
        bus.wait_for_looks()
        adapter.look = bus.look
        super().__init__(bus, f"serial://{path}?{serial_options(table)}")

    def close(self) -> None:
        self._installed.uninstall()


class _NetworkPort(Port):
    def __init__(self, table: bus_tables.TcpBusTable | bus_tables.UdpBusTable, host: str) -> None:
        tcp = isinstance(table, bus_tables.TcpBusTable)
        self._host = VirtualTcp(host) if tcp else UdpEnd(host)
        super().__init__(NetworkBus(self._host), f"{table.kind}://{host}:{30004 if tcp else 49152}")

    def close(self) -> None:
        self._host.close()


def in_process(
    tables: Mapping[str, bus_tables.BusTable],
    directory: Path,
    clock: Callable[[], int],
    *,
    name: str = "hil",
    seed: int = 0,
) -> Ports:
    """Open every bus in this process.

    Args:
        tables: ``[bus.*]`` of a scenario.
        directory: Where the flight computer binds its pulse sockets, as ``BUS.sock``.
        clock: The virtual ``CLOCK_MONOTONIC``, ns; read at each I2C transfer.
        name: Distinguishes several in one process.
        seed: Of the jitter of all stamps.
    """

    def open_port(bus: str, table: bus_tables.BusTable, place: int, seed: int) -> Port:
        del place
        match table:
            case bus_tables.I2cBusTable() | bus_tables.SpiBusTable():
                spi = table.kind == "spi"
                return (
                    _SpiPort(directory / f"{bus}.spidev", clock) if spi else _I2cPort(f"/dev/i2c-{name}-{bus}", clock)
                )
            case bus_tables.PairBusTable():
                return _PairPort(f"/dev/gpiochip-{name}-{bus}", clock)
            case bus_tables.CanBusTable():
                from hil_sim.buses.can.virtual import VirtualCanPort  # noqa: PLC0415 - python-can takes 0.05 s

                return VirtualCanPort(f"{name}_{bus}", table.bit_rate, seed)
            case bus_tables.PulseLineTable():
                return EdgePort(directory / f"{bus}.sock", seed)
            case bus_tables.SerialBusTable():
                return _SerialPort(f"/dev/hil-{name}-{bus}", table, seed)
            case bus_tables.TcpBusTable() | bus_tables.UdpBusTable():
                return _NetworkPort(table, f"hil-{name}-{bus}")

    return open_ports(tables, open_port, seed)
