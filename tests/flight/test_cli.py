"""The command line on bad input: a sentence with the remedy, exit code 2, no traceback."""

from pathlib import Path

import pytest

from onboard import cli, config

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
