"""A slice of bench/fuzz.py: so many executions of each decoder from one seed, and fuzzers that are shown to find."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from bench.fuzzing import NAMES, Target, findings, own_engine, target
from drivers.errors import FrameError
from drivers.transports.can.can_slcan import decode_line

SEED = 20190812
EXECUTIONS = {  # about an eighth of a second each, most of it the trace function
    "mpu6050": 12,
    "canopen": 5,
    "slcan": 45,
    "nimu": 23,
    "qsb": 8,
    "modbus": 23,
    "dsc": 30,
    "dynamixel": 18,
    "node_frame": 30,
    "sync_pulse": 75,
    "bota_ft": 18,
    "nau7802": 9,
    "as5600": 9,
    "as5048": 9,
    "icm20948": 9,
    "bmi088": 9,
    "bmi088_spi": 9,
    "hx711": 9,
    "odrive": 9,
    "robotous_rft": 18,
    "vehicle": 4,
    "urdf": 5,
    "segments": 9,
    "log": 9,
    "recover": 9,
    "import": 15,
}


def test_every_decoder_has_a_slice():
    assert set(EXECUTIONS) == set(NAMES)


@pytest.mark.parametrize("name", EXECUTIONS)
def test_a_slice_finds_nothing(name):
    fuzzed = target(name)
    found = findings.FuzzFindings(fuzzed.call, None)
    result = own_engine.fuzz(fuzzed, SEED, found, EXECUTIONS[name], 0.0)
    assert {place: data.hex() for place, data in found.places.items()} == {}
    assert result.executions == EXECUTIONS[name]
    assert result.paths > len(fuzzed.seeds) // 2  # it is guided: seeds alone do not reach it all


def planted(data):
    """slcan lines, with a bug behind a valid frame of one byte."""
    for line in data.split(b"\r"):
        try:
            frame = decode_line(line)
        except FrameError:
            continue
        if frame is not None and len(frame[1]) == 1:
            raise KeyError(frame[0])


def slice_of(call, seed, folder=None, executions=1500):
    found = findings.FuzzFindings(call, folder)
    result = own_engine.fuzz(Target(call, [b"t08001\rt2812AABB\rt18201\r"], 1024), seed, found, executions, 0.0)
    return found, result


def test_a_planted_bug_is_found_shortened_and_saved(tmp_path):
    found, _ = slice_of(planted, SEED, tmp_path / "findings" / "planted")
    (data,) = found.places.values()
    assert data.startswith(b"t")
    assert len(data) == 7  # t, identifier, length 1, one byte: nothing is left to leave out
    (file,) = found.files.values()
    assert file.read_bytes() == data
    assert "KeyError" in file.with_suffix(".txt").read_text(encoding="utf-8")
    assert (tmp_path / "findings" / ".gitignore").read_text(encoding="ascii") == "*\n"
    shutil.rmtree(tmp_path / "findings")


def test_the_same_seed_finds_the_same_and_another_goes_another_way():
    first, second, other = (slice_of(planted, seed, executions=500) for seed in (1, 1, 2))
    assert first[0].places == second[0].places
    assert first[1].paths == second[1].paths
    assert other[1].executions == first[1].executions


def test_what_does_not_end_is_a_finding(monkeypatch):
    monkeypatch.setattr(findings, "HANG_S", 0.05)

    def endless(data):
        while True:
            pass

    assert isinstance(findings.raised(endless, b""), findings.Hang)
    assert findings.raised(len, b"") is None


def test_atheris_finds_a_planted_bug_too(tmp_path):
    pytest.importorskip("atheris", reason="atheris is not made for this machine: bench/fuzz.py uses its own engine")
    program = f"""
from pathlib import Path
import bench.fuzzing
from bench.fuzzing import atheris_engine

def target(name):
    from tests.drivers.test_fuzz_slice import planted
    return bench.fuzzing.Target(planted, [b"t08001\\rt2812AABB\\r"], 1024)

bench.fuzzing.target, atheris_engine.FOLDER = target, Path({str(tmp_path)!r})
atheris_engine.run_leg("planted", Path({str(tmp_path / "corpus")!r}), 1, runs=5000)
"""
    (tmp_path / "corpus").mkdir()
    (tmp_path / "planted").mkdir()
    run = subprocess.run(
        [sys.executable, "-c", program],
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    place, file = run.stdout.splitlines()[0].split("\t")
    assert place.startswith("KeyError ")
    assert len(Path(file).read_bytes()) == 7
