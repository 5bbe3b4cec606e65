"""A slice of bench/fuzz.py: so many executions of each decoder from one seed, and a fuzzer that is shown to find."""

import shutil

import pytest

from bench import fuzz
from bench.fuzz_targets import targets
from drivers.errors import FrameError
from drivers.transports.can_slcan import decode_line

SEED = 20190812
EXECUTIONS = {  # about 2 s each, most of it the trace function
    "mpu6050": 80,
    "canopen": 60,
    "slcan": 600,
    "nimu": 250,
    "qsb": 100,
    "modbus": 500,
    "dsc": 900,
    "node_frame": 500,
}


def test_every_decoder_has_a_slice():
    assert set(EXECUTIONS) == set(targets()) == set(fuzz.NAMES)


@pytest.mark.parametrize("name", EXECUTIONS)
def test_a_slice_finds_nothing(name):
    target = targets()[name]
    findings = fuzz.Findings(target.call, None)
    result = fuzz.fuzz_own(target.call, target.seeds, SEED, findings, EXECUTIONS[name], 0.0)
    assert {place: data.hex() for place, data in findings.places.items()} == {}
    assert result.executions == EXECUTIONS[name]
    assert result.paths > len(target.seeds) // 2  # it is guided: seeds alone do not reach it all


def planted(data):
    """slcan lines, with a bug behind a valid frame of one byte."""
    for line in data.split(b"\r"):
        try:
            frame = decode_line(line)
        except FrameError:
            continue
        if frame is not None and len(frame[1]) == 1:
            raise KeyError(frame[0])


def slice_of(call, seed, folder=None):
    findings = fuzz.Findings(call, folder)
    result = fuzz.fuzz_own(call, [b"t08001\rt2812AABB\rt18201\r"], seed, findings, 1500, 0.0)
    return findings, result


def test_a_planted_bug_is_found_shortened_and_saved(tmp_path):
    findings, _ = slice_of(planted, SEED, tmp_path / "findings" / "planted")
    (data,) = findings.places.values()
    assert data.startswith(b"t")
    assert len(data) == 7  # t, identifier, length 1, one byte: nothing is left to leave out
    (file,) = findings.files
    assert file.read_bytes() == data
    assert "KeyError" in file.with_suffix(".txt").read_text(encoding="utf-8")
    assert (tmp_path / "findings" / ".gitignore").read_text(encoding="ascii") == "*\n"
    shutil.rmtree(tmp_path / "findings")


def test_the_same_seed_finds_the_same_and_another_goes_another_way():
    first, second, other = (slice_of(planted, seed) for seed in (1, 1, 2))
    assert first[0].places == second[0].places
    assert first[1].paths == second[1].paths
    assert other[1].executions == first[1].executions


def test_what_does_not_end_is_a_finding(monkeypatch):
    monkeypatch.setattr(fuzz, "HANG_S", 0.05)

    def endless(data):
        while True:
            pass

    assert isinstance(fuzz.raised(endless, b""), fuzz.Hang)
    assert fuzz.raised(len, b"") is None
