"""Files that somebody crafted: refused with a sentence and the exit code, or shown without harm."""

import os
import zipfile

import numpy as np
import pytest

from bench.fuzzing.files import as_list, packed
from drivers import records
from onboard import channels, cli, config
from onboard.offline.bring_in.errors import SourceError
from onboard.offline.bring_in.foreign import read_npz
from onboard.offline.tables.vehicle_file import vehicle_of
from onboard.recording.reader import LogReader
from onboard.recording.writer import LogWriter
from tests.recording.logs import MemorySink

ROCKSAT = config.packaged("rocksat").read_text(encoding="utf-8")
URDF = config.packaged("rocksat").with_name("rocksat.urdf").read_bytes()


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"\xff\xfe" + ROCKSAT.encode(), "is not UTF-8 text (byte 0)"),
        (b"a = " + b"[" * 100_000, "nested too deep"),
        (b"a = " + b"[" * 100 + b"]" * 100, "nested too deep"),
        (b"a." * 50 + b"b = 1", "nested too deep"),
        (b"a = " + b"9" * 5000, "not TOML"),
        (b"# " + b"x" * (1 << 20), "more than 1 MiB"),
        (ROCKSAT.replace("can+socketcan://can0", "can+socketcan://[can0").encode(), "Invalid IPv6 URL"),
    ],
    ids=["no text", "endless", "deep", "dotted", "long number", "long", "url"],
)
def test_a_vehicle_file(tmp_path, capsys, data, said):
    file = tmp_path / "vehicle.toml"
    file.write_bytes(data)
    for command in (["preflight", str(file)], ["fly", str(file)]):
        assert cli.main(command) == cli.BAD_INPUT
        assert said in capsys.readouterr().err


def test_a_vehicle_file_that_is_a_pipe_is_not_waited_for(tmp_path, capsys):
    os.mkfifo(tmp_path / "vehicle.toml")
    assert cli.main(["preflight", str(tmp_path / "vehicle.toml")]) == cli.BAD_INPUT
    assert "a pipe or a device" in capsys.readouterr().err


@pytest.mark.parametrize("header", [b"{'descr': ',',", b"(" * 90, b"{'descr': '<a2', 'shape': (2**60,), }", b"\xff"])
def test_an_array_whose_header_is_none(tmp_path, header):
    file = tmp_path / "run.npz"
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("a.npy", b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header)
    with pytest.raises(SourceError):
        read_npz(file)


@pytest.mark.parametrize("mapping", ["kuka_lwr4", "tudelft"])  # NPZ, CSV
@pytest.mark.parametrize("kind", ["pipe", "device", "endless"])
def test_a_recording_that_is_no_file_is_not_waited_for(tmp_path, capsys, mapping, kind):
    source = tmp_path / "run"
    if kind == "pipe":
        os.mkfifo(source)
    elif kind == "device":
        source.symlink_to("/dev/zero")
    else:
        with source.open("wb") as file:
            file.truncate(3 << 30)
    assert cli.main(["import", mapping, str(source), "-o", str(tmp_path / "logs")]) == cli.BAD_INPUT
    assert ("the limit is 2.1 GB" if kind == "endless" else "a pipe, a device") in capsys.readouterr().err
    assert not list((tmp_path / "logs").iterdir())


def test_a_log_whose_rows_have_no_time_is_damaged(tmp_path):
    rows = np.zeros(2, records.CAN_SYNC)
    sink = MemorySink(tmp_path / "x.mcap")
    with LogWriter(sink) as writer:
        writer.register("sync", records.CAN_SYNC)
        writer.write("sync", rows)
    whole = as_list(bytes(sink.data))
    altered = whole.replace(b"int64 host_ns", b"int64 most_ns")
    assert altered != whole
    [data] = packed(altered)
    (tmp_path / "x.mcap").write_bytes(data)
    assert "lacks the fields sequence and host_ns" in str(LogReader(tmp_path / "x.mcap").damage[0])
    assert cli.main(["info", str(tmp_path / "x.mcap")]) == cli.DAMAGED
    assert cli.main(["recover", str(tmp_path / "x.mcap"), "-o", str(tmp_path / "y.mcap")]) == cli.FAILED


NAMES = (b"[/b]", b"[red]m", b"\x1b[2J", b"\xff\xfa", b":skull:")


def test_names_in_rows_are_shown_and_not_obeyed(tmp_path, capsys):
    rows = np.zeros(len(NAMES), channels.QUANTITY)
    rows["name"] = rows["unit"] = rows["why"] = NAMES
    rows["supported"] = 1
    rows["sequence"] = rows["host_ns"] = range(len(NAMES))
    clocks = np.zeros(len(NAMES), channels.CLOCK)
    clocks["channel"], clocks["sequence"] = NAMES, range(len(NAMES))
    with LogWriter.create(tmp_path / "x.mcap", durable=False) as writer:
        for name, some in (("quantity", rows), ("clock", clocks), ("[/b]", clocks)):
            writer.register(name, some.dtype)
            writer.write(name, some)
    assert cli.main(["info", str(tmp_path / "x.mcap")]) in (cli.OK, cli.DAMAGED)
    shown = capsys.readouterr().out
    assert "[/b]" in shown
    assert ":skull:" in shown
    assert "\x1b[2J" not in shown


@pytest.mark.parametrize("name", ["..", ".", "../up.txt", "/etc/heft", "a/b", "n" * 300])
def test_an_attachment_is_never_written_outside(tmp_path, name):
    log, place = tmp_path / "x.mcap", tmp_path / "inside"
    with LogWriter.create(log, durable=False) as writer:
        writer.attach(name, "text/plain", b"hostile")
        writer.attach("vehicle.toml", "application/toml", ROCKSAT.encode())
        writer.attach(
            "rocksat.urdf", "application/xml", config.packaged("rocksat").with_name("rocksat.urdf").read_bytes()
        )
    place.mkdir()
    before = set(tmp_path.rglob("*"))
    assert vehicle_of(LogReader(log), place).file.vehicle.name == "rocksat"
    made = set(tmp_path.rglob("*")) - before
    assert {path.relative_to(place).as_posix() for path in made} == {"vehicle.toml", "rocksat.urdf"}
