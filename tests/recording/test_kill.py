"""A slice of ``bench/kill_recorder.py``: real processes, real SIGKILL, full rate."""

import tempfile
from pathlib import Path

import pytest

from bench.kill_recorder import campaign

pytestmark = pytest.mark.realtime


def test_a_recorder_killed_at_random_instants_loses_doubles_and_alters_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with tempfile.TemporaryDirectory(dir="/dev/shm", prefix="heft-test-") as place:
        monkeypatch.setenv("HEFT_RINGS", place)
        done = campaign(tmp_path, kills=8, seed=7)
    assert done.kills == 8
    assert done.rows > 10_000
    assert done.segments > 5
    assert done.is_clean, done
