"""What a service manager receives."""

import os
import socket
import time
from pathlib import Path

import pytest

from onboard.flight.supervise.runner_forks import ForkServer
from onboard.flight.supervise.runner_notify import Notifier
from onboard.flight.supervise.runner_processes import HUNG_S, Worker
from tests.flight import forked


def received(manager: socket.socket) -> list[str]:
    """Every datagram that waits."""
    said = []
    while True:
        try:
            said.append(manager.recv(4096).decode())
        except BlockingIOError:
            return said


@pytest.mark.parametrize("abstract", [False, True])
def test_the_manager_is_told_and_fed_only_while_every_worker_answers(tmp_path: Path, abstract: bool) -> None:
    path = f"@heft-test-{os.getpid()}" if abstract else str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind("\0" + path[1:] if abstract else path)
        manager.setblocking(False)
        notifier = Notifier({"NOTIFY_SOCKET": path, "WATCHDOG_USEC": "2000000", "WATCHDOG_PID": str(os.getpid())})
        notifier.ready()
        notifier.status("phase 3,\n 2000 rows/s")
        for now_s in (100.0, 100.4, 101.1, 102.2):
            notifier.feed(now_s, answering=True)
        notifier.feed(105.0, answering=False)
        notifier.feed(105.1, answering=True)
        notifier.stopping()
        fed = ["WATCHDOG=1"]
        assert received(manager) == ["READY=1", "STATUS=phase 3, 2000 rows/s", *fed * 3, *fed, "STOPPING=1"]


def test_without_a_manager_nothing_is_sent_and_a_strangers_watchdog_is_not_fed(tmp_path: Path) -> None:
    for environment in ({}, {"NOTIFY_SOCKET": ""}, {"NOTIFY_SOCKET": str(tmp_path / "gone"), "WATCHDOG_USEC": "x"}):
        Notifier(environment).ready()
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.setblocking(False)
        theirs = {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "2000000", "WATCHDOG_PID": "1"}
        Notifier(theirs).feed(100.0, answering=True)
        assert received(manager) == []


def test_a_worker_that_has_been_silent_or_is_dead_does_not_answer(light: ForkServer) -> None:
    worker = Worker("test", lambda: light.fork(forked.answer))
    assert not worker.answers(time.monotonic())
    worker.start()
    worker.wait_ready()
    now_s = time.monotonic()
    assert worker.answers(now_s)
    assert not worker.answers(now_s + HUNG_S + 1.0)
    worker.finish()
    assert not worker.answers(time.monotonic())
