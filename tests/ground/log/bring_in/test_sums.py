"""Channels that are sums of columns, of a file beside, or of columns of an array."""

import hashlib

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from onboard.ground.log.bring_in.errors import MappingError, SourceError
from onboard.ground.log.bring_in.importer import import_recordings
from onboard.recording.reader import LogReader

COUPLED = """
[mapping]
name = "coupled"
format = "csv"
[time]
rate_Hz = 100
[channel.wrist]
record = "scalar"
[channel.wrist.value]
sum = { a = 0.5, b = -0.25 }
values = "physical"
scale = 0.001
unit = "rad"
[channel.torque]
record = "scalar"
file = "currents.csv"
[channel.torque.value]
sum = { a = 45.0, c = 32.0 }
sign = "-"
values = "physical"
scale = 0.01
unit = "N m"
"""


def coupled(directory, text=COUPLED, currents="a,c\n1,10\n2,-1\n"):
    (directory / "coupled.toml").write_text(text)
    (directory / "positions.csv").write_text("a,b\n1,2\n3,8\n")
    (directory / "currents.csv").write_text(currents)
    [made] = import_recordings(directory / "coupled.toml", directory / "positions.csv", directory / "logs")
    return LogReader(made.path)


def test_a_channel_is_a_sum_of_columns_and_may_lie_in_a_file_beside(tmp_path):
    log = coupled(tmp_path)
    assert (log.read("wrist")["value_raw"] * 0.001).tolist() == [0.0, -0.5]
    assert (log.read("torque")["value_raw"] * 0.01).tolist() == [-365.0, -58.0]
    facts = log.metadata["import"]
    assert facts["source"] == "positions.csv, currents.csv"
    assert facts["sha256"].split(", ")[1] == hashlib.sha256((tmp_path / "currents.csv").read_bytes()).hexdigest()


def test_a_column_of_an_array_is_named_by_its_index(tmp_path):
    np.savez(tmp_path / "run.npz", angles=np.array([[1.0, 2.0], [3.0, 4.0]]))
    text = COUPLED[: COUPLED.index("[channel.torque]")].replace('"csv"', '"npz"')
    for given, expected in (('"angles[1]" = 1.0', [2.0, 4.0]), ('"angles[0]" = 1.0, "angles[1]" = 10.0', [21.0, 43.0])):
        (tmp_path / "run.toml").write_text(text.replace("a = 0.5, b = -0.25", given))
        [made] = import_recordings(tmp_path / "run.toml", tmp_path / "run.npz", tmp_path)
        assert (LogReader(made.path).read("wrist")["value_raw"] * 0.001).tolist() == expected
    (tmp_path / "run.toml").write_text(text.replace("a = 0.5, b = -0.25", '"angles[2]" = 1.0'))
    with pytest.raises(SourceError, match=r"no column 'angles\[2\]'; it has 'angles'"):
        import_recordings(tmp_path / "run.toml", tmp_path / "run.npz", tmp_path)


def test_what_cannot_be_summed_is_refused(tmp_path):
    with pytest.raises(SourceError, match="no column 'c'; it has 'a'"):
        coupled(tmp_path, currents="a\n1\n2\n")
    with pytest.raises(SourceError, match="row 1 has 'x', which is no number"):
        coupled(tmp_path, currents="a,c\n1,x\n2,3\n")
    with pytest.raises(OSError, match=r"nowhere\.csv"):
        coupled(tmp_path, COUPLED.replace("currents.csv", "nowhere.csv"))
    for old, new in (
        ('values = "physical"\n', ""),
        ("sum = { a = 0.5, b = -0.25 }", "sum = {}"),
        ("sum = { a", 'column = "a"\nsum = { a'),
    ):
        with pytest.raises(MappingError):
            coupled(tmp_path, COUPLED.replace(old, new, 1))


@pytest.mark.parametrize(("up", "axis"), [("z", [0, 0, 1]), ("y", [0, 1, 0])])
def test_a_yaw_is_made_of_a_quaternion(tmp_path, up, axis):
    true = np.linspace(-1.0, 8.0, 60)  # beyond half a turn
    turned = Rotation.from_rotvec(true[:, None] * np.array(axis)).as_quat()[:, [3, 0, 1, 2]]
    np.savetxt(tmp_path / "q.csv", turned, delimiter=",", header="w,x,y,z", comments="", fmt="%.9f")
    text = COUPLED[: COUPLED.index("[channel.torque]")].replace("scale = 0.001", "scale = 1e-6")
    (tmp_path / "q.toml").write_text(
        text.replace("sum = { a = 0.5, b = -0.25 }", f'quaternion = ["w", "x", "y", "z"]\nup = "{up}"')
    )
    [made] = import_recordings(tmp_path / "q.toml", tmp_path / "q.csv", tmp_path)
    assert np.allclose(LogReader(made.path).read("wrist")["value_raw"] * 1e-6, true, atol=1e-5)
    (tmp_path / "q.csv").write_text("w,x,y,z\n1,0,0,0\n10,0,0,0\n")
    with pytest.raises(SourceError, match="no unit quaternion in row 2"):
        import_recordings(tmp_path / "q.toml", tmp_path / "q.csv", tmp_path / "other")
