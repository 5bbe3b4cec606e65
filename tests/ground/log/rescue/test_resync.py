"""``heft resync``: a parabola recorded by two recorders, one of them without times, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest

from bench.true_flights import free_flyer
from bench.true_flights.free_flyer_sensors import COUNTS_PER_TURN, ImuErrors, sample
from drivers import records
from onboard import cli
from onboard.ground.log.bring_in.importer import import_recordings
from onboard.recording.reader import LogReader
from tests.recording.logs import make_log

RATE, FIRST_S, ENCODERS_S, DURATION_S = 0.013, 1.234, 11.0, 13.0
PAYLOAD = free_flyer.Body.box(5.0, (0.20, 0.16, 0.14), (0.03, -0.02, 0.08))

IMU_MAPPING = """
[mapping]
name = "imu"
format = "npz"
[time]
column = "t"
[channel.imu_base]
record = "imu"
gyro = { column = "gyro", values = "physical", scale = 1e-4, unit = "rad/s" }
accel = { column = "accel", values = "physical", scale = 1e-3, unit = "m/s^2" }
"""
ENCODER_MAPPING = """
[mapping]
name = "encoders"
format = "npz"
[time]
rate_Hz = 500
""" + "".join(
    f"""
[channel.joint_{k}]
record = "scalar"
value = {{ column = "q{k}", values = "physical", scale = {1.0 / COUNTS_PER_TURN!r}, unit = "rev" }}
"""
    for k in range(1, 6)
)


@pytest.fixture(scope="module")
def parabola(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """IMU log, encoder log."""
    directory = tmp_path_factory.mktemp("parabola")
    rng = np.random.default_rng(4)
    motion = free_flyer.JointMotion.draw(rng)
    flight = free_flyer.fly(free_flyer.world(PAYLOAD), motion, (0.03, -0.02, 0.04), DURATION_S)
    imu = sample(flight, ImuErrors(gyro_bias_rad_s=0.01, accelerometer_bias_m_s2=0.1), rng)
    own_s = 2e-3 * np.arange(int(ENCODERS_S / (2e-3 * (1.0 + RATE))))
    angle = motion.at(FIRST_S + (1.0 + RATE) * own_s)[0]
    count = 2.0 * np.pi / COUNTS_PER_TURN
    turns = (np.floor(angle / count) + 0.5) / COUNTS_PER_TURN
    np.savez(directory / "imu.npz", t=imu.time_s, gyro=imu.rate_rad_s, accel=imu.specific_force_m_s2)
    np.savez(directory / "encoders.npz", **{f"q{k + 1}": turns[:, k] for k in range(5)})
    (directory / "imu.toml").write_text(IMU_MAPPING)
    (directory / "encoders.toml").write_text(ENCODER_MAPPING)
    logs = [
        import_recordings(directory / f"{name}.toml", directory / f"{name}.npz", directory / "logs")[0].path
        for name in ("imu", "encoders")
    ]
    return logs[0], logs[1]


def test_samples_without_times_are_evenly_spaced_at_the_nominal_rate(parabola: tuple[Path, Path]) -> None:
    rows = LogReader(parabola[1]).read("joint_3")
    assert len(rows) > 5000
    assert (np.diff(rows["host_ns"]) == 2_000_000).all()


def test_a_parabola_of_two_recorders_is_put_on_one_clock_and_merged(
    parabola: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    merged = tmp_path / "merged.mcap"
    logs = [str(log) for log in parabola]

    assert cli.main(["resync", *logs, "--vehicle", "dymaflex_parabolic", "--json", "-", "-o", str(merged)]) == cli.OK

    (found,) = json.loads(capsys.readouterr().out)
    own_s = np.array([0.0, ENCODERS_S / (1.0 + RATE)])
    placed_s = own_s * (1.0 + found["rate"]) + found["offset_s"] - found["rate"] * found["pivot_s"]
    millisecond, fifty_ppm = 1e-3, 50e-6
    assert np.abs(placed_s - (FIRST_S + (1.0 + RATE) * own_s)).max() < millisecond
    assert abs(found["rate"] - RATE) < fifty_ppm
    assert found["payload"]["mass_kg"] == pytest.approx(PAYLOAD.mass_kg, rel=0.02)
    rows = LogReader(merged).read("joint_1")
    assert rows["host_ns"][0] * 1e-9 == pytest.approx(FIRST_S, abs=millisecond)
    assert LogReader(merged).read("imu_base")["host_ns"][0] == 0


def test_logs_of_different_flights_are_refused(
    parabola: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(5)
    other = free_flyer.JointMotion.draw(rng).at(2e-3 * np.arange(4000))[0] / (2.0 * np.pi)
    np.savez(tmp_path / "other.npz", **{f"q{k + 1}": other[:, k] for k in range(5)})
    (tmp_path / "encoders.toml").write_text(ENCODER_MAPPING)
    log = import_recordings(tmp_path / "encoders.toml", tmp_path / "other.npz", tmp_path)[0].path

    assert cli.main(["resync", str(parabola[0]), str(log), "--vehicle", "dymaflex_parabolic"]) == cli.FAILED

    assert "the recordings have no common motion" in capsys.readouterr().err


def test_two_imus_on_one_body_are_aligned_without_a_vehicle_file(
    parabola: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = np.load(parabola[0].parents[1] / "imu.npz")
    late = {"t": rows["t"][500:] + 40.0, "gyro": rows["gyro"][500:, [2, 0, 1]], "accel": rows["accel"][500:]}
    np.savez(tmp_path / "second.npz", **late)
    (tmp_path / "imu.toml").write_text(IMU_MAPPING)
    log = import_recordings(tmp_path / "imu.toml", tmp_path / "second.npz", tmp_path)[0].path

    monkeypatch.setenv("FORCE_COLOR", "1")  # stderr is a terminal
    monkeypatch.setenv("COLUMNS", "200")
    assert cli.main(["resync", str(parabola[0]), str(log), "--json", "-"]) == cli.OK

    said = capsys.readouterr()
    (found,) = json.loads(said.out)
    assert found["offset_s"] == pytest.approx(-40.0, abs=1e-4)
    assert f"{log.name} on the time of {parabola[0].name}" in said.err


def test_imus_whose_rows_share_arrival_stamps_are_aligned_by_their_ticks(
    parabola: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two MPU-6050, each drained every 10 ms by a computer of its own; their chips run off nominal by -0.7 and 1 %."""
    rows = np.load(parabola[0].parents[1] / "imu.npz")
    logs = []
    for name, start_s, rate in (("one", 0.0, -0.007), ("two", 40.0, 0.01)):
        period_s = 1e-3 * (1.0 + rate)
        own_s = np.arange(int(12.0 / period_s)) * period_s
        imu = np.zeros(len(own_s), records.IMU)
        imu["sequence"] = imu["tick"] = np.arange(len(own_s))
        imu["host_ns"] = np.round((np.ceil(own_s / 0.01) * 0.01 + start_s) * 1e9)  # when the FIFO was drained
        imu["gyro_scale_rad_s"] = imu["accel_scale_m_s2"] = 1e-3
        for axis in range(3):
            imu["gyro_raw"][:, axis] = np.round(np.interp(own_s, rows["t"], rows["gyro"][:, axis]) * 1e3)
        assert (np.diff(imu["host_ns"]) == 0).mean() > 0.8
        make_log(tmp_path / f"{name}.mcap", {"imu": imu})
        logs.append(str(tmp_path / f"{name}.mcap"))

    assert cli.main(["resync", *logs, "--json", "-"]) == cli.OK

    (found,) = json.loads(capsys.readouterr().out)
    assert found["offset_s"] == pytest.approx(-40.0, abs=1e-3)
    assert abs(found["rate"]) < 50e-6


def test_taps_of_a_mallet_serve_where_nothing_moves(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(8)
    taps_s, imu_s, own_s = np.sort(rng.uniform(8.0, 22.0, 7)), 1e-3 * np.arange(30_000), 2e-3 * np.arange(12_000)

    def ring(times_s: np.ndarray, strength: float) -> np.ndarray:  # type: ignore[type-arg]
        since_s = (times_s[:, None] - taps_s).clip(0.0)
        return strength * (np.exp(-since_s / 0.01) * np.sin(1100.0 * since_s)).sum(axis=1)

    accel = ring(imu_s, 20.0)[:, None] * [0.3, 1.0, -0.5] + 0.06 * rng.standard_normal((len(imu_s), 3))
    np.savez(tmp_path / "imu.npz", t=imu_s, gyro=1e-3 * rng.standard_normal(accel.shape), accel=accel)
    turns = [ring(5.0 + own_s, 1e-3) + 1e-5 * rng.standard_normal(len(own_s)) for _ in range(5)]
    np.savez(tmp_path / "encoders.npz", **{f"q{k + 1}": one for k, one in enumerate(turns)})
    logs = []
    for name, text in (("imu", IMU_MAPPING), ("encoders", ENCODER_MAPPING)):
        (tmp_path / f"{name}.toml").write_text(text)
        logs.append(str(import_recordings(tmp_path / f"{name}.toml", tmp_path / f"{name}.npz", tmp_path)[0].path))

    assert cli.main(["resync", *logs, "--shocks", "--json", "-"]) == cli.OK

    (found,) = json.loads(capsys.readouterr().out)
    five_milliseconds = 5e-3
    assert found["offset_s"] == pytest.approx(5.0, abs=five_milliseconds)


def test_logs_without_an_imu_cannot_be_compared(
    parabola: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other.mcap"
    other.write_bytes(parabola[1].read_bytes())
    assert cli.main(["resync", str(parabola[1]), str(other)]) == cli.BAD_INPUT
    assert "none of the logs has an IMU" in capsys.readouterr().err
