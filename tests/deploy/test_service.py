"""The systemd units against the flight app that they start."""

import configparser
from pathlib import Path

from onboard.flight import runner_processes, workers

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"


def unit(name: str) -> configparser.ConfigParser:
    parser = configparser.ConfigParser(strict=False, interpolation=None)
    parser.optionxform = str  # type: ignore[assignment,method-assign]  # keys of systemd are case-sensitive
    parser.read_string((DEPLOY / name).read_text(encoding="utf-8"))
    return parser


def test_it_flies_from_the_environment_that_the_scripts_make() -> None:
    program, command, vehicle = unit("heft.service")["Service"]["ExecStart"].split()
    assert (program, command) == ("/opt/heft/.venv/bin/heft", "fly")
    assert "/opt/heft/deploy/hil.sh" in (DEPLOY / "pi.md").read_text(encoding="utf-8")
    assert vehicle == "/etc/heft/vehicle.toml"


def test_its_limits_grant_what_acquisition_asks_for() -> None:
    assert int(unit("heft.service")["Service"]["LimitRTPRIO"]) >= workers.REALTIME_PRIORITY


def test_it_waits_until_three_workers_have_stopped() -> None:
    service = unit("heft.service")["Service"]
    assert service["KillMode"] == "mixed"  # SIGTERM to the supervisor only, which stops the workers in order
    assert float(service["TimeoutStopSec"]) > 3 * runner_processes.STOP_TIMEOUT_S


def test_it_never_gives_up_and_stays_down_after_a_flight() -> None:
    service = unit("heft.service")
    assert service["Service"]["Restart"] == "on-failure"
    assert service["Unit"]["StartLimitIntervalSec"] == "0"
