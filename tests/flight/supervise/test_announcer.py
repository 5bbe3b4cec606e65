"""What a flight says of itself: events, phases, answers, how it stands; and what was missing all flight.

What a service manager receives.
"""

import logging
import os
import socket
import time
from pathlib import Path

import numpy as np
import pytest

from drivers import records
from drivers.records import Batch, Severity, event, gap
from onboard import channels, config
from onboard.flight.acquire.publisher import Publisher
from onboard.flight.store import rings
from onboard.flight.supervise.announcer import RECORDER_SAID, Announcer, missing_all_flight
from onboard.flight.supervise.end_of_mission import EndOfMission
from onboard.flight.supervise.runner_forks import ForkServer
from onboard.flight.supervise.runner_notify import Notifier
from onboard.flight.supervise.runner_processes import HUNG_S, Worker
from onboard.ring import RingWriter
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


@pytest.fixture
def vehicle() -> config.Vehicle:
    return config.load(config.packaged("rocksat"))


@pytest.fixture
def devices(vehicle: config.Vehicle, tmp_path: Path) -> Publisher:
    return Publisher(rings.create(tmp_path, vehicle, rings.device_channels(vehicle)))


@pytest.fixture
def said(caplog: pytest.LogCaptureFixture) -> pytest.LogCaptureFixture:
    caplog.set_level(logging.INFO, "heft")
    return caplog


def scalars(first: int, count: int) -> records.Rows:
    rows = np.zeros(count, records.SCALAR)
    rows["sequence"] = range(first, first + count)
    return rows


def answer(value: float, *, supported: bool) -> records.Rows:
    row = np.zeros(1, channels.QUANTITY)
    row["name"], row["unit"], row["value"], row["supported"] = b"mass of payload", b"kg", value, supported
    row["low"], row["high"] = value - 0.1, value + 0.1
    return row


def test_warnings_errors_and_phases_are_said_and_the_rest_is_not(
    vehicle: config.Vehicle, tmp_path: Path, devices: Publisher, said: pytest.LogCaptureFixture
) -> None:
    estimation = RingWriter(tmp_path / "event_estimation.ring", records.EVENT, 50)
    announcer = Announcer(vehicle, tmp_path, 0.0, None)
    for severity in Severity:
        devices.publish([event(1, severity, "code", "joint_1", f"text {severity.name}")])
    estimation.push(event(1, Severity.INFO, "phase", "estimation", "phase 36").rows)
    announcer.step(0.1)
    recorder = RingWriter(tmp_path / RECORDER_SAID, records.EVENT, 50)  # made after the first look
    recorder.push(event(1, Severity.ERROR, "disk_error", "recorder", "the disk refused").rows)
    announcer.step(0.2)
    announcer.step(0.3)
    assert [(r.levelname, r.source, r.getMessage()) for r in said.records] == [  # type: ignore[attr-defined]
        ("WARNING", "joint_1", "code: text WARNING"),
        ("ERROR", "joint_1", "code: text ERROR"),
        ("INFO", "estimation", "phase: phase 36"),
        ("ERROR", "recorder", "disk_error: the disk refused"),
    ]


def test_a_line_a_second_says_what_is_slow_missing_and_found(
    vehicle: config.Vehicle, tmp_path: Path, devices: Publisher, said: pytest.LogCaptureFixture
) -> None:
    quantity = RingWriter(tmp_path / "quantity.ring", channels.QUANTITY, 50)
    announcer = Announcer(vehicle, tmp_path, 0.0, 1.0)
    for tenth in range(1, 21):
        imu = np.zeros(100, records.IMU)
        devices.publish([Batch("imu_base", imu), Batch("joint_1", scalars(tenth * 4, 4))])
        if tenth == 5:
            devices.publish([gap(1, "joint_1", 3, 14, 5, "bus")])
        quantity.push(answer(5.0, supported=tenth > 12))
        announcer.step(tenth * 0.1, f"status {tenth}")
    lines = [r.getMessage() for r in said.records if r.source == "status"]  # type: ignore[attr-defined]
    assert len(lines) == 2
    assert lines[0].startswith("1 s, 1040 rows/s, ")
    assert "joint_1 40 of 200 Hz" in lines[0]
    assert "imu_base" not in lines[0]
    assert "12 rows missing in 1 gaps" in lines[0]
    assert "mass of payload" not in lines[0]
    assert lines[0].endswith(", status 10")
    assert "mass of payload 5 kg (4.9 to 5.1)" in lines[1]
    quantity.push(answer(5.0, supported=False))
    announcer.step(2.05)
    quantity.push(answer(6.0, supported=True))
    announcer.end(2.1, 2_100_000_000)
    told = [r.getMessage() for r in said.records if r.source == "answer"]  # type: ignore[attr-defined]
    assert told == [
        "mass of payload 5 kg (4.9 to 5.1)",
        "mass of payload is no longer determined",
        "mass of payload 6 kg (5.9 to 6.1)",
        "mass of payload 6 kg (5.9 to 6.1)",
    ]


def test_buses_and_essentials_that_never_brought_a_row_are_named(vehicle: config.Vehicle) -> None:
    every = dict.fromkeys(vehicle.channels, 1)
    assert missing_all_flight(vehicle, every) == []
    [bus] = missing_all_flight(vehicle, every | {"imu_base": 0})
    assert "bus i2c_1" in bus
    assert missing_all_flight(vehicle, every | {"load_cell": 0}) == []  # the others on its bus were there
    text = vehicle.text.replace('name = "rocksat"', 'name = "rocksat"\nessential = ["load_cell"]')
    named = config.parse(text, vehicle.path)
    assert missing_all_flight(named, every | {"load_cell": 0}) == [
        "load_cell, which is essential, was missing all flight"
    ]
    with pytest.raises(config.ConfigError, match="no device 'cell'"):
        config.parse(text.replace('["load_cell"]', '["cell"]'), vehicle.path)


def test_the_mode_is_said_and_stands_in_the_status_line(
    vehicle: config.Vehicle, tmp_path: Path, devices: Publisher, said: pytest.LogCaptureFixture
) -> None:
    ring = RingWriter(tmp_path / "event_supervisor.ring", records.EVENT, 10)
    announcer = Announcer(vehicle, tmp_path, 0.0, 1.0)
    ring.push(event(1, Severity.INFO, "mode", "flight", "armed: every device answers").rows)
    announcer.step(1.5)
    assert "mode: armed: every device answers" in [record.getMessage() for record in said.records]
    assert announcer.status.startswith("2 s, armed, ")


def test_a_glitch_of_the_phase_does_not_end_the_flight(
    vehicle: config.Vehicle, tmp_path: Path, devices: Publisher
) -> None:
    phases = vehicle.file.estimation.phases
    assert phases is not None
    end = EndOfMission(vehicle, tmp_path)
    told = []
    for at_s, code in ((0.0, 3), (1.0, phases.end), (1.5, 3), (3.0, None), (4.0, phases.end), (4.5, None), (5.0, None)):
        if code is not None:
            row = scalars(len(told), 1)
            row["value_raw"] = code
            devices.publish([Batch(phases.channel, row)])
        told.append(end.reached(at_s))
    assert told == [False] * 6 + [True]


@pytest.mark.parametrize(("codes", "over"), [([77], True), ([36, 77], False), ([], False)])
def test_a_mission_that_was_over_before_the_start_is_known(
    vehicle: config.Vehicle, tmp_path: Path, devices: Publisher, codes: list[int], over: bool
) -> None:
    phases = vehicle.file.estimation.phases
    assert phases is not None
    end = EndOfMission(vehicle, tmp_path)
    for number, code in enumerate(codes):
        row = scalars(number, 1)
        row["value_raw"] = phases.end if code == 77 else code
        devices.publish([Batch(phases.channel, row)])
        end.reached(0.0)
    assert end.was_over == over


def test_whatever_says_that_rows_are_not_in_the_log_is_kept_for_the_end(
    vehicle: config.Vehicle, tmp_path: Path
) -> None:
    recorder = RingWriter(tmp_path / RECORDER_SAID, records.EVENT, 50)
    announcer = Announcer(vehicle, tmp_path, 0.0, None)
    for code in ("log_lost", "disk_error", "rows_lost", "ring_overrun", "log_moved"):
        recorder.push(event(1, Severity.ERROR, code, "recorder", code).rows)
    announcer.step(0.1)
    assert announcer.lost == ["log_lost", "rows_lost", "ring_overrun"]  # heft fly and heft hil end with 1 for these
    assert len(announcer.troubles) == 5
