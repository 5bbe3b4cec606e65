"""Rows of a short flight: every kind of row that the page shows, and texts that are markup; and its rings."""

from pathlib import Path

import numpy as np

from drivers import records
from drivers.records import Batch
from onboard import channels
from onboard.flight.store import manifest
from onboard.recording.format.mcap_format import Attachment
from onboard.recording.segmented import Preamble
from onboard.ring import RingWriter

SECOND = 1_000_000_000
START = 5 * SECOND
MARKUP = b"<img src=x onerror=alert(1)>&amp;</script>"
URDF = (
    b'<robot name="made"><link name="base"/><link name="payload"/><joint name="joint_1" type="revolute">'
    b'<parent link="base"/><child link="payload"/><origin xyz="0 0 1"/><axis xyz="0 1 0"/></joint></robot>'
)
VEHICLE = b'[vehicle]\nname = "made"\npayload_link = "payload"\n'
FILES = {"vehicle.toml": VEHICLE, "made.urdf": URDF}


def _rows(dtype: np.dtype[np.void], at_ns: list[int]) -> np.ndarray:
    rows = np.zeros(len(at_ns), dtype)
    rows["sequence"], rows["host_ns"] = np.arange(len(at_ns)), at_ns
    return rows


def flight() -> list[Batch]:
    """Ten seconds: a device of 100 Hz with a gap, mass and centre that narrow, a health record a second, events."""
    ms = [START + step * 10_000_000 for step in range(1000)]
    joint = _rows(records.SCALAR, ms)
    joint["sequence"][500:] += 7
    joint["value_raw"], joint["scale"], joint["unit"] = np.arange(1000), 1e-3, b"rad"
    gap = _rows(records.GAP, [START + 5 * SECOND])
    gap["channel"], gap["first_missing"], gap["last_missing"] = b"joint_1", 500, 506
    at = [START + step * SECOND // 2 for step in range(20)]
    quantity = _rows(channels.QUANTITY, [t for t in at for _ in range(3)])
    half = np.repeat(1.0 / (1.0 + np.arange(20)), 3)
    quantity["name"] = [b"m_payload", b"c_x_payload", b"zero_" + MARKUP[:20]] * 20
    quantity["unit"] = [b"kg", b"m", b"N"] * 20
    quantity["value"] = np.tile([5.0198378161508, -2.5e-4, 1.0], 20)
    quantity["low"], quantity["high"] = quantity["value"] - half, quantity["value"] + half
    quantity["low_999"], quantity["high_999"] = quantity["value"] - 2.0 * half, quantity["value"] + 3.0 * half
    quantity["level"][:30], quantity["why"][:30] = 1, b"too wide"
    quantity["supported"][6:] = 1
    health = _rows(channels.HEALTH, [START + step * SECOND for step in range(1, 11)])
    health["acquisition_cpu_percent"], health["temperature_deg_c"], health["disk_free_mb"] = 12.5, np.nan, 2048.0
    health["acquisition_pss_mb"] = np.where(np.arange(10) % 5, np.nan, 17.0)
    clock = _rows(channels.CLOCK, [START + SECOND])
    clock["channel"], clock["state"], clock["sigma_ns"] = b"joint_1", 1, 8700.0
    stream = _rows(channels.HEALTH_STREAM, [START + SECOND])
    stream["channel"], stream["nominal_hz"] = b"joint_1", 100.0
    event = _rows(records.EVENT, [START, START + 2 * SECOND, START + 3 * SECOND])
    event["code"], event["source"] = [b"mode", b"phase", b"no_answer"], [b"flight", b"estimation", MARKUP[:31]]
    event["text"], event["severity"] = [b"run: all answered", b"phase <b>1</b>", MARKUP], [0, 0, 1]
    row = _rows(channels.row_dtype(1, 1), ms[::10])
    row["joint_rad"][:, 0] = np.linspace(0.0, 1.0, len(row))
    row["joint_rad"][-3:] = np.nan
    named = {"joint_1": joint, "gap": gap, "quantity": quantity, "health": health, "clock": clock, "row": row}
    return [Batch(name, rows) for name, rows in (named | {"health_stream": stream, "event": event}).items()]


class Rings:
    """A flight's directory with rings, as its workers have it."""

    def __init__(self, directory: Path, log: Path) -> None:
        self.directory, self.log = directory, log
        self.writers = {
            batch.channel: RingWriter(directory / f"{batch.channel}.ring", batch.rows.dtype, 2048) for batch in flight()
        }
        files = tuple(Attachment(name, "text/plain", data, 0) for name, data in FILES.items())
        preamble = Preamble("made", files, {"flight": {"vehicle_file": "vehicle.toml"}})
        self.manifest = manifest.Manifest(directory, log, "made", manifest.Storage(1, 1, 1, 0), preamble)

    def push(self, batches: list[Batch]) -> None:
        for batch in batches:
            self.writers[batch.channel].push(batch.rows)
