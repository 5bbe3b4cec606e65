"""NPZ files into logs by a packaged mapping: axes, rails, pauses; files that cannot be right are refused by name.

An import as a whole: what its log says of it, directories, failures, the example of the documentation.
"""

import hashlib
import re
import resource
import zipfile
from pathlib import Path

import numpy as np
import pytest

import heft
from onboard import cli
from onboard.ground.log.bring_in import foreign, importer
from onboard.ground.log.bring_in.errors import SourceError
from onboard.ground.log.bring_in.foreign import read_npz
from onboard.ground.log.bring_in.importer import import_recordings
from onboard.ground.log.views.info import info
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


def test_packaged_mapping_turns_axes_and_keeps_counts(tmp_path):
    [made] = import_recordings("tudelft", npz(tmp_path / "a.npz"), tmp_path)
    imu = LogReader(made.path).read("imu_base")
    assert imu["gyro_raw"][2].tolist() == [-7, 6, 8]  # -y, x, z of 6, 7, 8
    assert imu["accel_raw"][2].tolist() == [-70, 60, 80]
    assert imu["host_ns"][2] == (1_000_000 + 2 * 248) * 1000
    wheel = LogReader(made.path).read("wheel_rate")
    assert wheel["value_raw"].tolist() == [0, 7, 14, 21, 28, 35]
    assert wheel["scale"] == pytest.approx(100 / 7 * 2 * np.pi / 60, rel=1e-15)
    assert set(wheel["unit"]) == {b"rad/s"}


def test_a_flipped_rail_stays_at_the_rail_and_is_flagged(tmp_path):
    gyro = np.zeros((6, 3), np.int16)
    gyro[1, 1], gyro[2, 1], gyro[3, 0] = -32768, 32767, -32767
    [made] = import_recordings("tudelft", npz(tmp_path / "a.npz", gyro_raw=gyro), tmp_path)
    imu = LogReader(made.path).read("imu_base")
    assert imu["gyro_raw"][1:4].tolist() == [[32767, 0, 0], [-32767, 0, 0], [0, -32767, 0]]
    assert imu["status"].tolist() == [0, 1, 1, 0, 0, 0]


def test_channels_take_turns_in_time(tmp_path):
    count = 5000
    many = {
        "time_us": np.arange(count) * 250,
        "gyro_raw": np.zeros((count, 3), np.int16),
        "acc_raw": np.zeros((count, 3), np.int16),
        "erpm_raw": np.zeros(count, np.int32),
    }
    [made] = import_recordings("tudelft", npz(tmp_path / "a.npz", **many), tmp_path)
    newest = 0
    rows = 0
    for batch in LogReader(made.path).batches(["imu_base", "wheel_rate"]):
        assert int(batch.rows["host_ns"][0]) > newest - 200_000_000
        newest = max(newest, int(batch.rows["host_ns"][-1]))
        rows += len(batch.rows)
    assert rows == 2 * count


def test_a_pause_in_the_source_is_an_event(tmp_path):
    time_us = np.array([0, 250, 500, 5000, 5250, 5500])
    [made] = import_recordings("tudelft", npz(tmp_path / "a.npz", time_us=time_us), tmp_path)
    events = info(made.path).events
    assert [event.code for event in events] == ["pauses", "pauses"]
    assert "imu_base: 1 intervals" in events[0].text
    assert "4.500 ms after sample 2" in events[0].text


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"time_us": np.array([0, 1, 2, 2, 3, 4])}, "'time_us' does not increase after row 3"),
        ({"time_us": np.array([-5, 1, 2, 3, 4, 5])}, "'time_us' is no time from 0 on in row 1"),
        ({"time_us": np.array([0, 1, 2, 3, 10**14, 10**14 + 1])}, "'time_us' jumps by years after row 4"),
        ({"time_us": np.zeros(0, "U3")}, "holds cells that are not numbers"),
        ({"time_us": np.array([0, 1, 2, np.nan, 4, 5])}, "'time_us' is no time from 0 on in row 4"),
        ({"time_us": np.zeros((6, 2))}, "'time_us' has shape"),
        ({"gyro_raw": np.zeros((6, 2), np.int16)}, "'gyro_raw' has shape"),
        ({"gyro_raw": np.zeros((5, 3), np.int16)}, "'gyro_raw' has 5 rows and its time column 6"),
        ({"gyro_raw": np.full((6, 3), 40_000)}, "'gyro_raw' does not fit 16 bits in row 1"),
        ({"gyro_raw": np.full((6, 3), 0.5)}, "'gyro_raw' is no whole count in row 1; say values"),
        ({"erpm_raw": np.array([0, 1, np.inf, 3, 4, 5])}, "'erpm_raw' is no usable number in row 3"),
        ({"erpm_raw": np.array(list("abcdef"))}, "'erpm_raw' holds cells that are not numbers"),
    ],
)
def test_a_recording_that_cannot_be_right_is_refused(tmp_path, changes, message):
    source = npz(tmp_path / "bad.npz", **changes)
    with pytest.raises(SourceError, match=message) as raised:
        import_recordings("tudelft", source, tmp_path)
    assert "bad.npz" in str(raised.value)
    assert not (tmp_path / "bad.mcap").exists()


def test_a_missing_column_is_named_with_those_there_are(tmp_path):
    np.savez(tmp_path / "a.npz", time_us=np.arange(3))
    with pytest.raises(SourceError, match="no column 'acc_raw'; it has 'time_us'"):
        import_recordings("tudelft", tmp_path / "a.npz", tmp_path)


@pytest.mark.parametrize("content", [b"", b"not a zip", b"PK\x03\x04broken"])
def test_a_file_that_is_no_npz_is_refused(tmp_path, content):
    (tmp_path / "a.npz").write_bytes(content)
    with pytest.raises(SourceError, match=r"a\.npz is not an NPZ"):
        import_recordings("tudelft", tmp_path / "a.npz", tmp_path)


def test_a_lone_array_is_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.arange(3))
    (tmp_path / "a.npy").rename(tmp_path / "a.npz")
    with pytest.raises(SourceError, match="without a name"):
        import_recordings("tudelft", tmp_path / "a.npz", tmp_path)


def test_pickled_objects_are_not_loaded(tmp_path):
    np.savez(tmp_path / "a.npz", time_us=np.array([{}], dtype=object))
    with pytest.raises(SourceError, match="plain arrays"):
        import_recordings("tudelft", tmp_path / "a.npz", tmp_path)


def test_tudelft_recordings(datasets, tmp_path):
    made = import_recordings("tudelft", datasets / "tudelft_tumbling", tmp_path)
    assert len(made) == 33
    for one in made:
        source = np.load(one.source)
        log = LogReader(one.path)
        imu, wheel = log.read("imu_base"), log.read("wheel_rate")
        x, y, z = source["gyro_raw"].T.astype(int)
        assert np.array_equal(imu["gyro_raw"], np.stack([-y, x, z], axis=1))
        ax, ay, az = source["acc_raw"].T * 9.81 / 2048
        specific_force_m_s2 = imu["accel_raw"] * imu["accel_scale_m_s2"][:, None].astype(float)
        np.testing.assert_allclose(specific_force_m_s2, np.stack([-ay, ax, az], axis=1), rtol=1e-7)
        np.testing.assert_allclose(imu["gyro_scale_rad_s"], np.deg2rad(1 / 16.384), rtol=1e-7)
        rate_rad_s = source["erpm_raw"] * 100 / 7 * 2 * np.pi / 60
        np.testing.assert_allclose(wheel["value_raw"] * wheel["scale"], rate_rad_s, rtol=1e-14)
        assert np.array_equal(imu["host_ns"], source["time_us"] * 1000)
        assert not imu["status"].any()
        assert log.complete


def npz_of(tmp_path, shape, compression):
    """An NPZ file whose header says more than is in it, or that is all zeros and packed."""
    with zipfile.ZipFile(tmp_path / "big.npz", "w", compression) as archive, archive.open("t.npy", "w") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": shape})
        if compression == zipfile.ZIP_DEFLATED:
            for _ in range(10):
                file.write(bytes(8 << 20))
    return tmp_path / "big.npz"


@pytest.mark.parametrize(("shape", "compression"), [((10**14,), 0), ((10 << 20,), zipfile.ZIP_DEFLATED)])
def test_an_npz_that_expands_to_gigabytes_is_refused(tmp_path, monkeypatch, shape, compression):
    monkeypatch.setattr(foreign, "LARGEST_BYTES", 40 << 20)
    path = npz_of(tmp_path, shape, compression)
    assert path.stat().st_size < 5 << 20
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(SourceError, match="would expand to"):
        read_npz(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 40_000  # kB
