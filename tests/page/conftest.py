"""The short flight as a log, and as one that runs."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from onboard.flight.store import manifest
from onboard.recording.writer import LogWriter
from tests.page.made import FILES, SECOND, START, Rings, flight


@pytest.fixture(scope="session")
def made_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The flight as a log, a chunk every half second."""
    log = tmp_path_factory.mktemp("page") / "made.mcap"
    made = flight()
    with LogWriter.create(log, durable=False) as writer:
        for name, data in FILES.items():
            writer.attach(name, "text/plain", data)
        writer.add_metadata("flight", {"vehicle": "made", "vehicle_file": "vehicle.toml"})
        for batch in made:
            writer.register(batch.channel, batch.rows.dtype)
        for half in range(23):
            for batch in made:
                at_ns = batch.rows["host_ns"]
                first = START + half * SECOND // 2
                writer.write(batch.channel, batch.rows[(at_ns >= first) & (at_ns < first + SECOND // 2)])
            writer.flush()
    return log


@pytest.fixture
def rings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Rings]:
    """A flight that runs as long as the test."""
    monkeypatch.setenv("HEFT_RINGS", str(tmp_path / "rings"))
    log = tmp_path / "made.mcap"
    with manifest.new_flight(log, "made") as directory:
        found = Rings(directory, log)
        found.manifest.save()
        yield found
        for writer in found.writers.values():
            writer.close()
