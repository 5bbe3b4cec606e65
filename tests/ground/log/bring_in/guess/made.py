"""Recordings of the usual kinds, made here: motions by formulae, files by their makers' own writers or by hand."""

import json
import struct
from pathlib import Path
from typing import NamedTuple

import numpy as np
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

COUNT, PERIOD_s = 400, 0.008
T = PERIOD_s * np.arange(COUNT)
BEGAN_ns = 1_700_000_000 * 10**9


class Arm(NamedTuple):
    """Angles, rates and torques of joints."""

    q: np.ndarray
    qd: np.ndarray
    tau: np.ndarray


def arm(joints: int) -> Arm:
    w = 1.0 + np.arange(joints)
    q = 0.6 * np.sin(w * T[:, None]) + 0.1 * np.arange(joints)
    noise = np.random.default_rng(5).normal(size=q.shape)
    return Arm(q, 0.6 * w * np.cos(w * T[:, None]), 10.0 * np.cos(q) + 0.05 * noise)


class Body(NamedTuple):
    """Rates of turn in rad/s, specific force in m/s^2, attitude w, x, y, z about one axis."""

    rate: np.ndarray
    force: np.ndarray
    attitude: np.ndarray


def body(largest: float = 1.5) -> Body:
    """It lies still for a while, and turns about x then."""
    begun = np.maximum(T - 1.0, 0.0)
    angle = 0.5 * largest * (1.0 - np.cos(2.0 * begun))
    rate = np.column_stack([largest * np.sin(2.0 * begun), 0.0 * T, 0.0 * T])
    noise = 0.02 * np.random.default_rng(6).normal(size=(COUNT, 3))
    gravity = 9.81 * np.column_stack([0.0 * T, np.sin(angle), np.cos(angle)])
    attitude = np.column_stack([np.cos(0.5 * angle), np.sin(0.5 * angle), 0.0 * T, 0.0 * T])
    return Body(rate, gravity + noise, attitude)


def text(path: Path, names, columns, between=",", decimal=".", encoding="utf-8", before="", digits=7) -> Path:
    """A table of text."""
    rows = [
        between.join(c if isinstance(c, str) else f"{c:.{digits}f}".replace(".", decimal) for c in row)
        for row in zip(*columns, strict=True)
    ]
    lines = [between.join(names), *rows] if names else rows
    path.write_bytes((before + "\n".join(lines) + "\n").encode(encoding))
    return path


IMU_NAMES = ("time", "gyro_x", "gyro_y", "gyro_z", "acc_x", "acc_y", "acc_z")


def imu_columns(of: Body) -> list[np.ndarray]:
    return [T, *of.rate.T, *of.force.T]


def rtde(path: Path, between=",") -> Path:
    """As `record.py` of Universal Robots' RTDE client writes it."""
    own = arm(6)
    groups = {
        "target_q": own.q + 1e-3,
        "target_moment": own.tau,
        "actual_q": own.q,
        "actual_qd": own.qd,
        "actual_current": own.tau / 10.0,
        "actual_current_window": np.ones((COUNT, 6)),
        "actual_TCP_pose": own.q,
        "actual_TCP_force": own.tau,
        "joint_temperatures": np.full((COUNT, 6), 31.5),
    }
    names = ["timestamp", *(f"{name}_{k}" for name in groups for k in range(6)), "runtime_state", "speed_scaling"]
    columns = [12345.0 + T, *(one for group in groups.values() for one in group.T), 0.0 * T + 2.0, 0.0 * T + 1.0]
    return text(path, names, columns, between)


def franka(path: Path) -> Path:
    """As a log of libfranka's states: time in ms, arrays by brackets, what was commanded beside what was measured."""
    own = arm(7)
    groups = {
        "q": own.q,
        "q_d": own.q + 1e-3,
        "dq": own.qd,
        "dq_d": own.qd,
        "tau_J": own.tau,
        "tau_J_d": own.tau,
        "dtau_J": own.tau,
        "tau_ext_hat_filtered": own.tau,
        "O_T_EE": np.tile(np.eye(4).ravel(), (COUNT, 1)),
    }
    names = ["time", *(f"{name}[{k}]" for name, group in groups.items() for k in range(group.shape[1]))]
    return text(path, names, [1000.0 * T, *(one for group in groups.values() for one in group.T)])


def rostopic(path: Path) -> Path:
    """As ``rostopic echo -p`` writes an IMU."""
    of = body()
    stamps = [str(BEGAN_ns + k * round(1e9 * PERIOD_s)) for k in range(COUNT)]
    vectors = {"orientation": (of.attitude[:, [1, 2, 3, 0]], "xyzw"), "angular_velocity": (of.rate, "xyz")}
    vectors["linear_acceleration"] = of.force, "xyz"
    names = ["%time", "field.header.seq", "field.header.stamp", "field.header.frame_id"]
    names += [f"field.{name}.{axis}" for name, (_, axes) in vectors.items() for axis in axes]
    names += [f"field.orientation_covariance{k}" for k in range(9)]
    columns = [stamps, [str(k) for k in range(COUNT)], stamps, ["body"] * COUNT]
    columns += [one for values, _ in vectors.values() for one in values.T]
    return text(path, names, [*columns, *([0.0] * COUNT for _ in range(9))])


def _messages(store, ros2: bool):
    """An IMU, joints whose order changes from message to message, a wrench: topic, type, arrival, message."""
    types = store.types
    of, joints = body(), arm(2)
    vector = types["geometry_msgs/msg/Vector3"]
    for k in range(COUNT):
        ns = BEGAN_ns + k * round(1e9 * PERIOD_s)
        stamp = types["builtin_interfaces/msg/Time"](ns // 10**9, ns % 10**9)
        header = types["std_msgs/msg/Header"](*(() if ros2 else (k,)), stamp, "body")
        w, x, y, z = of.attitude[k].tolist()
        turned = types["geometry_msgs/msg/Quaternion"](x, y, z, w)
        parts = (
            turned,
            np.zeros(9),
            vector(*of.rate[k].tolist()),
            np.zeros(9),
            vector(*of.force[k].tolist()),
            np.zeros(9),
        )
        yield "/imu/data", "sensor_msgs/msg/Imu", ns + 2_000_000, types["sensor_msgs/msg/Imu"](header, *parts)
        order = [1, 0] if k % 2 else [0, 1]
        state = [["shoulder", "elbow"][j] for j in order], *(values[k][order] for values in joints)
        yield (
            "/joint_states",
            "sensor_msgs/msg/JointState",
            ns + 3_000_000,
            types["sensor_msgs/msg/JointState"](header, *state),
        )
        wrench = types["geometry_msgs/msg/Wrench"](vector(1.0, 2.0, float(T[k])), vector(0.1, 0.2, 0.3))
        made = types["geometry_msgs/msg/WrenchStamped"](header, wrench)
        yield "/wrench", "geometry_msgs/msg/WrenchStamped", ns + 4_000_000, made


def bag_1(path: Path) -> Path:
    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer1(path) as writer:
        known = {}
        for topic, kind, ns, message in _messages(store, ros2=False):
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(known[topic], ns, store.serialize_ros1(message, kind))
    return path


def bag_2(path: Path, plugin=StoragePlugin.SQLITE3) -> Path:
    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer2(path, version=9, storage_plugin=plugin) as writer:
        known = {}
        for topic, kind, ns, message in _messages(store, ros2=True):
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(known[topic], ns, store.serialize_cdr(message, kind))
    return path


def mcap_of_ros(path: Path) -> Path:
    """The file of a bag of ROS 2, without what lies beside it."""
    [file] = bag_2(path.with_suffix(".bag2"), StoragePlugin.MCAP).glob("*.mcap")
    return file.rename(path)


def mcap_of_json(path: Path) -> Path:
    of = body()
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        schema = writer.register_schema("imu", "jsonschema", b"{}")
        channel = writer.register_channel("/imu", "json", schema)
        other = writer.register_channel("/camera", "protobuf", writer.register_schema("image", "protobuf", b""))
        for k in range(COUNT):
            gyro, accel = (dict(zip("xyz", one[k].tolist(), strict=True)) for one in (of.rate, of.force))
            ns = BEGAN_ns + k * round(1e9 * PERIOD_s)
            writer.add_message(channel, ns, json.dumps({"gyro": gyro, "accel": accel, "frame": "b"}).encode(), ns)
            writer.add_message(other, ns, b"\x00\x01", ns)
        writer.finish()
    return path


def ulog(path: Path) -> Path:
    """PX4's, by the format's description (docs.px4.io, ULog File Format), byte by byte."""
    of = body()

    def message(kind: str, data: bytes) -> bytes:
        return struct.pack("<HB", len(data), ord(kind)) + data

    out = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + message("B", bytes(40))
    out += message(
        "F",
        b"sensor_combined:uint64_t timestamp;float[3] gyro_rad;uint32_t gyro_integral_dt;"
        b"int32_t accelerometer_timestamp_relative;float[3] accelerometer_m_s2;uint32_t accelerometer_integral_dt;"
        b"uint8_t accelerometer_clipping;uint8_t[7] _padding0;",
    )
    out += message("F", b"vehicle_attitude:uint64_t timestamp;float[4] q;")
    out += message("A", struct.pack("<BH", 0, 0) + b"sensor_combined")
    out += message("A", struct.pack("<BH", 0, 1) + b"vehicle_attitude")
    for k in range(COUNT):
        us = 5_000_000 + k * round(1e6 * PERIOD_s)
        imu = struct.pack("<HQ3fIi3fIB", 0, us, *of.rate[k], 8000, 0, *of.force[k], 8000, 0)
        out += message("D", imu) + message("D", struct.pack("<HQ4f", 1, us + 500, *of.attitude[k]))
    path.write_bytes(out)
    return path
