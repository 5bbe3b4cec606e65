"""Poses and wrenches as arrays, JSON, trajectories and messages, for ``heft weigh``."""

import io
import json
import zipfile

import numpy as np
import pytest
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore
from scipy.io import savemat

from onboard.ground.calibrate.weigh import columns, table
from onboard.ground.calibrate.weigh.errors import PosesError


def understood(*paths):
    return columns.understood(table.read(paths), columns.Units())


def same(meaning, one, kind="quaternion?", order=(0, 1, 2, 3), tolerance=1e-12):
    assert meaning.kind == kind
    np.testing.assert_allclose(meaning.wrench, one.wrench, atol=tolerance)
    expected = one.R.reshape(-1, 9) if kind == "matrix" else one.rows[:, :4][:, list(order)]
    np.testing.assert_allclose(meaning.orientation, expected, atol=tolerance)


def test_npz_and_mat(one, tmp_path):
    arrays = {"quaternion": one.rows[:, :4], "force": one.wrench[:, :3], "torque": one.wrench[:, 3:], "gain": [1.0]}
    np.savez(tmp_path / "a.npz", **arrays)
    savemat(tmp_path / "a.mat", arrays)
    for name in ("a.npz", "a.mat"):
        same(understood(tmp_path / name), one)
    T = np.zeros((len(one.R), 4, 4))
    T[:, :3, :3], T[:, :3, 3], T[:, 3, 3] = one.R, 0.2, 1.0
    np.savez(tmp_path / "b.npz", poses=T, wrenches=one.wrench)
    same(understood(tmp_path / "b.npz"), one, "matrix")
    np.savez(tmp_path / "c.npz", poses=T, wrenches=one.wrench[:-1])
    with pytest.raises(PosesError, match="no columns of forces"):
        understood(tmp_path / "c.npz")


def test_json(one, tmp_path):
    xyz = [dict(zip("xyz", three, strict=True)) for three in one.wrench[:, :3].tolist()]
    moments = [dict(zip("xyz", three, strict=True)) for three in one.wrench[:, 3:].tolist()]
    turned = [dict(zip("wxyz", four, strict=True)) for four in one.rows[:, :4].tolist()]
    rows = [
        {"frame": "ft", "orientation": q, "wrench": {"force": f, "torque": m}}
        for q, f, m in zip(turned, xyz, moments, strict=True)
    ]
    path = tmp_path / "a.json"
    path.write_text(json.dumps(rows), encoding="utf-8")
    same(understood(path), one, "quaternion")
    assert understood(path).unnamed == ()  # ROS' names
    path.write_text("\n".join(map(json.dumps, rows)), encoding="utf-8")
    same(understood(path), one, "quaternion")
    path.write_text(json.dumps({"pose": one.R.tolist(), "wrench": one.wrench.tolist()}), encoding="utf-8")
    same(understood(path), one, "matrix")


def test_a_trajectory_beside_wrenches(one, tmp_path):
    """TUM's ``tx`` is a translation; files with names and without them, with times and without them, go together."""
    xyzw = np.hstack([np.arange(len(one.R))[:, None] * 0.1, np.full((len(one.R), 3), 0.2), one.rows[:, [1, 2, 3, 0]]])
    np.savetxt(tmp_path / "bare.txt", xyzw, fmt="%.9f")
    np.savetxt(tmp_path / "named.txt", xyzw, fmt="%.9f", header="timestamp tx ty tz qx qy qz qw")
    np.savetxt(tmp_path / "w.txt", one.wrench, fmt="%.9f")
    np.savetxt(tmp_path / "timed.txt", np.hstack([xyzw[:, :1], one.wrench]), fmt="%.9f")
    np.savetxt(tmp_path / "fx.txt", one.wrench, fmt="%.9f", header="fx fy fz tx ty tz")
    for wrenches in ("w.txt", "timed.txt", "fx.txt"):
        same(understood(tmp_path / "named.txt", tmp_path / wrenches), one, "quaternion", tolerance=1e-8)
    for wrenches in ("timed.txt", "fx.txt"):
        same(understood(tmp_path / "bare.txt", tmp_path / wrenches), one, order=(1, 2, 3, 0), tolerance=1e-8)


def test_a_bag_of_wrenches_and_poses(one, tmp_path):
    """Wrenches at 20 Hz, each with the pose nearest in time of 10 Hz; without one within 0.1 s it is no row."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    made = {name.rpartition("/")[2]: each for name, each in store.types.items()}
    with Writer(tmp_path / "bag", version=9) as writer:
        wrenches, poses = (
            writer.add_connection(topic, f"geometry_msgs/msg/{kind}", typestore=store)
            for topic, kind in (("/ft/wrench", "WrenchStamped"), ("/tool_pose", "PoseStamped"))
        )

        def send(connection, kind, at_ns, body):
            header = made["Header"](made["Time"](*divmod(at_ns, 10**9)), "ft")
            message = made[kind](header, body)
            # recorded late, by another amount for each topic: the stamps say when
            late_ns = 700_000_000 if kind == "PoseStamped" else 0
            writer.write(connection, at_ns + late_ns, store.serialize_cdr(message, message.__msgtype__))

        for k, (w, x, y, z, *six) in enumerate(one.rows.tolist()):
            for part in range(20):
                at_ns = (100 + 2 * k) * 10**9 + 50_000_000 * part
                force, torque = made["Vector3"](*six[:3]), made["Vector3"](*six[3:])
                send(wrenches, "WrenchStamped", at_ns, made["Wrench"](force, torque))
                if part % 2 == 0 and part < 16:
                    pose = made["Pose"](made["Point"](0.1, 0.2, 0.3), made["Quaternion"](x, y, z, w))
                    send(poses, "PoseStamped", at_ns + 3_000_000, pose)
    meaning = understood(tmp_path / "bag")
    assert (meaning.kind, meaning.unnamed) == ("quaternion", ())
    np.testing.assert_allclose(meaning.wrench, np.repeat(one.wrench, 20, axis=0))
    quaternions = meaning.orientation.reshape(-1, 20, 4)
    np.testing.assert_allclose(quaternions[:, :16], np.repeat(one.rows[:, None, :4], 16, axis=1))
    assert np.isnan(quaternions[:, 17:]).all()


@pytest.mark.parametrize(
    ("head", "said"),
    [
        (b"\x89HDF\r\n\x1a\n", "save('FILE.mat', '-v7'); else save arrays as NPZ"),
        (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "or as CSV"),
        (b"", "is empty"),
        (b"a\0b", "is no text"),
    ],
)
def test_what_is_no_table_is_refused_with_a_remedy(tmp_path, head, said):
    (tmp_path / "a.bin").write_bytes(head + bytes(600) * bool(head))
    with pytest.raises(PosesError, match=said.replace("(", r"\(").replace(")", r"\)")):
        table.read([tmp_path / "a.bin"])


def test_a_workbook_is_to_be_saved_as_csv(tmp_path):
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("xl/workbook.xml", "<x/>")
    (tmp_path / "a.xlsx").write_bytes(packed.getvalue())
    with pytest.raises(PosesError, match="save the sheet as CSV"):
        table.read([tmp_path / "a.xlsx"])
