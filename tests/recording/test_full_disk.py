"""A real disk that is full: ``small_disk.py`` in a mount namespace of its own."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def namespaces_are_allowed():
    return subprocess.run(["unshare", "-rm", "true"], check=False, capture_output=True).returncode == 0


@pytest.mark.skipif(not namespaces_are_allowed(), reason="this user may not mount a disk in a namespace of its own")
def test_on_a_disk_that_fills_up_events_go_on_and_gaps_add_up_to_the_row(tmp_path):
    place = tmp_path / "disk"
    place.mkdir()
    command = ["unshare", "-rm", sys.executable, str(Path(__file__).with_name("small_disk.py")), str(place)]
    done = subprocess.run(command, env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    told = found.pop("told_missing")
    assert 50_000 < told < 83_500  # 20 s of 30 at 5000 rows/s, but for what the rings held
    assert found == {
        "ballast_held": True,
        "refused": True,
        "closed": True,
        "complete": True,
        "wrong": [],
        "causes": ["disk_full"],
        "events_lost": 0,
        "said": [
            "disk_nearly_full",
            "disk_has_room",
            "disk_error",
            "disk_nearly_full",
            "disk_resumed",
            "disk_has_room",
            "rows_lost",
        ],
    }
