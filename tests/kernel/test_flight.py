"""The flight app as it is, flying two sweeps of RockSat-X in real time on this kernel's /dev/i2c-9 and vcan0.

The pulse line comes as datagrams, for this kernel has no GPIO. Devices and flight app share one CPU with each other.
"""

import contextlib
import itertools
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Self

import network
import numpy as np
import pytest
from numpy.typing import NDArray
from rich.console import Console

from bench.timebase import rms, solution_errors_us
from drivers import records
from drivers.records import Rows
from onboard import config
from onboard.flight.hil import Flown
from onboard.ground.identify.mission import mission_table as table
from onboard.recording.reader import LogReader
from tests.flight.missions import SHORT_REAL, inline

CHECKOUT = Path(__file__).resolve().parents[2]
RESULTS = Path("/run/results")
SEED = 1
FLIGHTS = 2  # one on which this computer had no time for the guest is flown again, unless it had none in either half
MOST_OVERRUN = 0.05  # of the IMU's samples: its FIFO holds 73 ms, and beyond this the guest had no time
TOO_BUSY = {b"estimator_skips"}


class Mission:
    """The devices of a mission in a process of their own."""

    def __init__(self, directory: Path) -> None:
        scenario = directory / "two_sweeps.toml"
        sequence = ", ".join(map(inline, SHORT_REAL))
        scenario.write_text(f'sequence = [{sequence}]\n[scenario]\nbased_on = "rocksat"\n', encoding="utf-8")
        self.process = subprocess.Popen(
            [
                *(sys.executable, "deploy/kernel/serve_mission.py", str(scenario), "--seed", str(SEED)),
                *("--directory", str(directory)),
            ],
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": str(CHECKOUT)},
        )
        self.urls: dict[str, Any] = {}

    def __enter__(self) -> Self:
        try:
            self.urls = self._line()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.communicate()

    def end(self) -> dict[str, Any]:
        """End the devices: what was made, what was true, what the server lost."""
        self.process.terminate()
        return self._line()

    def _line(self) -> dict[str, Any]:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line, "the devices are gone; their message stands above"
        return dict(json.loads(line))


@contextlib.contextmanager
def flying(mission: Mission, directory: Path) -> Iterator[Callable[..., tuple["subprocess.Popen[str]", Path]]]:
    """Starts ``heft fly`` on the mission's buses; the process and its log."""
    started: list[subprocess.Popen[str]] = []

    def start(*arguments: str) -> tuple["subprocess.Popen[str]", Path]:
        log = directory / "flight.mcap"
        urls = itertools.chain.from_iterable(("--url", f"{bus}={url}") for bus, url in mission.urls.items())
        vehicle = str(config.packaged("rocksat"))
        started.append(subprocess.Popen(["heft", "fly", vehicle, "--log", str(log), *urls, *arguments], text=True))
        return started[-1], log

    try:
        yield start
    finally:
        for process in started:
            process.kill()
            process.wait()


def read(log: Path) -> dict[str, Rows]:
    """All rows of a log by channel."""
    reader = LogReader(log)
    batches: dict[str, list[Rows]] = {}
    for channel, rows in reader.batches():
        batches.setdefault(channel, []).append(rows)
    return {channel: np.concatenate(rows) for channel, rows in batches.items()}


def rows_of_kind(log: dict[str, Rows], kind: np.dtype[np.void]) -> Rows:
    return np.concatenate([rows for rows in log.values() if rows.dtype == kind] or [np.zeros(0, kind)])


def whole_flight(directory: Path) -> tuple[Path, dict[str, Any]]:
    """The log of a whole flight and what its devices did."""
    directory.mkdir()
    with Mission(directory) as mission, flying(mission, directory) as fly:
        app, log = fly()
        assert app.wait(180) == 0
        return log, mission.end()


def overrun(host_ns: NDArray[np.int64], produced: int) -> tuple[float, float]:
    """Shares of a flight's samples that are not in its log, of its first half and its second."""
    early = int(np.searchsorted(host_ns, host_ns[0] + (host_ns[-1] - host_ns[0]) // 2))
    return 1.0 - 2.0 * early / produced, 1.0 - 2.0 * (len(host_ns) - early) / produced


@pytest.mark.timeout(400)
def test_the_mission_flies_and_the_table_comes_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for number in range(FLIGHTS):
        log, end = whole_flight(tmp_path / str(number))
        flown = read(log)
        codes = {code for rows in flown.values() if rows.dtype == records.EVENT for code in rows["code"].tolist()}
        halves = overrun(flown["imu_base"]["host_ns"], end["produced"]["imu_base"])
        overran, busy = sum(halves) / 2, ""
        if TOO_BUSY.isdisjoint(codes) and overran < MOST_OVERRUN:
            break
        busy = f"the guest had too little time: {overran:.0%} of the IMU's samples overran, {sorted(TOO_BUSY & codes)}"
        if min(halves) > MOST_OVERRUN:  # it is slow, and not busy for a while: a second flight would be as this one
            break
    result = table.result(Flown(log, end["produced"], end["truth"]))
    clocks_us = {
        channel: rms(solution_errors_us(log, end["truth"], channel, clock, grid_ns))
        for channel, clock, grid_ns in (("imu_base", "imu_base", 1e6), ("can_sync", "sync_box", 5e6))
    }
    told = {**result, "server": end["server"], "clocks_us": clocks_us}
    (RESULTS / "flight.json").write_text(json.dumps(told, indent=1), encoding="utf-8")
    with capsys.disabled():
        console = Console(width=100)
        console.print(table.render(result))
        console.print("clocks, rms:", *(f"{channel} {error:.1f} us" for channel, error in clocks_us.items()))

    server, counted = end["server"], result["channels"]
    assert server["can_0"]["frames_not_taken"] == 0
    assert server["i2c_1"]["refused"] == 0
    for channel in ("joint_1", "load_cell", "arm_phase"):
        account = counted[channel]
        assert account["accounted"], (channel, account)  # exactly, but for gap records that say that they are estimates
        assert account["produced"] > 0, channel
    pulse, not_taken = counted["pulse"], server["sync_line"]["edges_without_receiver"]
    assert pulse["recorded"] > 85
    assert 0 <= pulse["produced"] - pulse["recorded"] <= not_taken + 1  # one after the end, as of the SYNC below
    assert pulse["missing"] <= not_taken
    gaps = rows_of_kind(flown, records.GAP)
    imu = counted["imu_base"]
    imu_gaps = int((gaps["channel"] == b"imu_base").sum())
    late_host_ms = 20  # the length of a gap is by host stamps, and those may be two polls late
    assert abs(imu["recorded"] + imu["missing"] - imu["produced"]) <= imu_gaps * late_host_ms
    sync = counted["can_sync"]
    after_the_end = sync["produced"] - sync["recorded"] - sync["missing"]
    # one may come between the driver's last look and its muting of the socket; a gap record may be an estimate
    assert sync["accounted"] or after_the_end == 1, sync
    assert (np.diff(flown["can_sync"]["host_ns"]) > 0).all()
    if busy:
        pytest.skip(f"{busy}: what was recorded is accounted for, and what was estimated is not looked at")
    assert imu["recorded"] > 14_400
    assert result["identified"]
    assert len(result["masses"]) == 3
    for row in result["masses"] + result["inertias"]:
        half_width = 0.5 * (row["high"] - row["low"])
        assert abs(row["value"] - row["truth"]) < 3.0 * half_width, row  # six sigma: one flight, any noise
    twice_the_bars_us = {"imu_base": 120.0, "can_sync": 40.0}
    assert clocks_us["imu_base"] < twice_the_bars_us["imu_base"]
    assert clocks_us["can_sync"] < twice_the_bars_us["can_sync"]


@pytest.mark.timeout(120)
def test_an_interface_that_goes_down_in_flight_is_named_and_flown_on(tmp_path: Path) -> None:
    with Mission(tmp_path) as mission, flying(mission, tmp_path) as fly:
        app, path = fly("--duration", "8")
        line = Path(mission.urls["sync_line"].removeprefix("gpio+unix://"))
        while mission.process.poll() is None and not line.exists():
            time.sleep(0.05)
        time.sleep(4.0)
        network.set_up("vcan0", False)
        time.sleep(0.5)
        network.set_up("vcan0")
        assert app.wait(60) == 0
    log = read(path)
    events = rows_of_kind(log, records.EVENT)
    of_bus = events[events["source"] == b"can_0"]["code"].tolist()
    assert of_bus.index(b"bus_error") < of_bus.index(b"bus_recovered")
    assert any(b"down" in text for text in events[events["code"] == b"bus_error"]["text"])
    gaps = rows_of_kind(log, records.GAP)
    for channel in ("can_sync", "joint_1", "load_cell"):
        rows, lost = log[channel], gaps[gaps["channel"] == channel.encode()]
        missing = int((lost["last_missing"] - lost["first_missing"] + 1).sum())
        assert missing > 50  # half a second of 200 Hz
        last = max(rows["sequence"][-1], lost["last_missing"].max())  # the last of all may be a missing one
        assert len(rows) + missing == last + 1
        assert (np.diff(rows["tick"].astype(np.int64)) == np.diff(rows["sequence"].astype(np.int64))).all()
    imu_gaps = gaps[gaps["channel"] == b"imu_base"]
    assert set(imu_gaps["cause"]) <= {b"fifo_overflow"}  # the other buses did not notice
