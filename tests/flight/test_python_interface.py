"""``import heft`` on a flight, and the notebook that shows it."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import heft
from tests.flight.missions import Result

NOTEBOOK = Path(__file__).resolve().parents[2] / "docs" / "notebook.ipynb"


def test_a_flight_in_si_and_in_frames_by_sample_time(short_mission: Result) -> None:
    log = heft.open(short_mission.path)
    rows = short_mission.log.read("imu_base")
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
    for mass in short_mission.table["masses"]:
        assert said["value"][mass["quantity"]] == mass["value"]
    even = log.resample(50.0, ["joint_1"])
    assert np.allclose(np.diff(even.time_s), 0.02)
    there = np.interp(even.time_s, joint["time"].values.astype("i8") * 1e-9, joint["value"])
    assert np.nanmax(np.abs(there - even.columns["joint_1.value"])) < 2e-3  # means of 20 ms beside samples of 5 ms


@pytest.mark.timeout(1200)  # a hang, not a speed: it replays the flight and identifies from it
def test_the_notebook_runs_in_jupyters_kernel_and_shows_what_it_shipped_with(
    short_mission: Result, tmp_path: Path
) -> None:
    """All its cells, beside a log with the name that README's first command writes; outputs are of the kind shipped."""
    (tmp_path / "flights").mkdir()
    (tmp_path / "flights" / "rocksat-001.mcap").symlink_to(short_mission.path)
    shutil.copy(NOTEBOOK, tmp_path)
    command = [sys.executable, "-c", "from nbclient.cli import main; main()", "--inplace", NOTEBOOK.name]
    ran = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr[-3000:]
    shipped, shown = (_outputs(path) for path in (NOTEBOOK, tmp_path / NOTEBOOK.name))
    assert len(shown) >= 6
    assert all(shown)
    assert [[sorted(one) for one in cell] for cell in shipped] == [[sorted(one) for one in cell] for cell in shown]
    assert any("identical to the last bit" in str(one) for cell in shown for one in cell)


def _outputs(notebook: Path) -> list[list[dict[str, object]]]:
    """Outputs by media type, of each code cell."""
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    return [[one["data"] for one in cell["outputs"]] for cell in cells if cell["cell_type"] == "code"]
