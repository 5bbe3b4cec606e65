"""Campaigns on real worker processes, a worker, the scheduler or the client killed: the results of a serial run."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pyarrow.dataset
import pytest

from onboard import cli
from onboard.cli.campaign import fly
from onboard.ground.campaign import plan_file
from onboard.ground.campaign.design import items
from onboard.ground.campaign.flights import OtherCodeError
from onboard.ground.campaign.revision import revision
from onboard.recording.reader import LogReader
from tests.ground.campaign.processes import (
    MISSION,
    campaign,
    dask,
    free_port,
    results,
    running,
    serial,
    until,
    workers_of,
)

LONGEST_S = 120.0
CALLED = """[campaign]
name = "called"
seeds = 12
[flight]
call = "tests.ground.campaign.called:drawn"
[settings]
seconds = 0.15
"""


def written(tmp_path: Path, text: str) -> Path:
    plan = tmp_path / "plan.toml"
    plan.write_text(text)
    return plan


def test_a_worker_killed_in_flight_costs_nothing_but_the_flight_again(tmp_path: Path) -> None:
    flown = tmp_path / "flown"
    plan = written(tmp_path, CALLED.replace("0.15", "0.4").replace("12", "4") + f'flown = "{flown}"\n')
    expected = serial(tmp_path / "serial", plan)
    flown.unlink()
    with running(tmp_path / "scratch", *campaign(tmp_path / "out", plan, "--jobs", "1")) as client:
        until(
            lambda: flown.exists() or client.poll() is not None, LONGEST_S
        )  # a flight is over, and the next has begun
        time.sleep(0.1)
        (worker,) = workers_of(client)
        os.kill(worker, signal.SIGKILL)
        assert client.wait(LONGEST_S) == 0
    assert results(tmp_path / "out") == expected
    table = pyarrow.dataset.dataset(tmp_path / "out" / "flights").to_table().to_pylist()
    assert sorted(row["seed"] for row in table) == [1, 2, 3, 4]
    assert all(row["supported"] for row in table)


def test_one_flight_is_flown_again_and_keeps_its_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    plan = plan_file.read(written(tmp_path, MISSION.format(seeds=2)))
    flight = items(plan)[1].address(revision())
    assert cli.main(["campaign", "plan.toml", "--again", flight[:8]]) == cli.OK
    assert ": right" in capsys.readouterr().out
    assert "imu_base" in LogReader(tmp_path / f"{flight}.mcap").channels
    truth = json.loads((tmp_path / f"{flight}.mcap.truth.json").read_text())
    assert truth["seed"] == 2
    assert cli.main(["campaign", "plan.toml", "--again", "none"]) == cli.BAD_INPUT


def test_scheduler_and_client_are_killed_and_every_flight_is_there_once(tmp_path: Path) -> None:
    """One flight fails, once; and once again when that is asked for."""
    flown = tmp_path / "flown"
    plan = written(tmp_path, f'{CALLED.replace("0.15", "0.4")}flown = "{flown}"\nfails = [12]\n')
    expected = serial(tmp_path / "serial", plan)
    flown.unlink()
    port, out, scratch = free_port(), tmp_path / "out", tmp_path / "scratch"
    scheduler, worker = dask(port)
    told = campaign(out, plan, "--scheduler", f"tcp://127.0.0.1:{port}")

    def done() -> int:
        return len(results(out))

    with running(scratch, *scheduler) as first, running(scratch, *worker), running(scratch, *told) as client:
        until(lambda: done() >= 2, LONGEST_S)
        first.kill()
        first.wait()
        with running(scratch, *scheduler), running(scratch, *worker):
            before = done()
            until(lambda: done() > before, LONGEST_S)
            client.kill()
            client.wait()
            assert done() < len(expected)
            for more in ((), ("--retry",)):
                with running(scratch, *told, *more) as again:
                    assert again.wait(LONGEST_S) == cli.FAILED
    assert results(out) == expected
    assert len(expected) == 11
    assert flown.read_text().split().count("12") == 2
    (kept,) = (tmp_path / "out" / "failed").glob("*.json")
    assert "RuntimeError: seed 12 does not fly" in kept.read_text()


def test_with_tls_as_the_page_says_a_campaign_flies_and_nobody_else_is_heard(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (Path(__file__).parents[3] / "docs" / "campaigns.md").read_text(encoding="utf-8")
    [shell] = [block for block in page.split("```sh\n")[1:] if "openssl" in block]
    made = [line for line in shell.splitlines() if line.startswith(("openssl", "cat"))]
    subprocess.run("\n".join(made), shell=True, cwd=tmp_path, check=True, capture_output=True)
    said = [line for line in shell.splitlines() if line.startswith(("export", "for"))]
    told = subprocess.run(
        "\n".join([*said, "env"]), shell=True, cwd=tmp_path, check=True, capture_output=True, text=True
    ).stdout
    environment = dict(line.split("=", 1) for line in told.splitlines() if line.startswith("DASK_DISTRIBUTED__"))
    assert len(environment) == 5
    plan = written(tmp_path, CALLED.replace("12", "2"))
    expected = serial(tmp_path / "serial", plan)
    port, out, scratch = free_port(), tmp_path / "out", tmp_path / "scratch"
    scheduler, worker = ([part.replace("tcp://", "tls://") for part in one] for one in dask(port))
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    with running(scratch, *scheduler, "--protocol", "tls"), running(scratch, *worker):
        with running(scratch, *campaign(out, plan, "--scheduler", f"tls://127.0.0.1:{port}")) as client:
            assert client.wait(LONGEST_S) == cli.OK
        assert results(out) == expected
        for name in environment:
            monkeypatch.delenv(name)
        stranger = "from distributed import Client; Client('{}://127.0.0.1:{}', timeout=3)"
        for protocol in ("tls", "tcp"):
            asked = [sys.executable, "-c", stranger.format(protocol, port)]
            assert subprocess.run(asked, capture_output=True, timeout=60, check=False).returncode != 0


def test_a_worker_of_another_version_is_refused(tmp_path: Path) -> None:
    (item, *_) = items(plan_file.read(written(tmp_path, CALLED)))
    with pytest.raises(OtherCodeError, match="this one of another"):
        fly(item, "another")


def test_no_scheduler_is_said_with_the_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("onboard.ground.campaign.engine._ANSWERS_S", 1)
    plan = written(tmp_path, CALLED)
    told = ["campaign", str(plan), "-o", str(tmp_path / "out"), "--scheduler", f"tcp://127.0.0.1:{free_port()}"]
    assert cli.main(told) == cli.BAD_INPUT
