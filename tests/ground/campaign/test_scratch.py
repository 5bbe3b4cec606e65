"""A flight's files are in memory where there is room, and gone afterwards, also those of a worker that was killed."""

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from onboard.ground.campaign import scratch as module
from onboard.ground.campaign.scratch import scratch

_KILLED = """
import os, signal, sys
from pathlib import Path
from onboard.ground.campaign import scratch
scratch.MEMORY = Path(sys.argv[1])
with scratch.scratch() as directory:
    (directory / "flight.mcap").write_text("a log")
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.fixture
def memory(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "MEMORY", tmp_path)
    return tmp_path


def test_files_are_in_memory_and_gone_afterwards(memory):
    before = tempfile.gettempdir()
    with scratch() as directory:
        assert directory.parent == memory
        with tempfile.TemporaryDirectory() as own:  # of a plan's own function
            assert Path(own).parent == directory
    assert list(memory.iterdir()) == []
    assert tempfile.gettempdir() == before


def test_without_room_they_are_on_the_disk(memory, monkeypatch, tmp_path_factory):
    disk = tmp_path_factory.mktemp("disk")
    monkeypatch.setattr(module, "_ROOM", 1 << 62)
    monkeypatch.setattr(tempfile, "tempdir", str(disk))
    with scratch() as directory:
        assert directory.parent == disk
    monkeypatch.setattr(module, "MEMORY", memory / "missing")
    with scratch() as directory:
        assert directory.parent == disk


def test_what_a_killed_worker_left_is_removed_and_nothing_that_is_in_use(memory):
    killed = subprocess.run([sys.executable, "-c", _KILLED, str(memory)], check=False)
    assert killed.returncode == -signal.SIGKILL
    [left] = memory.iterdir()
    assert (left / "flight.mcap").exists()
    with scratch():
        assert left.exists()  # as fresh as one that is about to be locked
    os.utime(left, (0.0, 0.0))
    with scratch() as first:
        assert not left.exists()
        (first / "flight.mcap").write_text("a log")
        os.utime(first, (0.0, 0.0))
        with scratch() as second:
            assert first != second
            assert (first / "flight.mcap").exists()
    assert list(memory.iterdir()) == []
