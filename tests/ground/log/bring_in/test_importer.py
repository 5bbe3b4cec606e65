"""An import as a whole: what its log says of it, directories, failures, the example of the documentation."""

import hashlib
import re
from pathlib import Path

import numpy as np
import pytest

import heft
from onboard import cli
from onboard.ground.log.bring_in import importer
from onboard.ground.log.bring_in.errors import SourceError
from onboard.ground.log.bring_in.importer import import_recordings
from onboard.recording.reader import LogReader
from tests.ground.log.bring_in.recordings import CSV_MAPPING, CSV_TEXT, npz


def test_the_log_says_that_it_is_an_import(bench):
    [made] = import_recordings(str(bench / "bench.toml"), bench / "run.csv", bench / "logs")
    log = LogReader(made.path)
    facts = log.metadata["import"]
    assert facts["source"] == "run.csv"
    assert facts["mapping"] == "bench"
    assert facts["sha256"] == hashlib.sha256(CSV_TEXT.encode()).hexdigest()
    assert "imu.temperature_raw" in facts["not_recorded"]
    assert log.attachments["mapping.toml"].data.decode() == CSV_MAPPING
    before = made.path.read_bytes()
    import_recordings(bench / "bench.toml", bench / "run.csv", bench / "logs")
    assert made.path.read_bytes() == before


def test_a_whole_directory_at_once(tmp_path):
    for name in ("b.npz", "a.npz"):
        npz(tmp_path / name)
    (tmp_path / "notes.txt").write_text("not a recording")
    made = import_recordings("tudelft", tmp_path, tmp_path / "logs")
    assert [one.path.name for one in made] == ["a.mcap", "b.mcap"]
    with pytest.raises(SourceError, match=r"no \.npz"):
        import_recordings("tudelft", tmp_path / "logs", tmp_path / "none")


def test_an_import_that_fails_leaves_an_earlier_log_as_it_was(bench, tmp_path, monkeypatch):
    [first] = import_recordings(tmp_path / "bench.toml", tmp_path / "run.csv", tmp_path / "logs")
    before = first.path.read_bytes()

    def refuse(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(importer, "_write_by_time", refuse)
    with pytest.raises(OSError, match="No space"):
        import_recordings(tmp_path / "bench.toml", tmp_path / "run.csv", tmp_path / "logs")
    assert first.path.read_bytes() == before
    assert list((tmp_path / "logs").iterdir()) == [first.path]


def test_the_example_of_the_documentation_runs(tmp_path, monkeypatch):
    page = (Path(__file__).resolve().parents[4] / "docs" / "import.md").read_text()
    blocks = dict(re.findall(r"```(\w*)\n(.*?)```", page, re.DOTALL))
    monkeypatch.chdir(tmp_path)
    Path("bench.csv").write_text(blocks["csv"])
    Path("bench.toml").write_text(blocks["toml"])
    commands = blocks[""].splitlines()
    assert len(commands) == 3
    for command in commands:
        assert cli.main(command.split()[1:]) == cli.OK
    log = heft.open("logs/bench.mcap")
    imu, joint = log["imu_base"].to_numpy(), log["joint_1"].to_numpy()
    assert imu["time_s"].tolist() == pytest.approx([0.0, 0.002, 0.004, 0.006])
    assert imu["accel_x"] == pytest.approx(np.array([3, 2, 4, 3]) * 9.80665 / 2048)
    assert joint["value"] == pytest.approx(np.deg2rad([0.0, 0.01, 0.03, 0.06]))
    assert log["load_cell"].to_numpy()["value"] == pytest.approx([-0.10, -0.11, -0.09, -0.12])
