"""A recorded flight as the packets that its downlink would have sent."""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, NamedTuple

from onboard.telemetry.downlink import Downlink, FlightIdentity, TelemetrySettings

if TYPE_CHECKING:  # the process that sends reads no log
    from onboard.config.telemetry import Telemetry
    from onboard.recording.reader import LogReader

STEP_NS = 50_000_000
END_NS = 2_000_000_000  # after the last row: what waits is sent


class Sent(NamedTuple):
    """A packet and when it was sent, host time of the log."""

    at_ns: int
    packet: bytes


def flight_of(metadata: Mapping[str, Mapping[str, str]], flight: str, log: str) -> FlightIdentity:
    """Which flight it is, by a log's metadata; without a wall clock (virtual time) its time is that since 1970."""
    facts = metadata.get("flight", {})
    wall, monotonic = (int(facts.get(f"{name}_ns", "0")) for name in ("wall_clock", "monotonic"))
    return FlightIdentity(flight, facts.get("vehicle", ""), log, wall, monotonic)


def packets_of(log: "LogReader", settings: "Telemetry", session: int = 0) -> Iterator[Sent]:
    """Packets of a log, by its own time, which is not waited for.

    Args:
        log: of a flight.
        settings: APIDs, rates and budget.
        session: of the packets.
    """
    downlink: Downlink | None = None
    now_ns = 0
    for batch in log.batches():
        if not len(batch.rows):
            continue
        at_ns = int(batch.rows["host_ns"][0])
        if downlink is None:
            flight = flight_of(log.metadata, log.metadata.get("flight", {}).get("flight", ""), log.path.name)
            downlink, now_ns = Downlink(TelemetrySettings.of(settings), session, flight, at_ns), at_ns
        while at_ns >= now_ns + STEP_NS:
            now_ns += STEP_NS
            yield from (Sent(now_ns, packet) for packet in downlink.packets(now_ns))
        downlink.add(batch)
    if downlink is not None:
        for at_ns in range(now_ns + STEP_NS, now_ns + END_NS, STEP_NS):
            yield from (Sent(at_ns, packet) for packet in downlink.packets(at_ns))
