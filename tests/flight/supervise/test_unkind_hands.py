"""What is done to a flight from outside: its log removed and cut off, its terminal gone, its computer busy."""

import contextlib
import json
import os
import pty
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from onboard import cli, config
from onboard.flight.supervise.runner_forks import ForkServer
from onboard.flight.supervise.runner_processes import Worker
from onboard.ground.log.views.info import info
from onboard.recording.format.segments import segment_path
from onboard.recording.reader import LogReader
from tests.flight import forked

pytestmark = [pytest.mark.realtime, pytest.mark.usefixtures("own_rings")]


def until(true: Callable[[], bool], seconds: float = 90.0) -> bool:
    """Wait for it."""
    deadline = time.monotonic() + seconds
    while not true() and time.monotonic() < deadline:
        time.sleep(0.05)
    return true()


@pytest.mark.timeout(300)
def test_a_flight_whose_log_is_removed_and_cut_off_and_whose_terminal_goes_accounts_for_every_row(
    tmp_path: Path,
) -> None:
    log, place = tmp_path / "flights" / "unkind.mcap", tmp_path / "sockets"
    place.mkdir()
    serve = [sys.executable, "-m", "hil_sim.serve", "rocksat", "--seed", "3", "--directory", str(place)]
    with subprocess.Popen(serve, stdout=subprocess.PIPE, text=True, start_new_session=True) as devices:
        assert devices.stdout is not None
        start = json.loads(devices.stdout.readline())
        urls = [f"--url={bus}={start[bus]}" for bus in ("i2c_1", "can_0", "sync_line")]
        command = [sys.executable, "-m", "onboard.cli", "fly", str(config.packaged("rocksat")), "--log", str(log)]
        terminal, end = pty.openpty()
        # a session of its own, whose terminal this is
        shell = ["setsid", "--ctty", "--wait", *command, "--duration", "300", *urls]
        with subprocess.Popen(shell, stdin=end, stdout=end, stderr=end) as flight:
            os.close(end)
            said = Said(terminal)
            assert until(lambda: said.has("every worker is at work")), said.text
            time.sleep(2.0)
            log.unlink()
            assert until(lambda: said.has("log_lost: unkind.mcap was removed"), 20.0), said.text
            assert until(lambda: segment_path(log, 1).stat().st_size > 200_000)
            os.truncate(segment_path(log, 1), 100_000)  # what it says of the first is left
            assert until(lambda: said.has("log_lost: unkind_001.mcap was cut off after 100000 of"), 20.0), said.text
            os.close(terminal)
            assert until(lambda: segment_path(log, 2).stat().st_size > 200_000)
            assert flight.poll() is None
            flight.send_signal(signal.SIGTERM)  # setsid has become it: what is forked leads no process group
            code = flight.wait(60)
        devices.terminate()
    assert code == cli.FAILED  # rows are lost
    hangups = [text for code, text in events(log, "event_supervisor") if code == "hangup"]
    assert [text.partition(";")[0] for text in hangups] == ["the terminal is gone"]
    about = info(log)
    assert {channel.name: channel.unexplained for channel in about.channels if channel.unexplained} == {}
    assert sum(channel.gaps for channel in about.channels) > 1000
    assert [code for code, _ in events(log, "recorder_event")].count("log_lost") == 2


def events(log: Path, channel: str) -> list[tuple[str, str]]:
    return [(row["code"].decode(), row["text"].decode()) for row in LogReader(log).read(channel)]


class Said:
    """What comes from a terminal."""

    def __init__(self, terminal: int) -> None:
        os.set_blocking(terminal, False)
        self._terminal, self.text = terminal, ""

    def has(self, words: str) -> bool:
        with contextlib.suppress(BlockingIOError, OSError):
            while part := os.read(self._terminal, 1 << 16):
                self.text += part.decode(errors="replace")
        return words in self.text


@pytest.mark.timeout(60)
def test_the_end_of_a_worker_is_bounded_and_tended_meanwhile(light: ForkServer) -> None:
    worker = Worker("test", partial(light.fork, forked.work_long))
    worker.start()
    worker.wait_ready()
    waited: list[float] = []
    assert 2.0 <= worker.finish(2.0, waited.append) < 4.0
    assert len(waited) >= 5
    assert waited == sorted(waited)
    assert worker.exit_code == -signal.SIGKILL
    assert not worker.died  # the answer of its last step is the answer
