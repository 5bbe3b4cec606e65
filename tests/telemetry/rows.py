"""Rows of a flight for a downlink: health, estimates, events."""

from typing import Any

import numpy as np

from drivers.records import Batch, Severity, event
from onboard import channels
from onboard.config.telemetry import Telemetry
from onboard.telemetry.downlink import Downlink, FlightIdentity
from onboard.telemetry.packets import Packet
from onboard.telemetry.stream import Splitter

SECOND_NS = 1_000_000_000
START_NS = 50 * SECOND_NS
FLIGHT = FlightIdentity("a1b2", "rocksat", "flight-001.mcap", 1_764_000_000 * SECOND_NS, START_NS)
NAMES = ("m_payload", "c_x_payload", "c_y_payload", "c_z_payload", "I_xx_payload", "I_xy_payload", "I_yy_payload")


def slower(file: str) -> str:
    """A packaged RockSat file whose IMU is sampled at a fifth of its rate, which costs a flight in real time less."""
    for rate, less in (
        ("sample_rate_hz = 1000", "sample_rate_hz = 200"),
        ("poll_period_ms = 10", "poll_period_ms = 50"),
    ):
        file = file.replace(rate, less)
    return file


def health(at_ns: int, **given: Any) -> Batch:
    row = np.zeros(1, channels.HEALTH)
    row["host_ns"], row["temperature_deg_c"] = at_ns, np.nan
    for name, value in given.items():
        row[name] = value
    return Batch("health", row)


def estimates(at_ns: int, names: tuple[str, ...] = NAMES, **given: Any) -> Batch:
    rows = np.zeros(len(names), channels.QUANTITY)
    rows["host_ns"], rows["name"], rows["unit"], rows["supported"] = at_ns, names, b"kg", 1
    rows["value"] = at_ns * 1e-9 + np.arange(len(names))
    rows["low"], rows["high"], rows["sigma"] = rows["value"] - 2.0, rows["value"] + 2.0, 1.0
    rows["low_999"], rows["high_999"] = rows["value"] - 4.0, rows["value"] + 5.0
    for name, value in given.items():
        rows[name] = value
    return Batch("quantity", rows)


def said(at_ns: int, text: str, severity: Severity = Severity.INFO, code: str = "note") -> Batch:
    return event(at_ns, severity, code, "flight", text)


def downlink(now_ns: int = START_NS, **settings: Any) -> Downlink:
    return Downlink(Telemetry(**settings), 7, FLIGHT, now_ns)


def sent(link: Downlink, now_ns: int) -> list[Packet]:
    """What it sends at ``now_ns``."""
    return Splitter(Telemetry().apids).feed(b"".join(link.packets(now_ns)))
