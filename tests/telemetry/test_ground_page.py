"""The section on the downlink of docs/ground.md: its commands run, its numbers are those of the code."""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from onboard import cli
from onboard.channels import Order
from onboard.config.telemetry import Telemetry
from onboard.telemetry.packets import KINDS, REFUSALS, SECONDARY
from onboard.telemetry.span import MOST_ROWS
from onboard.telemetry.uplink import LONGEST_SPAN_S, SERVICE
from tests.flight.missions import Result

ROOT = Path(__file__).parents[2]
SECTION = re.split(r"^## ", (ROOT / "docs/ground.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
[DOWNLINK] = [text for text in SECTION if text.startswith("Downlink\n")]


def test_the_commands_run_and_a_stranger_reads_what_they_write(
    short_mission: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "flights").mkdir()
    shutil.copy(short_mission.path, tmp_path / "flights/rocksat-001.mcap")
    monkeypatch.chdir(tmp_path)
    [block], [program] = (
        re.findall(rf"^```{kind}\n(.*?)^```", DOWNLINK, re.DOTALL | re.MULTILINE) for kind in ("sh", "python")
    )
    lines = block.splitlines()
    assert len(lines) == 4
    for line in lines:
        assert cli.main(shlex.split(line, comments=True)[1:]) == cli.OK, line
    assert '"packet": "answer"' in capsys.readouterr().out
    read = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    low, value, high = map(float, read.splitlines()[-1].split()[1:])
    assert low < value < high


def test_the_table_of_packets_is_that_of_the_code() -> None:
    rows = re.findall(r"^\| `(\w+)` \| (\d+) \| (\d+) \| (.*?) \|", DOWNLINK, re.MULTILINE)
    apids, settings = Telemetry().apids, Telemetry()
    assert [(name, int(apid), int(size)) for name, apid, size, _ in rows] == [
        (name, apids[name], kind.length) for name, kind in KINDS.items()
    ]
    comes = {name: when for name, _, _, when in rows}
    hz = {"answer": settings.answers_hz, "phase": settings.phase_hz, "reason": settings.reasons_hz}
    for name, rate in (hz | {"flight": settings.flight_hz}).items():
        assert f"every {1 / rate:g} s" in comes[name]
    assert settings.status_hz == 1
    assert f"secondary header of {SECONDARY.size} bytes" in DOWNLINK
    assert f"`bytes_s` ({settings.bytes_s:,.0f})" in DOWNLINK
    ten = 10 * KINDS["answer"].length * settings.answers_hz
    assert f"answers take {ten:.0f} bytes" in DOWNLINK


def test_the_tables_of_commands_are_those_of_the_code() -> None:
    codes = re.findall(r"^\| (\d) ([a-z ]+) \|", DOWNLINK, re.MULTILINE)
    assert [(int(code), word) for code, word in codes] == [*REFUSALS[1:]]
    names = re.findall(r"^\| `(mark|stop|span)\b", DOWNLINK, re.MULTILINE)
    assert names == [order.name.lower() for order in Order]
    for order in Order:
        assert f"{int(order)} {order.name.lower()}" in DOWNLINK
    assert f"APID `command_apid` ({Telemetry().command_apid}), service {SERVICE}," in DOWNLINK
    assert f"{LONGEST_SPAN_S} s and {MOST_ROWS:,} rows at most" in DOWNLINK
