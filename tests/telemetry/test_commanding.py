"""Commands of a flight that goes on: what is asked is done, reported and logged; what is not armed is not done."""

import re
import socket
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.records import EVENT
from onboard import cli
from onboard.channels import ORDER, Order, Refusal
from onboard.config.telemetry import Telemetry
from onboard.recording.format.texts import printable
from onboard.recording.reader import LogReader
from onboard.telemetry import span
from onboard.telemetry.commander import parse
from onboard.telemetry.packets import Packet
from onboard.telemetry.stream import Splitter
from onboard.telemetry.uplink import telecommand
from tests.flight.missions import Result, inline, sweep
from tests.telemetry.rows import slower

pytestmark = [pytest.mark.realtime, pytest.mark.usefixtures("own_rings")]
LONG = [
    {"phase": 0, "action": "hold", "duration_s": 4.0},
    sweep(6, 0.6),
    {"phase": 0, "action": "hold", "duration_s": 200.0},
]


class Flight:
    """``heft hil --realtime`` of a RockSat whose file arms ``commands``, its packets, and a way to command it."""

    def __init__(self, directory: Path, commands: str) -> None:
        assert cli.main(["init", str(directory / "mine"), "--from", "rocksat"]) == cli.OK
        self.vehicle = directory / "mine/vehicle.toml"
        text = slower(self.vehicle.read_text())
        self.vehicle.write_text(f"{text}\n[telemetry]\nbytes_s = 20000\nanswers_hz = 2\ncommands = {commands}\n")
        self.log, over = directory / "flight.mcap", directory / "over.toml"
        over.write_text(f"sequence = [{', '.join(map(inline, LONG))}]\n")
        self.ground = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.ground.bind(("127.0.0.1", 0))
        self.ground.settimeout(0.2)
        self.port = self.ground.getsockname()[1]
        self.packets: list[Packet] = []
        self.origin: Any = None
        self._stream, self._over = Splitter(Telemetry().apids), threading.Event()
        given = ["--scenario", str(over), "--realtime", "--log", str(self.log)]
        link = f"udp://127.0.0.1:{self.port}"
        command = [sys.executable, "-m", "onboard.cli", "hil", str(self.vehicle), *given, "--telemetry", link]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()

    def _listen(self) -> None:
        while not self._over.is_set():
            try:
                data, self.origin = self.ground.recvfrom(4096)
            except (TimeoutError, OSError):
                continue
            self.packets += self._stream.feed(data)

    def tell(self, data: bytes) -> None:
        self.ground.sendto(data, self.origin)

    def wait(self, met: Any, seconds: float = 90.0) -> Any:
        deadline = time.monotonic() + seconds
        while not (found := met()):
            assert time.monotonic() < deadline, Counter(packet.kind.name for packet in self.packets)
            assert self.process.poll() is None or self.reports(), self.process.communicate()
            time.sleep(0.05)
        return found

    def of(self, *kinds: str) -> list[Packet]:
        return [packet for packet in self.packets if packet.kind.name in kinds]

    def reports(self) -> list[tuple[int, int, str]]:
        """Sequence count of the command, subtype, why it was refused."""
        told = [packet.values for packet in self.of("report", "failure")]
        return [(one["sequence_control"] & 0x3FFF, one["subtype"], one.get("code", "")) for one in told]

    def leave(self) -> str:
        """Give the port up; what the command line is given for it."""
        self._over.set()
        self._listener.join()
        self.ground.close()
        return f"udp://127.0.0.1:{self.port}"

    def end(self) -> None:
        if self.process.poll() is None:
            self.process.terminate()
        self.process.communicate()
        self.leave()


@pytest.fixture
def flight(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Flight]:
    flown = Flight(tmp_path, request.param)
    try:
        yield flown
    finally:
        flown.end()


def is_running(flight: Flight) -> bool:
    return bool(flight.of("status")) and flight.of("status")[-1].values["mode"] in ("armed", "run")


@pytest.mark.timeout(300)
@pytest.mark.parametrize("flight", ['["mark", "stop", "span"]'], indirect=True)
def test_what_is_asked_is_done_told_and_logged(flight: Flight, capsys: pytest.CaptureFixture[str]) -> None:
    flight.wait(lambda: is_running(flight) and len(flight.of("answer")) > 10)
    session, start_s = flight.packets[-1].session, time.time()

    def ask(order: Order, count: int, *arguments: int, session: int = session) -> None:
        flight.tell(telecommand(order, 264, session, count, 9, *arguments))

    ask(Order.MARK, 1, 42)
    ask(Order.MARK, 1, 43)  # the same count
    ask(Order.MARK, 2, 44, session=session ^ 1)
    flight.tell(telecommand(Order.STOP, 264, session, 3, 9)[:-1] + b"\0")  # damaged
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:  # of another host: 127.0.0.2
        stranger.bind(("127.0.0.2", 0))
        stranger.sendto(telecommand(Order.STOP, 264, session, 4, 9), flight.origin)
    flight.wait(lambda: len(flight.reports()) >= 4)
    assert sorted(flight.reports()) == [(1, 1, ""), (1, 2, "duplicate"), (1, 7, ""), (2, 2, "other session")]
    flight.wait(lambda: sum(one.at_ns > start_s * 1e9 for one in flight.of("answer")) > 20)  # a busy computer is late
    time.sleep(2.0)
    before, end_s = len(flight.of("answer")), int(time.time()) - 1
    ask(Order.SPAN, 5, int(start_s), end_s)
    ask(Order.SPAN, 6, end_s, int(start_s))
    flight.wait(lambda: (5, 7, "") in flight.reports() and (6, 2, "out of range") in flight.reports())
    assert [report for report in flight.reports() if report[0] == 5] == [(5, 1, ""), (5, 3, ""), (5, 7, "")]
    again = [one for one in flight.of("answer")[before:] if int(start_s) * 10**9 <= one.at_ns < end_s * 10**9]
    assert len(again) > 3
    marks = [one for one in flight.of("event") if one.values["code"] == "mark"]
    assert len(marks) == 2  # once, and once more
    assert marks[0].values == marks[1].values
    assert flight.process.poll() is None
    link = flight.leave()
    assert cli.main(["telemetry", "--decode", link, "--command", "stop", "--source", "5"]) == cli.OK
    assert "of source 5: completed" in capsys.readouterr().out
    flight.process.communicate(timeout=60)
    log = LogReader(flight.log)
    orders = log.read("order_uplink")
    assert orders.dtype == ORDER
    assert [(Order(row["order"]).name, Refusal(row["refused"]).name) for row in orders] == [
        ("MARK", "NONE"),
        ("MARK", "DUPLICATE"),
        ("MARK", "OTHER_SESSION"),
        ("SPAN", "NONE"),
        ("SPAN", "OUT_OF_RANGE"),
        ("STOP", "NONE"),
    ]
    assert int(orders["number"][0]) == 42
    told = {
        (printable(row["code"]), printable(row["text"]))
        for b in log.batches()
        if b.rows.dtype == EVENT
        for row in b.rows
    }
    assert ("mark", "mark 42, asked by source 9, count 1, of 127.0.0.1") in told
    assert ("order_refused", "mark 0, asked by source 9, count 1, of 127.0.0.1: refused, duplicate") in told
    [stop] = [text for code, text in told if code == "stop"]
    assert re.fullmatch(r"stop, asked by source 5, count \d+, of 127\.0\.0\.1", stop)
    [safe] = [text for code, text in told if code == "mode" and text.startswith("safe")]
    assert safe.startswith(f"safe: {stop};")


@pytest.mark.timeout(300)
@pytest.mark.parametrize("flight", ['["mark"]'], indirect=True)
def test_what_is_not_armed_is_refused_and_the_flight_goes_on(
    flight: Flight, capsys: pytest.CaptureFixture[str]
) -> None:
    flight.wait(lambda: is_running(flight))
    session = flight.packets[-1].session
    for count in range(20):
        flight.tell(telecommand(Order.STOP, 264, session, count, 9))
    flight.wait(lambda: len(flight.reports()) == 20)
    assert {report[1:] for report in flight.reports()} == {(2, "not armed")}
    assert flight.process.poll() is None
    assert is_running(flight)
    link = flight.leave()
    asked = ["--command", "mark 7", "--command", "span -20 -10", "--source", "5"]
    assert cli.main(["telemetry", str(flight.vehicle), "--decode", link, *asked]) == cli.FAILED
    out, err = capsys.readouterr()
    assert "of source 5: accepted\n" in out
    assert "of source 5: completed\n" in out
    assert "of source 5: not accepted, not armed: arm it" in out
    assert "1 of 2 commands are reported to be done" in err


def test_a_command_that_nobody_answers_fails(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    code = cli.main(["telemetry", "--decode", f"udp://127.0.0.1:{port}", "--command", "stop", "--duration", "1"])
    assert code == cli.BAD_INPUT
    assert "no packet of this downlink" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["--decode", "down.bin", "--command", "stop"], "--command is sent over a link"),
        (["--xtce", "db", "--command", "stop"], "--command is sent over a link"),
        (["--decode", "udp://127.0.0.1:9", "--command", "halt"], "--command halt: write mark NUMBER, stop, or span"),
        (["--decode", "udp://127.0.0.1:9", "--command", ""], "write mark NUMBER"),
        (["--decode", "udp://127.0.0.1:9", "--command", "mark"], "write mark NUMBER"),
        (["--decode", "udp://127.0.0.1:9", "--command", "mark 65536"], "a number from 0 to 65535"),
        (["--decode", "udp://127.0.0.1:9", "--command", "span 60 30"], "write mark NUMBER"),
        (["--decode", "udp://127.0.0.1:9", "--command", "stop now"], "write mark NUMBER"),
        (["--decode", "udp://127.0.0.1:9", "--command", "stop", "--source", "70000"], "give 0 to 65535"),
        (["--decode", "udp://127.0.0.1:9?commands=0"], "give udp://HOST:PORT"),
        (["--decode", "udp://127.0.0.1:9?port=5"], "give udp://HOST:PORT"),
    ],
)
def test_what_cannot_be_asked(arguments: list[str], why: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["telemetry", *arguments]) == cli.BAD_INPUT
    assert why in capsys.readouterr().err


def test_times_of_a_span() -> None:
    assert parse("span -60 -0.5").arguments == (-60.0, -0.5)
    assert parse("SPAN 2026-01-31T12:00:00 2026-01-31T13:00:10+01:00").arguments == (1769860800.0, 1769860810.0)


def test_a_span_has_all_events_and_answers_at_their_rate(
    short_mission: Result, capfdbinary: pytest.CaptureFixture[bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.nice", lambda _: 0)
    rows = [batch.rows for batch in short_mission.log.batches() if batch.rows.dtype == EVENT]
    begin, end = min(int(one["host_ns"][0]) for one in rows), max(int(one["host_ns"][-1]) for one in rows) + 1
    asked = [str(short_mission.path), str(begin), str(end), "2000000000"]
    path = tmp_path / "span"
    path.write_bytes(
        subprocess.run([sys.executable, "-m", "onboard.telemetry.span", *asked], capture_output=True, check=True).stdout
    )
    events, answers = 0, Counter[bytes]()
    with path.open("rb") as file:
        while file.tell() < path.stat().st_size:
            found = np.load(file)
            events += len(found) if found.dtype == EVENT else 0
            answers.update(bytes(row["name"]) for row in found if found.dtype != EVENT)
    assert events == sum(map(len, rows))
    assert len(answers) == 5
    assert all(6 <= count <= 10 for count in answers.values())  # of 16 s
    monkeypatch.setattr(span, "MOST_ROWS", events)
    assert span.main(asked) == span.TOO_MANY
