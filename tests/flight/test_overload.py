"""A computer that is too busy: long pauses are worked off in steps, slow is not hung, nothing is lost in silence."""

import os
import signal
import time
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import pytest

from onboard import config
from onboard.flight import runner_processes
from onboard.flight.estimation import LONGEST_STEP_NS, DurableEstimation
from onboard.flight.runner_processes import Worker
from onboard.offline.estimate_again.replay import replay
from onboard.ring import RingReader
from tests.flight.missions import Result
from tests.flight.test_takeover import STEP_NS, Stretch, record


@pytest.fixture(scope="module")
def vehicle() -> config.Vehicle:
    return config.load(config.packaged("rocksat"))


@pytest.mark.parametrize("killed", [False, True])
def test_a_pause_of_seconds_is_worked_off_in_steps_and_replays_to_the_bit(
    mission: Result, vehicle: config.Vehicle, tmp_path: Path, killed: bool
) -> None:
    stretch = Stretch(mission.log, vehicle, tmp_path / "rings")
    worker = DurableEstimation(vehicle, tmp_path / "rings", stretch.start_ns)
    paused = range(stretch.start_ns + 2_000_000_000, stretch.start_ns + 7_000_000_000)
    last_ns = stretch.start_ns + 9_000_000_000
    for now_ns in range(stretch.start_ns, last_ns, STEP_NS):
        stretch.feed(now_ns)
        if now_ns in paused:
            continue  # it gets no CPU at all
        if killed and now_ns - STEP_NS in paused:
            worker = DurableEstimation(vehicle, tmp_path / "rings", now_ns)
        worker.step(now_ns)
    worker.finish(last_ns)
    log = record(tmp_path / "rings", vehicle, tmp_path / "log.mcap")
    ticks, events = log.read("tick"), log.read("event_estimation")
    assert np.diff(ticks["host_ns"]).max() <= LONGEST_STEP_NS
    assert ticks["host_ns"][-1] == last_ns  # it has caught up
    codes = events["code"].tolist()
    assert codes.count(b"estimator_late") == codes.count(b"estimator_in_time") == 1
    assert b"estimator_overrun" not in codes
    for column, name in enumerate(vehicle.channels):  # each row once, none twice, none left out
        assert int(ticks["consumed"][:, column].sum()) == len(log.read(name))
    assert len(RingReader(tmp_path / "rings" / "row.ring").read()[0]) > 700
    replayed = replay(tmp_path / "log.mcap")
    assert replayed.identical, replayed.summary


def _works_long(pipe: Connection) -> None:
    pipe.send(True)
    end_s = time.monotonic() + 60
    while time.monotonic() < end_s:  # says nothing, and works
        sum(range(1000))


def _stands(pipe: Connection) -> None:
    pipe.send(True)
    os.kill(os.getpid(), signal.SIGSTOP)


@pytest.mark.realtime
@pytest.mark.timeout(120)
def test_a_worker_that_works_is_slow_and_one_that_stands_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner_processes, "HUNG_S", 1.5)
    monkeypatch.setattr(runner_processes, "LOOK_S", 1.0)
    monkeypatch.setattr(runner_processes, "LONGEST_SILENCE_S", 5.0)
    for body, expected in ((_works_long, ["slow", "slow"]), (_stands, [])):
        worker = Worker("test", body)
        worker.start()
        worker.wait_ready()
        happened: list[str] = []
        deadline = time.monotonic() + 30
        while "hung" not in happened and time.monotonic() < deadline:
            happened += [one] if (one := worker.watch()) else []
            time.sleep(0.02)
        assert happened[: len(expected)] == expected
        assert happened[-1] == "hung"  # in the end whatever says nothing is killed
        assert ("slow" in happened) == bool(expected)
        worker.finish()
