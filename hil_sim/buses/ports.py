"""The flight computer's end of each bus of a scenario, whatever tier it is in.

A tier is a function from a bus's table to its ``Port``; ``open_ports`` asks it for every bus. The random numbers of the
first bus of a kind are drawn from the seed itself, so a second one beside it changes nothing.
"""

from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from types import TracebackType
from typing import Self

from hil_sim.buses.media import Bus
from hil_sim.scenario.device_tables import BusTable, SerialBusTable


class Port:
    """One end: the bus behind it, and how to open it from the other side. Subclasses have the rest.

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
        """When something next happens here or on the bus."""
        return self.bus.due_ns

    def receive(self) -> None:
        """Take in what was asked, before the bus goes on."""

    def advance(self, now_ns: int) -> None:
        """Hand out what is due, after the bus went on."""

    def counts(self) -> dict[str, int]:
        """What it did and lost."""
        return {}

    def close(self) -> None:
        """Unplug it."""


OpenPort = Callable[[str, BusTable, int, int], Port]
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

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Unplug everything."""
        self._close()


def open_ports(tables: Mapping[str, BusTable], open_port: OpenPort, seed: int = 0) -> Ports:
    """Open every bus; when one cannot be opened, those before it are closed again.

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
