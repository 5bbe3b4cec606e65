"""Viewers of the page: frames and events reach each, none waits for another; its process ends with its flight."""

import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from drivers import records
from drivers.records import Batch
from onboard import cli
from onboard.page import process, web
from onboard.page.follow import LogFrames
from onboard.page.state import PageState
from onboard.recording.reader import LogReader
from tests.page.made import START, Rings, flight
from tests.page.served import Stream, ask, served


class Flying:
    """A flight in this process."""

    live, urdf = True, b""

    def __init__(self) -> None:
        self.state = PageState("made", live=True)
        for batch in flight():
            self.state.add(batch)

    def about(self) -> dict[str, object]:
        return {"title": self.state.title, "live": True}


@pytest.fixture(scope="module")
def log(made_log: Path) -> LogFrames:
    return LogFrames(LogReader(made_log))


class TestViewers:
    def test_a_frame_and_the_events_since_reach_every_viewer_once(self) -> None:
        source = Flying()
        with served(source) as one:
            streams = [Stream(one.port, "/live?since=1"), Stream(one.port), Stream(one.port, "/live?since=x")]
            for stream in streams:
                assert b"text/event-stream" in stream.head()
            one.send({"t": 1.0})
            first = [stream.frame() for stream in streams]
            assert [len(frame["events"]) for frame in first] == [2, 3, 3]
            assert all((frame["t"], frame["skipped"]) == (1.0, 0) for frame in first)
            event = np.zeros(1, records.EVENT)
            event["host_ns"], event["text"] = START, b"new"
            one.loop.call_soon_threadsafe(source.state.add, Batch("event", event))
            one.send({"t": 2.0})
            assert [[e["text"] for e in stream.frame()["events"]] for stream in streams] == [["new"]] * 3
            for stream in streams:
                stream.close()

    def test_one_that_takes_nothing_loses_frames_and_no_event_and_nobody_waits(self) -> None:
        source = Flying()
        with served(source) as one:
            slow, good = Stream(one.port, buffer=4096), Stream(one.port)
            slow.head(), good.head()
            event = np.zeros(1, records.EVENT)
            event["host_ns"] = START
            for step in range(200):
                one.loop.call_soon_threadsafe(source.state.add, Batch("event", event))
                one.send({"t": float(step), "filled": "x" * 8000})
                assert good.frame()["t"] == step
            seen, events, skipped = [], 0, 0
            until = time.monotonic() + 60
            while (not seen or seen[-1] < 1e6) and time.monotonic() < until:
                one.send({"t": 1e6})
                frame = slow.frame()
                seen.append(frame["t"])
                events += len(frame["events"])
                skipped = max(skipped, frame["skipped"])
            assert seen == sorted(seen)
            assert 0 < skipped < 200
            assert events == 3 + 200  # those of frames left out came with the next
            slow.close(), good.close()

    def test_one_that_stalls_is_disconnected_and_one_too_many_refused(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(web, "STALL_S", 0.2)
        monkeypatch.setattr(web, "MOST_VIEWERS", 2)
        with served(Flying()) as one:
            stalled, other = Stream(one.port, buffer=4096), Stream(one.port)
            stalled.head(), other.head()
            assert ask(one.port, "/live").status == 503
            until = time.monotonic() + 60
            while one.web.viewers == 2 and time.monotonic() < until:
                one.send({"filled": "x" * 100_000})
                other.frame()
                time.sleep(0.02)
            assert one.web.viewers == 1
            third = Stream(one.port)
            assert b"200 OK" in third.head()
            for stream in (stalled, other, third):
                stream.close()

    def test_sockets_that_say_nothing_keep_nobody_out(self, monkeypatch: pytest.MonkeyPatch, log: LogFrames) -> None:
        monkeypatch.setattr(web, "REQUEST_S", 0.5)
        with served(log) as one, contextlib.ExitStack() as stack:
            silent = [stack.enter_context(socket.create_connection(("127.0.0.1", one.port))) for _ in range(300)]
            for connection in silent[::2]:
                connection.sendall(b"GET / HT")
            assert ask(one.port, "/flight").status == 200
            for connection in silent:
                connection.settimeout(60)
                with contextlib.suppress(ConnectionResetError):
                    assert connection.recv(10) == b""

    @pytest.mark.parametrize("size", [90_000, 200_000])  # less, and more, than asyncio keeps before it waits
    def test_answers_that_nobody_takes_keep_no_connection(self, size: int, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(web, "STALL_S", 0.3)
        source = Flying()
        source.state.title = "x" * size
        with served(source) as one, contextlib.ExitStack() as stack:
            before = len(list(Path("/proc/self/fd").iterdir()))
            asked = [Stream(one.port, "/flight", buffer=4096) for _ in range(30)]
            for stream in asked:
                stack.callback(stream.close)
            until, ours = time.monotonic() + 20, before + len(asked)
            while (opened := len(list(Path("/proc/self/fd").iterdir()))) <= ours and time.monotonic() < until:
                time.sleep(0.005)
            assert opened > ours  # the other side's, too
            while (kept := len(list(Path("/proc/self/fd").iterdir()))) > ours and time.monotonic() < until:
                time.sleep(0.05)
            assert kept <= ours
            assert len(ask(one.port, "/flight").body) > size

    def test_one_that_talks_is_disconnected(self) -> None:
        with served(Flying()) as one:
            stream = Stream(one.port)
            stream.head()
            stream.connection.sendall(b"hello")
            with pytest.raises((EOFError, ConnectionResetError)):
                stream.frame()
            stream.close()


@pytest.mark.realtime
class TestProcess:
    def test_it_finds_its_flight_and_goes_with_it(self, rings: Rings) -> None:
        command = [sys.executable, "-m", "onboard.page", str(rings.log), ":0"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as running:
            assert running.stdout is not None
            ready, url = running.stdout.readline().split()
            assert (ready, url.startswith("http://127.0.0.1:")) == ("ready", True)
            port = int(url.rstrip("/").rpartition(":")[2])
            rings.push(flight())
            stream = Stream(port)
            while not (frame := stream.frame())["held"]:
                pass
            assert frame["title"] == "made: made.mcap"
            assert [event["n"] for event in json.loads(ask(port, "/flight").body)["events"]] == [0, 1, 2]
            rings.manifest.remove()
            while not (frame := stream.frame())["ended"]:
                pass
            assert frame["held"][0]["value"] == 5.0198378161508
            stream.close()
            assert running.wait(20) == 0

    def test_before_its_flight_it_waits_and_ends_when_it_is_told(self, tmp_path: Path) -> None:
        with process.serving(tmp_path / "none.mcap", ":0") as url:
            port = int(url.rstrip("/").rpartition(":")[2])
            stream = Stream(port)
            frame = stream.frame()
            assert (frame["go"]["word"], frame["title"], frame["t"]) == ("NO-GO", "none.mcap", 0.0)
            stream.close()
        with pytest.raises(OSError):  # noqa: PT011 refused, or reset
            ask(port)

    def test_it_has_the_plan(self, rings: Rings, tmp_path: Path) -> None:
        plan = tmp_path / "plan.json"
        plan.write_text('{"expected": [{"name": "m_payload", "unit": "kg", "sigma": 0.5, "level": "good"}]}')
        with process.serving(rings.log, ":0", plan) as url:
            told = json.loads(ask(int(url.rstrip("/").rpartition(":")[2]), "/flight").body)["plan"]
        assert told == {"m_payload": {"half": pytest.approx(0.98, abs=0.001), "unit": "kg"}}

    def test_it_holds_little_memory(self, rings: Rings) -> None:
        """Neither Pinocchio nor SciPy nor rich is in it."""
        code = "import sys, onboard.page.process; print(*sys.modules)"
        ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=os.environ)
        assert not {"scipy", "pinocchio", "rich", "pydantic", "foxglove"} & set(ran.stdout.split())


@pytest.mark.realtime
class TestCommand:
    def test_a_log_is_shown_until_it_is_interrupted(self, made_log: Path) -> None:
        command = [sys.executable, "-m", "onboard.cli", "watch", str(made_log), "--page-address", ":0"]
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as running:
            assert running.stderr is not None
            found = re.fullmatch(r"heft: page at http://127\.0\.0\.1:(\d+)/\n", running.stderr.readline())
            assert found is not None
            about = json.loads(ask(int(found[1]), "/flight").body)
            assert (about["live"], about["title"]) == (False, "made: made.mcap")
            running.send_signal(signal.SIGINT)
            assert (running.wait(60), running.stderr.read()) == (0, "")

    def test_a_running_flight_is_shown_until_it_is_interrupted_or_has_ended(self, rings: Rings) -> None:
        command = [sys.executable, "-m", "onboard.cli", "watch", "--live", "--page-address", ":0"]
        for interrupted in (True, False):
            with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as running:
                assert running.stderr is not None
                port = int(running.stderr.readline().rstrip("/\n").rpartition(":")[2])
                stream = Stream(port)
                assert stream.frame()["title"] == "made: made.mcap"
                if interrupted:
                    running.send_signal(signal.SIGINT)
                else:
                    rings.manifest.remove()
                assert (running.wait(60), running.stderr.read()) == (0, "")
                stream.close()

    def test_a_damaged_log_is_shown_and_said(self, made_log: Path, tmp_path: Path) -> None:
        short = tmp_path / "short.mcap"
        short.write_bytes(made_log.read_bytes()[:-5000])
        command = [sys.executable, "-m", "onboard.cli", "watch", str(short), "--page-address", "127.0.0.1:0"]
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as running:
            assert running.stderr is not None
            assert running.stderr.readline().startswith("heft: page at ")
            running.send_signal(signal.SIGINT)
            assert running.wait(60) == 3
            assert "warning: " in running.stderr.read()

    @pytest.mark.parametrize(
        ("words", "remedy"),
        [
            (["hil", "rocksat", "--page"], "add --realtime, or heft watch LOG --page afterwards"),
            (["watch", "LOG", "--page-address", "host:port"], "write HOST:PORT"),
            (["watch", "LOG", "--page-plan", "nothing.json"], "No such file"),
            (["watch", "LOG", "--page-plan", __file__], "give the plan.json that heft plan wrote"),
            (["watch", "LOG", "--page-address", "192.0.2.1:1"], "give another address"),
            (["watch", "--page"], "watch what?"),
            (["fly", "rocksat", "--page-address", "x y:1"], "write HOST:PORT"),
        ],
    )
    def test_what_cannot_be_is_refused_with_the_remedy(
        self, words: list[str], remedy: str, made_log: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert cli.main([str(made_log) if word == "LOG" else word for word in words]) == 2
        assert remedy in capsys.readouterr().err
