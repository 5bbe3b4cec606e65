"""``heft telemetry``, and ``--telemetry`` of the commands that fly."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from space_packet_parser.generators.ccsds import ccsds_generator
from space_packet_parser.xtce.definitions import XtcePacketDefinition

from onboard import cli
from onboard.cli.common import console
from onboard.config.telemetry import Telemetry
from onboard.flight.health.status import NO_HEALTH
from onboard.flight.supervise.modes import Mode
from onboard.identification.standing import LEVELS
from onboard.telemetry import link, packets, xtce
from onboard.telemetry.board import PacketBoard, verdict
from onboard.telemetry.stream import Series, Splitter
from tests.flight.missions import Result
from tests.telemetry.rows import START_NS, downlink, estimates, health, said


def run(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    code = cli.main(arguments)
    out, err = capsys.readouterr()
    return code, out, err


@pytest.fixture
def sent(tmp_path: Path) -> Path:
    """Packets of a few seconds, in a file."""
    sender, path = downlink(), tmp_path / "down.bin"
    data = b""
    for step in range(200):
        now_ns = START_NS + step * 50_000_000
        sender.add(health(now_ns, rows=1000 + step, status_latched=4))
        sender.add(estimates(now_ns, ("m_[payload]", "c_x"), supported=[1, 0], level=[0, 2], why=[b"", b"[bold]signs"]))
        if step == 30:
            sender.add(said(now_ns, "run: every device answers", code="mode"))
        data += b"".join(sender.packets(now_ns))
    path.write_bytes(data)
    return path


def test_words_are_those_of_the_flight() -> None:
    assert packets.MODES[:-1] == tuple(enumerate(mode.value for mode in Mode))
    assert tuple(enumerate(str(level) for level in LEVELS)) == packets.LEVELS


def test_a_file_is_read_and_shown(sent: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(["telemetry", "--decode", str(sent)], capsys)
    assert code == cli.OK
    for said_ in (
        "NO-GO: 1 of 2 answers are not good; status ok (before: rows missing)",
        "m_[payload]",
        "do not use: [bold]signs",
        "missing none",
    ):
        assert said_ in out
    assert max(map(len, out.splitlines())) <= 80
    [row] = [line for line in out.splitlines() if line.startswith("c_x ")]
    assert row.split() == ["c_x", "kg", "do", "not", "use"]


def test_go_and_no_go() -> None:
    status = {"word": 0, "latched": 4, "health_age": 0.5}
    good = {"quantity": "m", "unit": "kg", "level": "good", "supported": "yes"}
    assert verdict(status, [good]) == "GO: status ok (before: rows missing)"
    assert verdict(status | {"word": 1 << 14, "latched": 1 << 14}, [good]) == "GO: status cpu busy"
    assert verdict(status | {"word": 1 << 4}, [good]).startswith("NO-GO: status rows not recorded")
    assert verdict(status, []) == "NO-GO: no answer yet; status ok (before: rows missing)"
    assert verdict(status, [good | {"level": "weak"}]).startswith("NO-GO: 1 of 1 answers are not good")
    assert verdict(status, [good | {"unit": "N", "level": "weak"}]).startswith("NO-GO: no answer yet")
    silent = {"word": NO_HEALTH, "latched": NO_HEALTH | 4, "health_age": 7.2}
    assert verdict(silent, [good]) == "NO-GO: health not known for 7 s; status ok (before: rows missing)"
    again = verdict(status | {"latched": NO_HEALTH}, [good])
    assert again == "GO: status ok (health was not known for some time)"


def test_every_packet_as_json(sent: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = run(["telemetry", "--decode", str(sent), "--json-lines"], capsys)
    assert code == cli.OK
    lines = [json.loads(line) for line in out.splitlines()]
    assert len(lines) == len(list(ccsds_generator(sent.read_bytes())))
    assert {line["packet"] for line in lines} == set(packets.KINDS) - {"report", "failure"}
    refused = [line for line in lines if line["packet"] == "answer" and line["quantity"] == "c_x"]
    assert refused
    assert all(line["value"] is None for line in refused)
    assert "missing none" in err


def test_a_damaged_file_ends_with_3_and_says_what_is_missing(sent: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = bytearray(sent.read_bytes())
    data[len(data) // 2] ^= 0x10
    sent.write_bytes(data)
    code, out, _ = run(["telemetry", "--decode", str(sent)], capsys)
    assert code == cli.DAMAGED
    assert "belong to no whole packet" in out
    assert "missing none" not in out


@pytest.mark.parametrize("data", [b"", b"not a packet at all" * 100])
def test_a_file_without_packets_is_refused(data: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "notes"
    path.write_bytes(data)
    code, _, err = run(["telemetry", "--decode", str(path)], capsys)
    assert code == cli.BAD_INPUT
    assert "no packet of this downlink" in err


def test_the_database_of_a_vehicle_reads_the_packets_of_its_log(
    short_mission: Result, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    down = tmp_path / "down.bin"
    code, out, _ = run(["telemetry", str(short_mission.path), "--send", f"file://{down}"], capsys)
    assert code == cli.OK
    count = int(out.split()[0])
    for of in (["rocksat"], [str(short_mission.path)], []):
        code, out, _ = run(["telemetry", *of, "--xtce", str(tmp_path / "db")], capsys)
        assert (code, out.strip()) == (cli.OK, str(tmp_path / "db/heft.xml"))
        what = XtcePacketDefinition.from_xtce(tmp_path / "db/heft.xml", root_container_name=xtce.ROOT)
        read = [dict(what.parse_bytes(packet)) for packet in ccsds_generator(down.read_bytes())]
        assert len(read) == count > 40
        assert any("m_arm_value" in packet for packet in read) == bool(of)
    assert run(["telemetry", str(short_mission.path), "--decode", str(down)], capsys)[0] == cli.OK


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["telemetry", "rocksat", "--send", "file://x"], "--send sends what was flown: name a log"),
        (["telemetry", "--xtce", "db", "--json-lines"], "--json-lines goes with --decode"),
        (["telemetry", "--decode", "tcp://a:1"], "give udp://HOST:PORT"),
        (["telemetry", "--decode", "nowhere.bin"], "nowhere.bin: no such file or directory"),
        (["telemetry", "rocksatt", "--xtce", "db"], "did you mean 'rocksat'?"),
        (["hil", "rocksat", "--telemetry", "file://x"], "add --realtime"),
    ],
)
def test_what_cannot_be_is_refused(
    arguments: list[str],
    why: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, err = run(arguments, capsys)
    assert code == cli.BAD_INPUT
    assert why in err
    assert list(tmp_path.iterdir()) == []


def test_two_kinds_of_one_apid_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["init", str(tmp_path / "mine"), "--from", "rocksat"]) == cli.OK
    path = tmp_path / "mine/vehicle.toml"
    path.write_text(path.read_text() + "\n[telemetry]\nevent_apid = 256\n")
    code, _, err = run(["telemetry", str(path), "--xtce", str(tmp_path / "db")], capsys)
    assert code == cli.BAD_INPUT
    assert "APID 256 is that of status packets too; give it another" in err
    path.write_text(path.read_text().replace("event_apid = 256", "event_apid = 300"))
    code, _, _ = run(["telemetry", str(path), "--xtce", str(tmp_path / "db")], capsys)
    assert code == cli.OK
    assert Telemetry().event_apid == 259
    assert "300" in (tmp_path / "db/heft.xml").read_text()


def test_a_silent_line_is_never_a_go(sent: Path) -> None:
    stream, series = Splitter(Telemetry().apids), Series()
    board = PacketBoard(stream, series)
    for packet in stream.feed(sent.read_bytes()):
        assert series.place(packet).new
        board.add(packet)

    def shown(silent_s: float) -> str:
        screen = console()
        with screen.capture() as captured:
            screen.print(board.render(silent_s))
        return captured.get()

    assert "nothing has come" not in shown(2.0)
    assert "NO-GO: nothing has come for 31 s; before:" in shown(31.0)


def test_a_line_that_is_pulled_ends_with_what_came(
    sent: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def pulled(address: link.Address, commands: object) -> Iterator[bytes]:
        yield sent.read_bytes()
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(link, "received", pulled)
    code, out, err = run(["telemetry", "--decode", "serial:///dev/ttyUSB0?baud=19200"], capsys)
    assert code == cli.OK
    assert "m_[payload]" in out
    assert "serial:///dev/ttyUSB0?baud=19200: [Errno 5] Input/output error" in err
