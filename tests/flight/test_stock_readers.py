"""A flight's log in other people's hands: the stock ``mcap`` reader, ``mcap-ros2-support``, a Lichtblick layout."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import heft
from onboard import cli
from tests.flight.missions import Result

LAYOUT = Path(__file__).resolve().parents[2] / "docs" / "lichtblick_rocksat.json"


def test_every_channel_of_a_flight_decodes_to_the_same_numbers(short_mission: Result) -> None:
    log = short_mission.log
    channels = log.channels
    seen = {name: {field: [] for field in dtype.names or ()} for name, dtype in channels.items()}
    with short_mission.path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            assert message.log_time == decoded.host_ns
            for field, values in seen[channel.topic].items():
                values.append(getattr(decoded, field))
    assert sum(len(next(iter(fields.values()))) for fields in seen.values()) > 15_000
    for name, dtype in channels.items():
        rows = log.read(name)
        for field, values in seen[name].items():
            ours = rows[field].reshape(len(rows), *([dtype[field].shape[0]] if dtype[field].shape else []))
            if dtype[field].base.kind == "S":
                assert b"".join(values) == np.ascontiguousarray(rows[field]).tobytes(), f"{name}.{field}"
            else:
                theirs = np.array(values, ours.dtype).reshape(ours.shape)
                assert np.array_equal(ours, theirs, equal_nan=ours.dtype.kind == "f"), f"{name}.{field}"


def test_rosbags_decodes_every_channel(short_mission: Result) -> None:
    """It refuses a message with more than three bytes behind its last field."""
    store = get_typestore(Stores.EMPTY)
    seen: dict[str, list[int]] = {}
    with short_mission.path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages(log_time_order=False):
            assert schema is not None
            if schema.name not in store.fielddefs:
                store.register(get_types_from_msg(schema.data.decode(), schema.name))
            seen.setdefault(channel.topic, []).append(store.deserialize_cdr(message.data, schema.name).sequence)
    log = short_mission.log
    with_rows = [name for name in log.channels if len(log.read(name))]
    assert len(with_rows) > 10
    for name in with_rows:
        assert seen[name] == log.read(name)["sequence"].tolist(), name


def test_standard_messages_say_what_the_flight_measured(short_mission: Result, tmp_path: Path) -> None:
    """Read by rosbags with its own definitions of the messages; transforms against Pinocchio's kinematics."""
    assert cli.main(["dump", str(short_mission.path), "--to", "mcap", str(tmp_path)]) == cli.OK
    store = get_typestore(Stores.ROS2_HUMBLE)
    said: dict[str, list[Any]] = {}
    with (tmp_path / "standard.mcap").open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert schema is not None
            decoded: Any = store.deserialize_cdr(message.data, schema.name)
            if hasattr(decoded, "header"):
                assert decoded.header.stamp.sec * 10**9 + decoded.header.stamp.nanosec == message.log_time
            said.setdefault(channel.topic, []).append(decoded)
    log = heft.open(short_mission.path)
    imu = log["imu_base"].to_numpy()
    assert {one.header.frame_id for one in said["/imu/imu_base"]} == {"imu_base"}
    measured = np.array([one.angular_velocity.z for one in said["/imu/imu_base"]])
    assert np.array_equal(measured, imu["gyro_imu_base_z"][imu["status"] == 0])
    angles = [dict(zip(one.name, one.position, strict=True)) for one in said["/joint_states"]]
    assert len(angles) == len(said["/tf"]) > 300
    even = log.resample(50.0, ["joint_1"]).columns["joint_1.value"]
    assert np.array_equal([one.get("joint_1", np.nan) for one in angles], even, equal_nan=True)
    [description] = said["/robot_description"]
    model = pinocchio.buildModelFromXML(description.data)
    for number in range(50, 300, 50):
        frames = {}
        for one in said["/tf"][number].transforms:
            q, p = one.transform.rotation, one.transform.translation
            turn = pinocchio.Quaternion(q.w, q.x, q.y, q.z).matrix()
            frames[one.child_frame_id] = one.header.frame_id, pinocchio.SE3(turn, np.array([p.x, p.y, p.z]))
        placed, link = pinocchio.SE3.Identity(), "tip_mass"
        while link in frames:
            link, step = frames[link]
            placed = step * placed
        assert link == "plate"
        data = model.createData()
        pinocchio.framesForwardKinematics(model, data, np.array([angles[number]["joint_1"]]))
        theirs = data.oMf[model.getFrameId("tip_mass")]
        assert np.allclose(placed.homogeneous, theirs.homogeneous, atol=1e-12)


def plotted() -> list[str]:
    configs = json.loads(LAYOUT.read_text(encoding="utf-8"))["configById"]
    return [path["value"] for panel in configs.values() for path in panel.get("paths", [])]


def test_the_lichtblick_layout_plots_what_a_flight_records(short_mission: Result) -> None:
    channels = short_mission.log.channels
    paths = plotted()
    assert len(paths) > 10
    for path in paths:
        match = re.fullmatch(r"(?P<topic>\w+)\.(?P<field>\w+)(?:\[(?P<index>\d+)\])?", path)
        assert match, path
        field = channels[match["topic"]][match["field"]]
        assert field.base.kind in "iuf", path
        assert (match["index"] is None) == (field.shape == ()), path
        assert match["index"] is None or int(match["index"]) < field.shape[0], path


def test_the_layout_shows_every_panel_it_describes() -> None:
    layout = json.loads(LAYOUT.read_text(encoding="utf-8"))

    def panels(node: object) -> list[str]:
        if isinstance(node, dict):
            return panels(node["first"]) + panels(node["second"])
        return [str(node)]

    assert sorted(panels(layout["layout"])) == sorted(layout["configById"])
