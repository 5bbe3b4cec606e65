"""The command line on bad input: a sentence with the remedy, exit code 2, no traceback."""

import importlib.metadata
import sys
from pathlib import Path

import pytest
from rich.console import Group
from rich.table import Column, Table
from rich.text import Text

from onboard import cli, config
from onboard.cli.common import progress, show

ON_A_LOG = [
    ["info", "nowhere.mcap"],
    ["report", "nowhere.mcap"],
    ["replay", "nowhere.mcap"],
    ["replay", "nowhere.mcap", "--with", "x.toml"],
    ["dump", "nowhere.mcap", "--to", "csv", "out"],
    ["watch", "nowhere.mcap"],
    ["recover", "nowhere.mcap", "-o", "out.mcap"],
    ["merge", "nowhere.mcap", "also.mcap", "-o", "out.mcap"],
]


def run(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    code = cli.main(arguments)
    return code, capsys.readouterr().err


def test_a_vehicle_file_with_a_mistake_names_the_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = config.packaged("rocksat").read_text().replace("poll_period_ms = 10", "poll_period_us = 10000")
    vehicle = tmp_path / "vehicle.toml"
    vehicle.write_text(text)
    code, said = run(["fly", str(vehicle)], capsys)
    line = next(n for n, content in enumerate(text.splitlines(), 1) if "poll_period_us" in content)
    assert code == cli.BAD_INPUT
    assert f"vehicle.toml:{line}:" in said
    assert "did you mean 'poll_period_ms'" in said
    assert "Traceback" not in said


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["fly", "nowhere/vehicle.toml"], "give the path of a vehicle.toml"),
        (["hil", "moonshot"], "moonshot"),
        (["hil", "rocksatt"], "did you mean 'rocksat'?"),
        (["hil", "rocksat", "--fault", "stick:imu_base:1:2"], "did you mean stuck?"),
        (["hil", "rocksat", "--fault", "stuck:imu_bas:1:2"], "did you mean imu_base?"),
        (["hil", "rocksat", "--realtime", "--fault", "stuck:imu_bas:1:2"], "did you mean imu_base?"),
        (["hil", "rocksat", "--fault", "unplug:arm_phase:1:2"], "it can have: "),
        (["hil", "rocksat", "--fault", "stuck:imu_base:1e9:"], "the mission ends at"),
        (["fly", "rocksatt"], "did you mean 'rocksat'?"),
        (["preflight", "dymaflx"], "did you mean 'dymaflex'?"),
        (["identify"], "name a log"),
        *((command, "nowhere.mcap: no such file or directory; check the path") for command in ON_A_LOG),
        (["dump", "nowhere.mcap", "--to", "xlsx", "out"], "known formats: csv"),
        (["identify", "--vehicle", "nowhere.toml", "log.mcap"], "give the path of a vehicle.toml"),
        (["import", "nomapping", "source", "-o", "out"], "nomapping"),
    ],
)
def test_what_is_not_there_is_said_with_the_remedy(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, text = run(arguments, capsys)
    assert code == cli.BAD_INPUT
    assert said in text
    assert text.startswith("heft: ")
    assert list(tmp_path.iterdir()) == []


def test_a_log_that_is_no_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("not a log\n" * 100)
    for command in ("info", "replay"):
        code, text = run([command, str(path)], capsys)
        assert code == cli.BAD_INPUT
        assert "notes.txt" in text


def test_an_existing_log_is_never_written_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "flight.mcap"
    log.write_bytes(b"somebody's flight")
    code, text = run(["hil", "rocksat", "--log", str(log)], capsys)
    assert code == cli.BAD_INPUT
    assert "flight.mcap" in text
    assert log.read_bytes() == b"somebody's flight"


@pytest.mark.parametrize("arguments", [[], ["launch"], ["hil"], ["hil", "rocksat", "--seed", "one"]])
def test_arguments_that_are_none_end_in_2(arguments: list[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        cli.main(arguments)
    assert caught.value.code == cli.BAD_INPUT


def test_the_version_and_completion_are_printed(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        cli.main(["--version"])
    assert caught.value.code == cli.OK
    assert capsys.readouterr().out == f"heft {importlib.metadata.version('heft-flight')}\n"
    assert cli.main(["completion", "bash"]) == cli.OK
    script = capsys.readouterr().out
    assert "_shtab_heft_dump_option_strings" in script
    assert "-F _shtab_heft heft" in script


def test_hil_says_what_to_install_where_there_is_no_mujoco(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [name for name in sys.modules if name.startswith("hil_sim")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    code, said = run(["hil", "rocksat"], capsys)
    assert code == cli.BAD_INPUT
    assert "pip install mujoco" in said


@pytest.mark.parametrize("columns", [40, 80, 200])
def test_tables_never_lose_digits(
    columns: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    table = Table(*[Column(f"column {n}", justify="right") for n in range(6)], Column("in words"))
    numbers = [f"{n}.{n}234567890123" for n in range(6)]
    table.add_row(*numbers, "long text, which may be wrapped at the end of any word of it")
    show(Group(Text("a sentence that goes on for longer than any terminal of eighty columns has room, and on"), table))
    shown = capsys.readouterr().out
    assert all(number in shown for number in numbers)
    assert "\N{HORIZONTAL ELLIPSIS}" not in shown


def test_progress_goes_to_stderr() -> None:
    assert progress().console.stderr


def test_the_faults_of_a_scenario_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["hil", "rocksat_serial", "--faults"]) == cli.OK
    said = capsys.readouterr().out
    for text in ("KIND:DEVICE:START:END[:VALUE]", "joint_port", "unplug", "the adapter is pulled out"):
        assert text in said
    assert "bus_off" not in said, "there is no CAN in it"
