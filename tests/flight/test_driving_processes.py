"""A driven arm on the real clock, in its own process: acquisition is killed, or the flight ended, in mid-motion."""

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from onboard.recording.reader import LogReader
from tests.flight.driven_bench import csv_of, swing, written
from tests.flight.supervise.test_kill import pids

pytestmark = [pytest.mark.realtime, pytest.mark.usefixtures("own_rings")]

SECONDS = 24.0  # of the motion: the shoulder goes to its far end in half of it
ROWS = "torque_sigma_N_m = 0.1\ntorque_still_rad_s = 0.02\ngain = -1.0\ntorque = true"
PRIOR = """
[estimation.prior.relative]
base = 0.0
link_1 = 0.1
link_2 = 0.1
[estimation.prior.absolute]
bias_elbow_torque = 0.1
Ia_j2 = 1.0
Fv_j2 = 1.0
Fc_j2 = 1.0
"""


@contextlib.contextmanager
def served(vehicle, directory):
    """The arm; gives its bus's URL, and where its axes have been once it has ended."""
    command = [sys.executable, "-m", "hil_sim.serve_arm", str(vehicle), "--directory", str(directory), "--at=j2=0.2"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as devices:
        found = {}
        try:
            yield json.loads(devices.stdout.readline())["can_0"], found
            time.sleep(0.7)
        finally:
            devices.terminate()
        found |= json.loads(devices.stdout.readline())


@contextlib.contextmanager
def ended(flight):
    """A flight that does not outlive a test that fails."""
    try:
        yield
    finally:
        flight.terminate()


def until(flight, word, seconds=60.0):
    """Read what a flight says until a line has ``word``."""
    deadline, said = time.monotonic() + seconds, b""
    while word not in said:
        waited_s = deadline - time.monotonic()
        assert waited_s > 0.0, said.decode()
        if select.select([flight.stdout], [], [], waited_s)[0]:
            more = os.read(flight.stdout.fileno(), 1 << 16)
            assert more, said.decode()
            said += more


def await_event(log, codes, seconds=60.0):
    """Wait until a log that is still written has an event of one of the codes."""
    deadline = time.monotonic() + seconds
    while codes.isdisjoint(LogReader(log).read("event")["code"].tolist()):
        assert time.monotonic() < deadline, f"none of {codes} within {seconds:.0f} s"
        time.sleep(0.3)


def broken_off(log, how):
    """Why a motion ended before this test ended it; on a busy computer, frames come later than a drive may wait."""
    events = LogReader(log).read("event")
    text_of = {
        code: events["text"][events["code"] == code].tolist() for code in (b"drive_stopped", b"drive_not_rearmed")
    }
    stopped = [text for text in text_of[b"drive_stopped"] if b"the flight ends" not in text]
    started_again = text_of[b"drive_not_rearmed"][how == "kill" :]  # the first is what this test brings about
    return stopped + started_again


def driven(directory, how):
    """The log of a motion, where the axes have been, and why it ended early if it did."""
    directory.mkdir()
    vehicle = written(directory, PRIOR, ROWS, csv=csv_of(*swing(SECONDS)))
    log = directory / "driven.mcap"
    command = [sys.executable, "-m", "onboard.cli", "fly", str(vehicle), "--arm", "--log", str(log)]
    with (
        served(vehicle, directory / "served") as (url, found),
        subprocess.Popen(
            [*command, f"--url=can_0={url}"],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        ) as flight,
        ended(flight),
    ):
        until(flight, b"drive_armed")
        await_event(log, {b"drive_started", b"drive_stopped"})
        time.sleep(5.0)  # a fifth of the motion
        if how == "kill":
            os.kill(pids(flight.pid)["heft-acquire"], signal.SIGKILL)
            until(flight, b"drive_not_rearmed")
            time.sleep(1.0)
        flight.send_signal(signal.SIGTERM)
        flight.communicate(timeout=60)
        assert flight.returncode == 0
    return log, found, broken_off(log, how)


@pytest.mark.parametrize("how", ["kill", "term"])
def test_the_arm_stops_in_mid_motion(tmp_path, how):
    why = []
    for number in range(4):
        log, found, early = driven(tmp_path / str(number), how)
        if not early:
            break
        why += early
    else:
        raise AssertionError(f"four motions ended early: {why}")
    for name, size in (("shoulder", 0.5), ("elbow", 0.4)):
        axis = found[name]
        went = axis["highest_rad"] - axis["lowest_rad"]
        assert 0.1 * size < went < 0.9 * size, "it was in mid-motion"
        assert (axis["rate_rad_s"], axis["state"]) == (0.0, "40h")
        assert axis["fastest_rad_s"] < 0.2
    events = LogReader(log).read("event")
    codes = set(events["code"].tolist())
    assert ({b"drive_not_rearmed"} if how == "kill" else {b"drive_stopped", b"drive_at_rest"}) <= codes
    sent = LogReader(log).read("shoulder_sent")
    assert np.isin([0x201, 0x301, 0x601, 0x77F], sent["cob_id"]).all()
