"""The flight computer's end of each bus of a scenario, in any tier.

A tier is a function from a bus's table to its ``Port``; ``open_ports`` calls it for every bus. The first bus of a kind
uses the seed itself, so adding a second one does not change its random numbers.
"""

from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from typing import Self

from hil_sim.buses.media import Bus
from hil_sim.scenario.bus_tables import BusTable, SerialBusTable


class Port:
    """Base of a bus end: the bus and the URL that opens it.

    Args:
        bus: The bus.
        url: What the flight computer opens.
    """

    def __init__(self, bus: Bus, url: str) -> None:
        self.bus = bus
        self.url = url

    @property
    def files(self) -> list[int]:
        """Descriptors that wake a loop in real time when something is to be read."""
        return []

    @property
    def due_ns(self) -> int:
        """Time of the next event here or on the bus, ns."""
        return self.bus.due_ns

    def receive(self) -> None:
        """Read requests, before the bus advances."""

    def advance(self, now_ns: int) -> None:
        """Deliver what is due, after the bus advanced."""

    def counts(self) -> dict[str, int]:
        """Counters of transfers and losses."""
        return {}

    def close(self) -> None:
        """Close it."""


PortFactory = Callable[[str, BusTable, int, int], Port]
"""A tier: opens a bus by its name, its table, its place among those of its kind, and a seed."""


class Ports:
    """All of them, as a context.

    Attributes:
        buses: By name.
        urls: By name.
    """

    def __init__(self, ports: Mapping[str, Port], close: Callable[[], None]) -> None:
        self.ports = dict(ports)
        self.buses = {name: port.bus for name, port in ports.items()}
        self.urls = {name: port.url for name, port in ports.items()}
        self._close = close

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close all ports."""
        self._close()


def open_ports(tables: Mapping[str, BusTable], open_port: PortFactory, seed: int = 0) -> Ports:
    """Open every bus; if one fails, those already open are closed.

    Args:
        tables: ``[bus.*]`` of a scenario.
        open_port: The tier.
        seed: Of the jitter of all stamps.
    """
    places: Counter[str] = Counter()
    ports: dict[str, Port] = {}
    with ExitStack() as stack:
        for name, table in tables.items():
            place = places[table.kind]
            places[table.kind] += 1
            ports[name] = open_port(name, table, place, seed + (place << 32))
            stack.callback(ports[name].close)
        return Ports(ports, stack.pop_all().close)


def serial_options(table: SerialBusTable) -> str:
    """The options of a serial line's URL."""
    options = f"baud={table.baud_rate}"
    options += f"&parity={table.parity}" if table.parity != "N" else ""
    return options + (f"&stop_bits={table.stop_bits}" if table.stop_bits != 1 else "")
