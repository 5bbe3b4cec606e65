"""Processes beside a flight end with it, also where it is killed before it begins."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from onboard.flight.supervise.companion import beside
from tests.conftest import is_alive

RATES = """{"bytes_s": 0, "status_hz": 1, "answers_hz": 1, "phase_hz": 1, "flight_hz": 1, "reasons_hz": 1, "apids": {},
"command_apid": 264, "commands": []}"""
STARTS = """
import sys, time
from onboard.flight.supervise.companion import beside
with beside(sys.argv[1], sys.argv[2:], "--it"):
    print("begun", flush=True)
    time.sleep(600)
"""


def children(pid: int) -> list[int]:
    return [int(one) for one in Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()]


@pytest.mark.timeout(120)
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize(
    ("module", "arguments"),
    [
        ("onboard.live", ["127.0.0.1:0"]),
        ("onboard.page", [":0"]),
        ("onboard.telemetry", ["udp://127.0.0.1:9", RATES]),
    ],
)
def test_it_ends_with_a_flight_that_never_began(tmp_path: Path, module: str, arguments: list[str], how: int) -> None:
    command = [sys.executable, "-c", STARTS, module, str(tmp_path / "x.mcap"), *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as flight:
        assert flight.stdout is not None
        assert flight.stdout.readline() == "begun\n"
        [companion] = children(flight.pid)
        flight.send_signal(how)
        flight.wait(60)
    deadline = time.monotonic() + 60
    while is_alive(companion) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not is_alive(companion)


def test_a_terminal_s_signals_are_left_to_the_flight(tmp_path: Path) -> None:
    before = children(os.getpid())
    with beside("onboard.page", [str(tmp_path / "x.mcap"), ":0"], "--page"):
        [companion] = set(children(os.getpid())) - set(before)
        assert os.getsid(companion) == companion  # sessions share the cores: it takes none of the flight's
        group = Path(f"/proc/{companion}/autogroup")
        assert not group.exists() or group.read_text(encoding="ascii").split()[1:] == ["nice", "10"]
        assert os.getpriority(os.PRIO_PROCESS, companion) == min(os.getpriority(os.PRIO_PROCESS, 0) + 10, 19)
        for number in (signal.SIGINT, signal.SIGHUP):
            os.kill(companion, number)
        time.sleep(0.5)
        assert is_alive(companion)
    assert not is_alive(companion)


def test_one_that_does_not_start_says_why() -> None:
    with pytest.raises(ValueError, match=r"^--it: its process did not start$"), beside("onboard.none", [], "--it"):
        pytest.fail("it began")
