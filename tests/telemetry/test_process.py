"""The process that sends: what comes over a UDP port and a serial line, and what it does when the line fails."""

import contextlib
import os
import pty
import select
import socket
import subprocess
import sys
import threading
import time
import tty
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.records import EVENT as EVENT_ROW
from drivers.records import Severity
from onboard import channels, cli
from onboard.config.telemetry import Telemetry
from onboard.flight.store import directories, manifest
from onboard.recording.format.texts import printable
from onboard.recording.reader import LogReader
from onboard.recording.segmented import Preamble
from onboard.ring import RingWriter
from onboard.telemetry import link
from onboard.telemetry.commander import Commander, OperatorCommand, parse
from onboard.telemetry.packets import Packet
from onboard.telemetry.process import sending
from onboard.telemetry.stream import Series, Splitter
from tests.flight.missions import SHORT_REAL, Result, inline
from tests.telemetry.rows import estimates, health, said, slower

pytestmark = [pytest.mark.realtime, pytest.mark.usefixtures("own_rings")]
FAST = Telemetry(status_hz=5, answers_hz=5, bytes_s=20_000)


class Flight:
    """Rings of a flight that a test writes."""

    def __init__(self, log: Path) -> None:
        facts = {"flight": {"vehicle": "rocksat", "wall_clock_ns": str(time.time_ns())}}
        facts["flight"]["monotonic_ns"] = str(time.monotonic_ns())
        with manifest.new_flight(log, "test-telemetry") as self.directory:
            pass
        preamble = Preamble("test-telemetry", (), facts)
        self.about = manifest.Manifest(self.directory, log, "rocksat", manifest.Storage(1, 1, 1, 0), preamble)
        kinds = {"health": channels.HEALTH, "quantity": channels.QUANTITY, "event": EVENT_ROW}
        self.rings = {name: RingWriter(self.directory / f"{name}.ring", dtype, 1000) for name, dtype in kinds.items()}

    def second(self, number: int) -> None:
        """Rows as they come in a second."""
        now_ns = time.monotonic_ns()
        event = said(now_ns, f"number {number}", Severity(number % 3))
        for batch in (health(now_ns, rows=number), estimates(now_ns), event):
            self.rings[batch.channel].push(batch.rows)


@contextlib.contextmanager
def flight(log: Path) -> Iterator[Flight]:
    made = Flight(log)
    try:
        with directories.belong(made.directory):
            made.about.save()
            yield made
    finally:
        made.about.remove()


class Line(threading.Thread):
    """The far end of a serial line, at a path that the near end opens; what came so far, and commands that go back."""

    def __init__(self, path: Path, commands: Sequence[OperatorCommand] = ()) -> None:
        super().__init__(daemon=True)
        self._stream, self._out, self.reports = Splitter(Telemetry().apids), deque[bytes](), list[str]()
        self.commander = Commander(commands, Telemetry().command_apid, 9, 1, self._out, self.reports.append)
        self._master, slave = pty.openpty()
        tty.setraw(slave)
        path.unlink(missing_ok=True)
        path.symlink_to(os.ttyname(slave))
        self._slave, self.data, self._over = slave, b"", threading.Event()
        self.start()

    def run(self) -> None:
        while not self._over.is_set():
            if select.select([self._master], [], [], 0.05)[0]:
                came = os.read(self._master, 4096)
                self.data += came
                for packet in self._stream.feed(came):
                    self.commander.heard(packet)
                while self._out:
                    os.write(self._master, self._out.popleft())

    def pull(self) -> None:
        """Pull the plug."""
        self._over.set()
        self.join()
        os.close(self._slave)
        os.close(self._master)


def packets(data: bytes) -> list[Packet]:
    stream = Splitter(Telemetry().apids)
    return stream.feed(data) + stream.finish()


def until(met: Callable[[], Any], doing: Callable[[], object] = lambda: None, seconds: float = 60.0) -> Any:
    """What ``met`` gives as soon as it is something; ``doing`` meanwhile."""
    deadline = time.monotonic() + seconds
    while not (found := met()):
        assert time.monotonic() < deadline
        doing()
        time.sleep(0.05)
    return found


def of(kind: str, found: list[Packet]) -> list[Packet]:
    return [packet for packet in found if packet.kind.name == kind]


@pytest.mark.timeout(180)
def test_a_flight_comes_down_by_udp_to_its_last_word(tmp_path: Path) -> None:
    log, got, number = tmp_path / "flight.mcap", [b""], [0]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground:
        ground.bind(("127.0.0.1", 0))
        ground.settimeout(0.01)

        def listen() -> list[Packet]:
            with contextlib.suppress(TimeoutError):
                while True:
                    got[0] += ground.recv(4096)
            return packets(got[0])

        with sending(log, f"udp://127.0.0.1:{ground.getsockname()[1]}", FAST):
            with flight(log) as flown:

                def push() -> None:
                    number[0] += 1
                    flown.second(number[0])

                until(lambda: len(of("answer", listen())) > 20 and of("flight", listen()), push)
                until(lambda: of("status", listen())[-1].values["rows"] > 0, push)
                flown.rings["event"].push(said(time.monotonic_ns(), "stopped: the last", code="mode").rows)
            until(lambda: of("status", listen())[-1].values["mode"] == "stopped")
        found = listen()
    series = Series()
    assert all(series.place(packet) == (True, 0) for packet in found)
    events = [packet.values["text"] for packet in of("event", found)]
    assert set(events) == {f"number {n}" for n in range(1, number[0] + 1)} | {"stopped: the last"}
    assert of("flight", found)[0].values["flight"] == "test-telemetry"
    assert found[-1].kind.name == "status"
    assert found[-1].values["sent"] == len(found) - 1


@pytest.mark.timeout(180)
def test_a_line_that_fails_is_tried_again_and_the_gap_is_told(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    log, tty_path, number = tmp_path / "flight.mcap", tmp_path / "tty", [0]
    line = Line(tty_path)
    with flight(log) as flown, sending(log, f"serial://{tty_path}?baud=115200", FAST):

        def push() -> None:
            number[0] += 1
            flown.second(number[0])

        until(lambda: of("answer", packets(line.data)), push)
        line.pull()
        said_so: list[str] = []

        def told() -> bool:
            said_so.append(capfd.readouterr().err)
            return "tried again every second" in "".join(said_so)

        until(told, push)
        other = Line(tty_path)
        until(lambda: len(of("status", packets(other.data))) > 3, push)
    other.pull()
    text = "".join(said_so) + capfd.readouterr().err
    assert text.count("tried again every second") == 1
    assert text.count("works again") == 1
    series = Series()
    for packet in packets(line.data) + packets(other.data):
        assert series.place(packet).new
    assert sum(series.missing.values()) <= 3  # a packet that was under way; else nothing is made that is not sent


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ("serial:///dev/nowhere?baud=19200", "--telemetry serial:///dev/nowhere?baud=19200: "),
        ("serial:///dev/null", "lacks baud"),
        ("udp://127.0.0.1", "give udp://HOST:PORT, serial:///dev/ttyS0"),
        ("udp://127.0.0.1:99999", "give udp://HOST:PORT, serial:///dev/ttyS0"),
        ("tcp://127.0.0.1:5", "give udp://HOST:PORT"),
        ("file://", "give udp://HOST:PORT"),
        ("file:///nowhere/at/all", "No such file or directory; give another link"),
    ],
)
def test_a_link_that_cannot_be_used_is_refused_before_the_flight(given: str, why: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError) as refused, sending(tmp_path / "flight.mcap", given, FAST):  # noqa: PT011
        pytest.fail("it was opened")
    assert why in str(refused.value)


@pytest.mark.timeout(240)
def test_a_flight_over_a_serial_line_at_19200_baud(tmp_path: Path) -> None:
    """What comes down is what the log says, a command that goes up is carried out, and the flight loses nothing."""
    line, log, over = Line(tmp_path / "tty", [parse("mark 7")]), tmp_path / "flight.mcap", tmp_path / "over.toml"
    assert cli.main(["init", str(tmp_path / "mine"), "--from", "rocksat"]) == cli.OK
    vehicle = tmp_path / "mine/vehicle.toml"
    text = slower(vehicle.read_text())
    vehicle.write_text(f'{text}\n[telemetry]\ncommands = ["mark"]\n')
    over.write_text(f"sequence = [{', '.join(map(inline, SHORT_REAL))}]\n")
    to = f"serial://{tmp_path}/tty?baud=19200"
    command = [sys.executable, "-m", "onboard.cli", "hil", str(vehicle), "--scenario", str(over), "--realtime"]
    done = subprocess.run(
        [*command, "--log", str(log), "--telemetry", to], capture_output=True, text=True, timeout=200, check=False
    )
    assert "every sample accounted for" in done.stdout, done.stdout + done.stderr
    line.pull()
    found, series, read = packets(line.data), Series(), LogReader(log)
    assert all(series.place(packet) == (True, 0) for packet in found)
    facts = read.metadata["flight"]
    later_ns = int(facts["wall_clock_ns"]) - int(facts["monotonic_ns"])
    rows = {kind: [row for b in read.batches() if b.rows.dtype == kind for row in b.rows] for kind in _DTYPES}
    logged = {(printable(row["name"]), int(row["host_ns"]) // 1000): row for row in rows[channels.QUANTITY]}
    answers = of("answer", found)
    for packet in answers:
        values, at_us = packet.values, (packet.at_ns - later_ns) / 1000
        [row] = [row for n in (-1, 0, 1) if (row := logged.get((values["quantity"], int(at_us) + n))) is not None]
        assert (values["supported"] == "yes") == bool(row["supported"])
        assert values["value"] == np.float32(row["value"]) or not row["supported"]
    assert len(answers) > 20
    words = {(int(row["status_latched"]), int(row["rows"])) for row in rows[channels.HEALTH]}
    told = [packet.values for packet in of("status", found) if packet.values["rows"]]
    assert len(told) > 5
    assert {(values["latched"] & 0x7FFFFFFF, values["rows"]) for values in told} <= words
    events = {(printable(row["code"]), printable(row["text"])) for row in rows[EVENT_ROW]}
    down = {(packet.values["code"], packet.values["text"]) for packet in of("event", found)}
    assert down <= events
    assert line.commander.done == [True], line.reports
    [marked] = [text for code, text in events if code == "mark"]
    assert marked.startswith(f"mark 7, asked by source 9, count 1, of {tmp_path}"[:70])  # as much as a row holds
    assert found[-1].values["mode"] == "stopped"
    assert found[-1].values["unsent_events"] + len(of("event", found)) <= len(rows[EVENT_ROW])
    assert found[-1].values["unread"] == 0


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_port:
        any_port.bind(("127.0.0.1", 0))
        return int(any_port.getsockname()[1])


@pytest.mark.timeout(120)
@pytest.mark.parametrize("kind", ["udp", "serial"])
def test_what_one_end_sends_of_a_log_the_other_shows(
    kind: str, short_mission: Result, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    received = link.received

    def until_some_came(address: link.Address, commands: deque[bytes]) -> Iterator[bytes]:
        stream, whole, got = Splitter(Telemetry().apids), 0, 0
        for piece in received(address, commands):
            yield piece
            got += len(piece)
            whole += sum(packet.kind.length for packet in stream.feed(piece))
            if whole == got >= 400:
                return

    monkeypatch.setattr(link, "received", until_some_came)
    master, slave = pty.openpty()
    near, far = pty.openpty()
    for end in (slave, far):
        tty.setraw(end)
    port = free_port()
    to = f"udp://127.0.0.1:{port}" if kind == "udp" else f"serial://{os.ttyname(slave)}?baud=115200"
    at = to if kind == "udp" else f"serial://{os.ttyname(far)}?baud=115200"
    over = threading.Event()

    def cable() -> None:
        while not over.is_set():
            if select.select([master], [], [], 0.05)[0]:
                os.write(near, os.read(master, 4096))

    wire = threading.Thread(target=cable)
    wire.start()
    command = [sys.executable, "-m", "onboard.cli", "telemetry", str(short_mission.path), "--send", to]
    sender = subprocess.Popen(command)
    try:
        code = cli.main(["telemetry", "--decode", at, "--duration", "100"])
    finally:
        sender.kill()
        sender.wait()
        over.set()
        wire.join()
        for end in (master, slave, near, far):
            os.close(end)
    shown = capsys.readouterr().out
    assert code == cli.OK, shown
    assert "rocksat" in shown
    assert "missing none" in shown


_DTYPES = (channels.QUANTITY, channels.HEALTH, EVENT_ROW)
