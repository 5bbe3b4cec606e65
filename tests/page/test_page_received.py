"""The page of a downlink: its numbers are those that were sent, and of what does not come it says so."""

import json
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from onboard import cli
from onboard.config.telemetry import Telemetry
from onboard.page.follow import LogFrames
from onboard.page.received import PacketFile, Received
from onboard.telemetry.downlink import Downlink, FlightIdentity
from onboard.telemetry.link import LinkError, parse
from tests.page.browser import Tab, opened
from tests.page.served import Stream, served
from tests.telemetry.rows import FLIGHT, NAMES, SECOND_NS, START_NS, downlink, estimates, health, said

APIDS = Telemetry().apids


class Sender:
    """A flight's downlink to a UDP port, a second at a time."""

    def __init__(self, port: int, sender: Downlink | None = None) -> None:
        self._to, self._socket = ("127.0.0.1", port), socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.downlink, self.now_ns = sender or downlink(), START_NS

    def second(self, *, lost: Callable[[int], bool] = lambda number: False, **status: int) -> None:
        """Rows and packets of one; ``lost``: numbers of packets that do not come."""
        self.downlink.add(health(self.now_ns, rows=1000, **status))
        self.downlink.add(estimates(self.now_ns, why=b""))
        for step in range(20):
            for number, packet in enumerate(self.downlink.packets(self.now_ns + step * SECOND_NS // 20)):
                if not lost(number):
                    self.send(packet)
        self.now_ns += SECOND_NS

    def send(self, packet: bytes) -> None:
        self._socket.sendto(packet, self._to)

    def close(self) -> None:
        self._socket.close()


def until(met: Callable[[], Any]) -> None:
    deadline = time.monotonic() + 20
    while not met():
        assert time.monotonic() < deadline
        time.sleep(0.05)


class Ground:
    """The receiving end, and a clock that is set."""

    def __init__(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_port:
            any_port.bind(("127.0.0.1", 0))
            self.port = int(any_port.getsockname()[1])
        self.now_s = 100.0
        self.source = Received(parse(f"udp://127.0.0.1:{self.port}"), APIDS, "", lambda: self.now_s)

    def until(self, met: Callable[[dict[str, Any]], Any]) -> dict[str, Any]:
        """The first frame of which it is true."""
        deadline = time.monotonic() + 20
        while True:
            self.source.look()
            frame = self.source.frame_now(0)
            if met(frame):
                return frame
            assert time.monotonic() < deadline, frame
            time.sleep(0.01)


@pytest.fixture
def ground() -> Iterator[Ground]:
    found = Ground()
    yield found
    found.source.close()


@pytest.fixture
def sender(ground: Ground) -> Iterator[Sender]:
    found = Sender(ground.port)
    yield found
    found.close()


def reasons(frame: dict[str, Any]) -> list[str]:
    return [f"{one['kind']}: {one['text']}" for one in frame["go"]["reasons"]]


def test_what_came_down_is_shown_to_single_precision(ground: Ground, sender: Sender) -> None:
    assert "no flight is known yet" in ground.until(lambda frame: True)["title"]
    sender.downlink.add(said(START_NS, "run: all answered", code="mode"))
    sender.downlink.add(said(START_NS, "phase 2 begins", code="phase"))
    for _ in range(3):
        sender.second()
    shown = ground.until(lambda frame: len(frame["held"]) == len(NAMES) and frame["t"] >= 2)
    assert (shown["title"], shown["mode"], shown["phase"]) == ("rocksat: flight-001.mcap", "run", "phase 2")
    assert shown["go"]["word"] == "GO", shown["go"]
    for number, answer in enumerate(shown["held"]):
        values = [round(at_s + number, 3) for at_s in (50.0, 51.0, 52.0)]
        assert round(answer["value"], 3) in values
        assert answer["high"] - answer["value"] == pytest.approx(2.0, abs=1e-5)
        assert answer["high_999"] - answer["value"] == pytest.approx(5.0, abs=1e-5)
    assert shown["computer"]["disk_free_mb"] == 0.0
    assert shown["computer"]["temperature_deg_c"] is None
    assert shown["processes"] == shown["devices"] == []
    assert [event["text"] for event in ground.source.state.events()] == ["run: all answered", "phase 2 begins"]
    assert set(ground.source.about()["history"]) == set(NAMES)


def test_silence_lost_packets_and_health_that_is_not_known_are_said(ground: Ground, sender: Sender) -> None:
    sender.second()
    sender.second()
    assert ground.until(lambda frame: frame["t"] >= 1)["go"]["word"] == "GO"
    ground.now_s += 30.0
    silent = ground.until(lambda frame: True)
    assert silent["go"]["word"] == "NO-GO"
    assert "against: nothing has come over the link for 30 s" in reasons(silent)
    for _ in range(3):
        sender.second(lost=lambda number: number == 1)
    again = ground.until(lambda frame: frame["t"] >= 4)
    assert again["go"]["word"] == "GO"
    assert any(" packets did not come, 0 bytes belong" in text for text in reasons(again))
    sender.now_ns += 10 * SECOND_NS  # no health record for so long
    for packet in sender.downlink.packets(sender.now_ns):
        sender.send(packet)
    unknown = ground.until(lambda frame: frame["t"] >= 14)
    assert unknown["go"]["word"] == "NO-GO"
    assert any("health is not known" in text for text in reasons(unknown))


def test_silence_after_a_flight_that_has_stopped_is_no_fault(ground: Ground, sender: Sender) -> None:
    sender.second()
    sender.downlink.add(said(sender.now_ns, "stopped: the flight ends", code="mode"))
    sender.now_ns += 10 * SECOND_NS
    for packet in sender.downlink.packets(sender.now_ns):
        sender.send(packet)
    over = ground.until(lambda frame: frame["t"] >= 10)
    ground.now_s += 30.0
    for frame in (over, ground.until(lambda frame: True)):
        assert frame["mode"] == "stopped"
        assert frame["go"]["word"] == "GO", frame["go"]
        assert any("note: health is not known" in text for text in reasons(frame))
    assert "note: nothing has come over the link for 30 s" in reasons(frame)


def test_a_status_that_does_not_come_is_no_go(ground: Ground, sender: Sender) -> None:
    sender.second()
    ground.until(lambda frame: frame["computer"])
    for _ in range(6):
        sender.second(lost=lambda number: number == 0)
    late = ground.until(lambda frame: frame["t"] >= 4)
    assert late["go"]["word"] == "NO-GO"
    assert any("no status came down" in text for text in reasons(late)), late["go"]


def test_a_span_sent_once_more_changes_no_number_and_says_no_event_twice(ground: Ground, sender: Sender) -> None:
    early, event = estimates(START_NS), said(START_NS, "it began")
    sender.downlink.add(event)
    for _ in range(4):
        sender.second()
    before = ground.until(lambda frame: frame["t"] >= 3 and frame["event_count"])["held"]
    sender.downlink.repeat([*early.rows, *event.rows])
    for _ in range(6):
        sender.second()
    after = ground.until(lambda frame: frame["t"] >= 9)
    assert not sender.downlink.repeating
    assert all(new["value"] >= old["value"] for new, old in zip(after["held"], before, strict=True))
    assert after["event_count"] == 1


def test_another_flight_takes_its_place(ground: Ground, sender: Sender) -> None:
    sender.second()
    ground.until(lambda frame: frame["held"])
    other = FlightIdentity("c3d4", "rocksat", "flight-002.mcap", FLIGHT.wall_clock_ns + 3600 * SECOND_NS, START_NS)
    next_one = Sender(ground.port, Downlink(Telemetry(), 8, other, START_NS))
    next_one.second()
    shown = ground.until(lambda frame: "002" in frame["title"])
    assert shown["t"] < 5
    next_one.close()


def file_of(path: Path, *, wrong_share: float = 0.0, rng: np.random.Generator | None = None) -> dict[str, set[float]]:
    """A minute of packets, with bit errors; values that were sent, by quantity."""
    sender, data = downlink(), b""
    values: dict[str, set[float]] = {name: set() for name in NAMES}
    for step in range(60):
        now_ns = START_NS + step * SECOND_NS
        sender.add(health(now_ns))
        rows = estimates(now_ns)
        for row in rows.rows:
            values[row["name"].decode()].add(float(np.float32(row["value"])))
        sender.add(rows)
        for part in range(20):
            data += b"".join(sender.packets(now_ns + part * SECOND_NS // 20))
    if rng is not None:
        bits = np.unpackbits(np.frombuffer(data, np.uint8))
        data = np.packbits(bits ^ (rng.random(len(bits)) < wrong_share)).tobytes()
    path.write_bytes(data)
    return values


def test_no_wrong_number_of_a_file_with_bit_errors(tmp_path: Path, rng: np.random.Generator) -> None:
    path = tmp_path / "down.bin"
    sent = file_of(path, wrong_share=1e-4, rng=rng)
    file = PacketFile(path, APIDS)
    recorded = LogFrames(file)
    frames = [json.loads(recorded.frame(number)) for number in range(len(recorded))]
    shown = [(one["name"], one["value"]) for frame in frames for one in frame["held"]]
    assert len(shown) > 300
    assert all(value in sent[name] for name, value in shown)
    assert not file.is_whole
    assert any("belong to no whole packet" in text for text in reasons(frames[-1]))


def test_a_file_has_a_slider_and_a_go(tmp_path: Path, tab: Tab) -> None:
    path = tmp_path / "down.bin"
    file_of(path)
    file = PacketFile(path, APIDS)
    recorded = LogFrames(file)
    assert file.is_whole
    with opened(tab, recorded):
        tab.wait("document.querySelector('#word').textContent === 'GO'")
        assert tab.text("#title").replace("\u200b", "") == "rocksat: down.bin"
        assert tab.run("document.querySelectorAll('#held [data-name]').length") == len(NAMES)
        assert tab.run("+document.querySelector('#slider').max") == len(recorded) - 1


@pytest.mark.parametrize(("size", "scheme"), [((1280, 800), "light"), ((390, 844), "dark")])
def test_in_a_browser_it_goes_red_when_nothing_comes(
    size: tuple[int, int], scheme: str, ground: Ground, sender: Sender, tab: Tab, tmp_path: Path
) -> None:
    tab.screen(*size, scheme)
    for _ in range(3):
        sender.second()
    ground.until(lambda frame: frame["t"] >= 2)
    with served(ground.source) as one:
        tab.open(f"http://127.0.0.1:{one.port}/")
        tab.wait("document.querySelector('#title').textContent.includes('001')")
        for silent_s, word in ((0.0, "GO"), (30.0, "NO-GO")):
            ground.now_s += silent_s
            frame = ground.until(lambda frame: True) | {"skipped": 0, "events": []}

            def shown(frame: dict[str, Any] = frame, word: str = word) -> bool:
                one.send(frame)
                return bool(tab.run("document.querySelector('#word').textContent") == word)

            until(shown)
            tab.shot(tmp_path / f"{scheme}-{word}.png")
        assert "nothing has come over the link for 30 s" in tab.text("#reasons")
        assert not tab.run("document.querySelector('#devices').closest('table').offsetHeight")  # no empty table
        assert tab.run("document.documentElement.scrollWidth") <= size[0]


def test_links_that_cannot_be(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(LinkError):
        parse("udp://nowhere")
    assert cli.main(["watch", "serial:///dev/nowhere?baud=9600", "--page"]) == cli.BAD_INPUT
    assert "/dev/nowhere" in capsys.readouterr().err
    assert cli.main(["telemetry", "--page", "--xtce", "x"]) == cli.BAD_INPUT
    assert "add --decode" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["watch", "telemetry --decode"])
def test_the_command_serves_what_comes(command: str) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_port:
        any_port.bind(("127.0.0.1", 0))
        port = int(any_port.getsockname()[1])
    arguments = [*command.split(), f"udp://127.0.0.1:{port}", "--page-address", "127.0.0.1:0"]
    with subprocess.Popen(
        [sys.executable, "-m", "onboard.cli", *arguments], stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stderr is not None
        at = int(process.stderr.readline().rstrip("/\n").rpartition(":")[2])
        sender = Sender(port)
        stream = Stream(at)
        for _ in range(40):
            sender.second()
            if stream.frame()["title"].startswith("rocksat"):
                break
        frame = stream.frame()
        assert frame["title"] == "rocksat: flight-001.mcap"
        assert {one["name"] for one in frame["held"]} <= set(NAMES)
        stream.close()
        sender.close()
        process.send_signal(2)
        assert process.wait(20) == cli.OK
