"""The systemd units against the flight app that they start."""

import configparser
import re
from pathlib import Path

from onboard import cli
from onboard.config.vehicle import Realtime
from onboard.flight.supervise import runner_processes

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"


def unit(name: str) -> configparser.ConfigParser:
    parser = configparser.ConfigParser(strict=False, interpolation=None)
    parser.optionxform = str  # type: ignore[assignment,method-assign]  # keys of systemd are case-sensitive
    parser.read_string((DEPLOY / name).read_text(encoding="utf-8"))
    return parser


def test_it_flies_from_where_the_installer_puts_it() -> None:
    program, command, vehicle = unit("heft.service")["Service"]["ExecStart"].split()
    installer = (DEPLOY / "install.sh").read_text(encoding="utf-8")
    prefix = re.search("^prefix=(.*)$", installer, re.MULTILINE)
    file = re.search("^vehicle_file=(.*)$", installer, re.MULTILINE)
    assert prefix
    assert file
    assert (program, command, vehicle) == (f"{prefix[1]}/.venv/bin/heft", "fly", file[1])


def test_its_limits_grant_what_acquisition_asks_for() -> None:
    service = unit("heft.service")["Service"]
    assert int(service["LimitRTPRIO"]) >= Realtime().acquisition_priority
    assert service["LimitMEMLOCK"] == "infinity"


def test_it_waits_until_three_workers_have_stopped() -> None:
    service = unit("heft.service")["Service"]
    assert service["KillMode"] == "mixed"  # SIGTERM to the supervisor only, which stops the workers in order
    assert float(service["TimeoutStopSec"]) > 3 * runner_processes.STOP_TIMEOUT_S


def test_the_watchdog_leaves_the_supervisor_time_to_restart_its_workers() -> None:
    service = unit("heft.service")["Service"]
    assert (service["Type"], service["NotifyAccess"]) == ("notify", "main")
    assert float(service["WatchdogSec"]) > runner_processes.LONGEST_SILENCE_S + runner_processes.HUNG_S
    assert float(service["TimeoutStartSec"]) > runner_processes.START_TIMEOUT_S


def test_it_never_gives_up_and_stays_down_after_a_flight() -> None:
    service = unit("heft.service")
    assert service["Service"]["Restart"] == "on-failure"
    assert service["Unit"]["StartLimitIntervalSec"] == "0"
    assert service["Service"]["RestartPreventExitStatus"] == str(cli.BAD_INPUT)


def test_shared_memory_is_left_for_the_next_start() -> None:
    """systemd would remove the rings as the user's IPC; what they hold goes into the log at the next start."""
    assert "RemoveIPC" not in unit("heft.service")["Service"]
