"""The short flight as a log, and as one that runs; and a browser to look at it."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from onboard.flight.store import manifest
from onboard.recording.writer import LogWriter
from tests.page.browser import BROWSER, Tab, browser
from tests.page.made import FILES, SECOND, START, Rings, flight


@pytest.fixture(scope="session")
def made_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The flight as a log, a chunk every half second, in which the device's rows end 0.2 s before the others."""
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
                first = START + half * SECOND // 2 - (batch.channel == "joint_1") * SECOND // 5
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


@pytest.fixture(scope="session")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tab]:
    """The browser's one tab."""
    if BROWSER is None:
        pytest.skip("no browser to look with: apt install chromium")
    with browser(tmp_path_factory.mktemp("profile")) as found:
        yield found


@pytest.fixture
def tab(chromium: Tab) -> Iterator[Tab]:
    """No error in the console; of a server that has ended the browser itself tells there (``net::``)."""
    chromium.said.clear()
    chromium.screen(1280, 800)
    yield chromium
    chromium.run("1")
    assert [said for said in chromium.said if "net::ERR_" not in str(said)] == []
    chromium.open("about:blank")
