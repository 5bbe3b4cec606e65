"""``import heft`` on a whole flight, and the notebook that shows it."""

import json
from pathlib import Path

import numpy as np
import pytest

import heft
from tests.flight.missions import Result

NOTEBOOK = Path(__file__).resolve().parents[2] / "docs" / "notebook.ipynb"


def test_a_flight_in_si_and_in_frames_by_sample_time(mission: Result) -> None:
    log = heft.open(mission.path)
    rows = mission.log.read("imu_base")
    imu = log["imu_base"].to_pandas()
    assert imu.attrs["frame"] == "imu_base"
    assert imu.attrs["units"]["gyro_imu_base_z"] == "rad/s"
    assert np.array_equal(imu["gyro_imu_base_z"], rows["gyro_raw"][:, 2] * rows["gyro_scale_rad_s"].astype(float))
    assert (imu.index.to_series().diff().dt.total_seconds()[5000:] - 1e-3).abs().lt(3e-5).mean() > 0.999
    joint = log["joint_1"].to_xarray()
    raw = log["joint_1"].to_numpy(raw=True)
    assert np.array_equal(joint["value"], (raw["value_raw"] - 1_000_000) * raw["scale"])
    assert joint["value"].attrs["units"] == "rad"
    said = log.estimates.to_pandas().drop_duplicates("name", keep="last").set_index("name")
    for mass in mission.table["masses"]:
        assert said["value"][mass["quantity"]] == mass["value"]
    even = log.resample(50.0, ["joint_1"])
    assert np.allclose(np.diff(even.time_s), 0.02)
    there = np.interp(even.time_s, joint["time"].values.astype("i8") * 1e-9, joint["value"])
    assert np.nanmax(np.abs(there - even.columns["joint_1.value"])) < 2e-3  # means of 20 ms beside samples of 5 ms


def test_the_notebook_runs(mission: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its code cells one after the other in one namespace, beside the log that the README's first command writes."""
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "flights").mkdir()
    (tmp_path / "flights" / "rocksat-001.mcap").symlink_to(mission.path)
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    assert len(code) >= 6
    names: dict[str, object] = {}
    for number, source in enumerate(code):
        exec(compile(source, f"notebook cell {number}", "exec"), names)
    assert names["same"].identical  # type: ignore[attr-defined]
