"""Files that somebody crafted: refused with a sentence and the exit code, or shown without harm."""

import json
import os
import subprocess
import sys
import zipfile

import numpy as np
import pytest

from bench.fuzzing.files import as_list, packed
from drivers import records
from onboard import channels, cli, config
from onboard.ground.identify.replay.replay import Pass, steps
from onboard.ground.log.bring_in.errors import SourceError
from onboard.ground.log.bring_in.foreign import read_npz
from onboard.ground.log.tables.vehicle_file import vehicle_of
from onboard.recording.format import mcap_format
from onboard.recording.format.errors import ChannelError
from onboard.recording.reader import LogReader
from onboard.recording.writer import LogWriter
from tests.recording.logs import MemorySink, make_log

ROCKSAT = config.packaged("rocksat").read_text(encoding="utf-8")
URDF = config.packaged("rocksat").with_name("rocksat.urdf").read_bytes()


# A process begins with its parent's peak of memory: a small one stands between pytest and the commands. It has loaded
# what they need, which would be most of their time, and forks a process for each.
FORKS = """import json, os, sys
import onboard.flight.check.preflight, onboard.flight.estimate.estimator, onboard.ground.log.bring_in.importer
from onboard import cli
for line in sys.stdin:
    directory, said, *words = json.loads(line)
    process = os.fork()
    if process == 0:
        os.chdir(directory)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os.dup2(os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 2)
        sys.exit(cli.main(words))
    _, status, used = os.wait4(process, 0)
    print(json.dumps([os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime, used.ru_maxrss / 1000]))
    sys.stdout.flush()
"""


@pytest.fixture(scope="module")
def forks():
    """The process that runs commands."""
    with subprocess.Popen([sys.executable, "-c", FORKS], stdin=-1, stdout=-1, text=True) as process:
        yield process
        process.stdin.close()


@pytest.fixture
def cost(forks, tmp_path):
    """Exit code, CPU seconds, megabytes and messages of a command in a process of its own."""

    def of(*arguments):
        said = tmp_path / "said"
        forks.stdin.write(json.dumps([os.getcwd(), *map(str, (said, *arguments))]) + "\n")
        forks.stdin.flush()
        return *json.loads(forks.stdout.readline()), said.read_text(encoding="utf-8")

    return of


def refused_at_once(cost, why, *arguments):
    """The command refuses its input with ``why`` in a message that a screen holds, soon and with little memory."""
    code, seconds, megabytes, said = cost(*arguments)
    assert code == cli.BAD_INPUT
    assert why in said
    assert len(said) < 11_000
    assert seconds < MOST_S
    assert megabytes < MOST_MB


MOST_S, MOST_MB = (
    4.5,
    350.0,
)  # a command that does nothing takes 0.2 s and 140 MB; before, these took 17 to 60 s, or 3 GB
BIG = {
    "dotted": (".".join("a" * 40_000) + " = 1\n" + ROCKSAT, "nested too deep"),
    "header": (ROCKSAT + "\n[" + ".".join("a" * 40_000) + "]\n", "nested too deep"),
    "quoted": (ROCKSAT + "\n[" + " . ".join(["'a'"] * 40_000) + "]\n", "nested too deep"),
    "devices": (
        ROCKSAT + "".join(f'[device.d{n}]\nkind = "qsb"\nbus = "x"\n' for n in range(20_000)),
        "a table has 20006 keys",
    ),
    "url": (
        ROCKSAT.replace("://can0", "://can0?" + "&".join(f"o{n}=1" for n in range(90_000))),
        "or more than 4096",
    ),
    "value": (ROCKSAT.replace('kind = "', 'kind = "' + "x" * 900_000, 1), "device"),
    "errors": (
        ROCKSAT + "".join(f"[device.d{n}]\n" for n in range(900)),
        "more like these",
    ),
}


@pytest.mark.parametrize("name", BIG)
def test_a_large_vehicle_file_is_refused_at_once(cost, tmp_path, name):
    text, why = BIG[name]
    (tmp_path / "vehicle.toml").write_text(text, encoding="utf-8")
    refused_at_once(cost, why, "preflight", tmp_path / "vehicle.toml")


def test_a_large_vehicle_file_in_a_log_stops_nobody(cost, tmp_path):
    with LogWriter.create(tmp_path / "x.mcap", durable=False) as writer:
        writer.attach("vehicle.toml", "application/toml", BIG["dotted"][0].encode())
        writer.register("sync", records.CAN_SYNC)
        writer.write("sync", np.zeros(1, records.CAN_SYNC))
    code, seconds, megabytes, _ = cost("info", tmp_path / "x.mcap")
    assert code == cli.OK
    assert seconds < MOST_S
    assert megabytes < MOST_MB


def test_a_tag_of_many_attributes_is_refused_at_once(cost, tmp_path):
    (tmp_path / "vehicle.toml").write_text(ROCKSAT, encoding="utf-8")
    many = b"<robot " + b" ".join(b'a%d="1"' % n for n in range(100_000))
    (tmp_path / "rocksat.urdf").write_bytes(URDF.replace(b"<robot", many, 1))
    refused_at_once(cost, "attributes; 64 is the most", "preflight", tmp_path / "vehicle.toml")


MAPPING = """[mapping]
name = "b"
format = "{}"
[time]
column = "t"
[channel.force]
record = "scalar"
value = {{ column = "f", scale = 1e-3, unit = "N", values = "physical" }}
"""


def write_long_header(path):
    """An array whose header has 600 MB of spaces, in an archive of 0.6 MB."""
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("t.npy", "w") as array,
    ):
        array.write(b"\x93NUMPY\x02\x00" + (600_000_000).to_bytes(4, "little"))
        for _ in range(60):
            array.write(b" " * 10_000_000)


@pytest.mark.parametrize(
    ("kind", "fill", "why"),
    [
        ("npz", write_long_header, "t.npy has a header of 600000000 bytes"),
        ("csv", lambda path: os.truncate(path, 1_500_000_000), "a line of more than 1048576 characters"),
        ("csv", lambda path: path.write_text("c" + ",c" * 99_999 + "\n"), "has no column 't'; it has 'c (1)'"),
        ("csv", lambda path: path.write_text("\n".join(["t,f", *["1,2,3"] * 600_000])), "row 1 has 3 cells"),
    ],
    ids=["header", "NUL", "columns", "cells"],
)
def test_a_recording_that_swells_is_refused_at_once(cost, tmp_path, kind, fill, why):
    (tmp_path / "m.toml").write_text(MAPPING.format(kind), encoding="utf-8")
    source = tmp_path / "run"
    source.touch()
    fill(source)
    refused_at_once(cost, why, "import", tmp_path / "m.toml", source, "-o", tmp_path / "logs")


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
    make_log(tmp_path / "x.mcap", {"quantity": rows, "clock": clocks, "[/b]": clocks})
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


def crafted(path, text, metadata=0):
    """A log of one channel with the schema ``text``, and so many pieces of empty metadata."""
    definitions = mcap_format.Schema(1, "heft/msg/X", text).pack() + mcap_format.Channel(1, 1, "x").pack()
    head = mcap_format.MAGIC + mcap_format.Header(mcap_format.PROFILE, mcap_format.LIBRARY).pack()
    empty = mcap_format.Metadata("", {}).pack()
    path.write_bytes(head + mcap_format.Chunk(0, 0, definitions).pack() + empty * metadata)


@pytest.mark.parametrize("kind", ["wide rows", "metadata", "sparse"])
@pytest.mark.parametrize("command", [["info"], ["dump", "--to", "npz", "out"]], ids=["info", "dump"])
def test_a_log_that_swells_is_damage_at_once(cost, tmp_path, monkeypatch, kind, command):
    """Rows of 800 MB; 1,000,000 pieces of empty metadata (before: 20 s); a file of 6 GB with nothing in it (60 s)."""
    monkeypatch.chdir(tmp_path)
    plain = "uint64 sequence\nint64 host_ns\n"
    wide = "uint64[100000000] more\n" if kind == "wide rows" else ""
    crafted(tmp_path / "x.mcap", plain + wide, metadata=1_000_000 if kind == "metadata" else 0)
    if kind == "sparse":
        os.truncate(tmp_path / "x.mcap", 6 << 30)
    code, seconds, megabytes, said = cost(command[0], tmp_path / "x.mcap", *command[1:])
    assert code == cli.DAMAGED, said
    assert seconds < MOST_S
    assert megabytes < MOST_MB


@pytest.mark.parametrize("at", [0, 1, 250, 499])
def test_a_row_that_is_years_from_the_others_is_damage_and_costs_its_chunk(tmp_path, at):
    rows = np.zeros(500, records.CAN_SYNC)
    rows["sequence"] = np.arange(500)
    rows["host_ns"] = 10**9 + 10**6 * np.arange(500)
    rows["host_ns"][at] = 2**63 - 1
    with LogWriter.create(tmp_path / "x.mcap", durable=False) as writer:
        writer.register("sync", records.CAN_SYNC)
        for part in np.split(rows, 100):
            writer.write("sync", part)
            writer.flush()
    log = LogReader(tmp_path / "x.mcap")
    assert 490 <= len(log.read("sync")) <= 495
    assert log.read("sync")["host_ns"].max() < 2 * 10**9
    assert "years from the row before it" in str(log.damage[0])
    assert log.exit_code == cli.DAMAGED


def test_steps_of_the_estimator_that_are_none_are_refused(tmp_path):
    for dtype, now_ns, why in (
        (channels.tick_dtype(2), 0, "none of"),
        (channels.tick_dtype(1), 10**15, "is 1000000 s after the step before it"),
    ):
        rows = np.zeros(2, dtype)
        rows["host_ns"][1] = now_ns
        path = tmp_path / f"{now_ns}.mcap"
        make_log(path, {"tick": rows})
        with pytest.raises(ChannelError, match=why):
            list(steps(Pass(LogReader(path), ["tick"]), ("imu_base",)))


@pytest.mark.parametrize(
    ("channel", "field"),
    [
        ("arm_phase", "value_raw"),
        ("arm_phase", "unit"),
        ("imu_base", "gyro_scale_rad_s"),
        ("tick", "fresh"),
        ("row", "vehicle_ns"),
    ],
)
def test_rows_that_are_defined_otherwise_are_refused(tmp_path, capsys, channel, field):
    vehicle = config.load(config.packaged("rocksat"))
    kinds = {
        **vehicle.channels,
        "tick": channels.tick_dtype(len(vehicle.channels)),
        "clock": channels.CLOCK,
        "row": channels.row_dtype(1, 1),
    }
    shaped = [(name, kinds[channel][name], (1,) * 6 * (name == field)) for name in kinds[channel].names or ()]
    kinds[channel] = np.dtype(shaped, align=True)
    with LogWriter.create(tmp_path / "x.mcap", durable=False) as writer:
        writer.attach("vehicle.toml", "application/toml", ROCKSAT.encode())
        writer.attach("rocksat.urdf", "application/xml", URDF)
        for name, kind in kinds.items():
            rows = np.zeros(3, kind)
            rows["sequence"], rows["host_ns"] = range(3), range(0, 300_000_000, 100_000_000)
            if name == "tick":
                rows["consumed"], rows["first_sequence"], rows["last_sequence"] = 1, *[np.arange(3)[:, None]] * 2
            writer.register(name, kind)
            writer.write(name, rows)
    assert cli.main(["replay", str(tmp_path / "x.mcap")]) == cli.FAILED
    assert f"'{channel}' has fields of another kind" in " ".join(capsys.readouterr().err.split())
    for command in (["info"], ["report", "-o", str(tmp_path / "report.html")]):
        assert cli.main([command[0], str(tmp_path / "x.mcap"), *command[1:]]) == cli.DAMAGED
    assert cli.main(["identify", str(tmp_path / "x.mcap")]) != cli.OK
    for number, options in enumerate(([], ["--aligned", "100"])):
        written = ["dump", str(tmp_path / "x.mcap"), *options, "--to", "csv", str(tmp_path / f"csv_{number}")]
        assert cli.main(written) in (cli.OK, cli.BAD_INPUT, cli.DAMAGED)
