"""A flight as standard ROS 2 messages in MCAP, for viewers and tools that know no message of heft's.

``/imu/NAME`` (sensor_msgs/Imu) of every IMU at its own rate, ``/joint_states`` (sensor_msgs/JointState) and ``/tf``
(tf2_msgs/TFMessage) of the URDF's joints at even instants, ``/robot_description`` (std_msgs/String). Stamps are sample
times: UTC where the log knows it, else vehicle time. The base link stands still: nobody measures where it is.
"""

import heapq
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

import numpy as np
from mcap.writer import Writer
from rich.progress import Progress
from scipy.spatial.transform import Rotation

from drivers.records import Rows
from onboard.devices import si
from onboard.devices.roles import ANGLE
from onboard.estimation.arrays import FloatArray
from onboard.flight.estimate.readings.roles import roles_of
from onboard.ground.log.export.aligned import aligned
from onboard.ground.log.export.dump import DumpResult, begin
from onboard.ground.log.tables.columns import TIME_FIELD, TableColumn
from onboard.ground.log.tables.flight_tables import FlightTables
from onboard.ground.log.tables.progress import follow
from onboard.ground.log.tables.vehicle_file import urdf_of
from onboard.ground.log.tables.vehicle_time import UNKNOWN

RATE_HZ = 50.0  # of joint states and transforms
_HEADER = "std_msgs/Header header\n"
_PARTS = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
    "geometry_msgs/TransformStamped": f"{_HEADER}string child_frame_id\ngeometry_msgs/Transform transform\n",
}
_IMU = (
    f"{_HEADER}geometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
    "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
    "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n"
)
_SCHEMAS = {
    "sensor_msgs/msg/Imu": (_IMU, ["std_msgs/Header", *list(_PARTS)[1:4]]),
    "sensor_msgs/msg/JointState": (
        f"{_HEADER}string[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n",
        list(_PARTS)[:2],
    ),
    "tf2_msgs/msg/TFMessage": ("geometry_msgs/TransformStamped[] transforms\n", list(_PARTS)),
    "std_msgs/msg/String": ("string data\n", []),
}


class _Message(NamedTuple):
    at_ns: int
    topic: str
    data: bytes


class _Joint(NamedTuple):
    """A joint of the URDF: child in parent at rest, axis, kind."""

    name: str
    parent: str
    child: str
    place: FloatArray  # (3,)
    turn: Rotation
    axis: FloatArray  # (3,)
    slides: bool


def dump_standard(
    tables: FlightTables, target: Path, *, force: bool = False, progress: Progress | None = None
) -> DumpResult:
    """Write ``target/standard.mcap``.

    Raises:
        FileExistsError: it is there, and ``force`` was not asked for.
        ValueError: no vehicle is known.
        OSError: a file cannot be read or written.
    """
    joints = _Joints(tables)
    path = target / "standard.mcap"
    topics = {f"/imu/{name}": "sensor_msgs/msg/Imu" for name in joints.imus} | {
        "/joint_states": "sensor_msgs/msg/JointState",
        "/tf": "tf2_msgs/msg/TFMessage",
        "/robot_description": "std_msgs/msg/String",
    }
    counts = dict.fromkeys(topics, 0)
    tell = follow(progress, "dump", tables.log)
    with begin(target, tables, {"standard": path.name}, force=force) as made, (made / path.name).open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="heft dump")
        schemas = {name: writer.register_schema(name, "ros2msg", _text(name)) for name in sorted(set(topics.values()))}
        channels = {topic: writer.register_channel(topic, "cdr", schemas[name]) for topic, name in topics.items()}
        streams = (joints.described(), joints.states(), *(joints.sampled(name) for name in joints.imus))
        for message in heapq.merge(*streams, key=lambda one: one.at_ns):
            at_ns, topic, data = message
            writer.add_message(channels[topic], at_ns, data, at_ns, counts[topic])
            counts[topic] += 1
            tell()
        writer.finish()  # type: ignore[no-untyped-call]
    return DumpResult((path,), counts, tables.log.damage, tables.log.exit_code)


class _Joints:
    """A flight's IMUs and joints as messages."""

    def __init__(self, tables: FlightTables) -> None:
        if tables.vehicle is None:
            raise ValueError(f"{tables.log.path}: no vehicle is known ({tables.why_none}); give --vehicle")
        self._tables = tables
        self._roles = roles_of(tables.vehicle)
        self._offset_ns = tables.times.utc_offset_ns or 0
        self._urdf = urdf_of(tables.log, tables.vehicle)
        self._tree = [_joint(element) for element in ET.fromstring(self._urdf).iterfind("joint")]
        alone = [imu.channels[0] for imu in self._roles.imus if len(imu.channels) == 1]
        self.imus = [name for name in alone if name in tables.clocked]

    def described(self) -> Iterator[_Message]:
        """The URDF."""
        cdr = _Cdr()
        cdr.text(self._urdf)
        yield _Message(self._tables.times.start_ns + self._offset_ns, "/robot_description", cdr.data)

    def sampled(self, name: str) -> Iterator[_Message]:
        """Every usable sample of an IMU whose time is known."""
        frame = self._tables.meanings[name].frame
        gyro, accel = self._roles.signals[name].noise[0] ** 2, self._roles.signals[name].noise[-1] ** 2
        unknown = [-1.0, *[0.0] * 8]  # REP 145: no orientation
        for _, rows in self._tables.batches([name]):
            good = rows[(rows[TIME_FIELD] != UNKNOWN) & si.usable(rows)]
            for at_ns, values in zip(
                good[TIME_FIELD].tolist(), si.imu(good, self._roles.signals[name]).tolist(), strict=True
            ):
                cdr = _Cdr()
                cdr.header(at_ns + self._offset_ns, frame)
                cdr.numbers([0.0, 0.0, 0.0, 1.0, *unknown])
                cdr.numbers([*values[:3], gyro, 0, 0, 0, gyro, 0, 0, 0, gyro])
                cdr.numbers([*values[3:], accel, 0, 0, 0, accel, 0, 0, 0, accel])
                yield _Message(at_ns + self._offset_ns, f"/imu/{name}", cdr.data)

    def states(self) -> Iterator[_Message]:
        """Angles of the joints at even instants, and the transforms they make."""
        measured = {joint.joint: joint.channel for joint in self._roles.joints if not joint.is_rate}
        channels = [channel for channel in measured.values() if channel in self._tables.clocked]
        if not channels:
            return
        found = aligned(self._tables, channels, RATE_HZ)
        columns = {column.name.removesuffix(".value"): column for column in found.columns}
        names = [joint for joint, channel in measured.items() if channel in channels]
        for block in found.blocks:
            angles = np.column_stack([_radians(columns[measured[name]], block) for name in names])
            for at_ns, row in zip((block[TIME_FIELD] + self._offset_ns).tolist(), angles, strict=True):
                known = {name: float(angle) for name, angle in zip(names, row, strict=True) if np.isfinite(angle)}
                yield _Message(at_ns, "/joint_states", _state(at_ns, known))
                yield _Message(at_ns, "/tf", self._transforms(at_ns, known))

    def _transforms(self, at_ns: int, angles: dict[str, float]) -> bytes:
        shown = [joint for joint in self._tree if joint.name in angles or not joint.axis.any()]
        cdr = _Cdr()
        cdr.count(len(shown))
        for joint in shown:
            q = angles.get(joint.name, 0.0)
            place = joint.place + joint.turn.apply(joint.axis * q) if joint.slides else joint.place
            turn = joint.turn if joint.slides else joint.turn * Rotation.from_rotvec(joint.axis * q)
            cdr.header(at_ns, joint.parent)
            cdr.text(joint.child)
            cdr.numbers([*place, *turn.as_quat()])
        return cdr.data


class _Cdr:
    """Plain CDR version 1, little-endian; alignment counts from behind the encapsulation header."""

    def __init__(self) -> None:
        self._body = bytearray()

    @property
    def data(self) -> bytes:
        """The message."""
        return b"\x00\x01\x00\x00" + bytes(self._body)

    def _align(self, size: int) -> None:
        self._body += bytes(-len(self._body) % size)

    def count(self, number: int) -> None:
        self._align(4)
        self._body += struct.pack("<I", number)

    def text(self, text: str) -> None:
        data = text.encode() + b"\0"
        self.count(len(data))
        self._body += data

    def numbers(self, numbers: list[float]) -> None:
        self._align(8)
        self._body += struct.pack(f"<{len(numbers)}d", *numbers)

    def header(self, at_ns: int, frame: str) -> None:
        self._align(4)
        self._body += struct.pack("<iI", *divmod(at_ns, 1_000_000_000))
        self.text(frame)


def _radians(column: TableColumn, block: Rows) -> FloatArray:
    return np.asarray(column.values(block), np.float64) * ANGLE.get(column.unit.encode(), 1.0)


def _state(at_ns: int, angles: dict[str, float]) -> bytes:
    cdr = _Cdr()
    cdr.header(at_ns, "")
    cdr.count(len(angles))
    for name in angles:
        cdr.text(name)
    cdr.count(len(angles))
    if angles:
        cdr.numbers(list(angles.values()))
    cdr.count(0)  # velocity
    cdr.count(0)  # effort
    return cdr.data


def _text(name: str) -> bytes:
    own, parts = _SCHEMAS[name]
    return "".join([own, *(f"{'=' * 80}\nMSG: {part}\n{_PARTS[part]}" for part in parts)]).encode()


def _joint(element: ET.Element) -> _Joint:
    def numbers(tag: str, attribute: str, usual: str) -> FloatArray:
        found = element.find(tag)
        return np.array([float(part) for part in (usual if found is None else found.get(attribute, usual)).split()])

    def link(tag: str) -> str:
        found = element.find(tag)
        return "" if found is None else found.get("link", "")

    kind = element.get("type")
    axis = np.zeros(3) if kind == "fixed" else numbers("axis", "xyz", "1 0 0")
    turn = Rotation.from_euler("xyz", numbers("origin", "rpy", "0 0 0"))
    place = numbers("origin", "xyz", "0 0 0")
    return _Joint(element.get("name", ""), link("parent"), link("child"), place, turn, axis, kind == "prismatic")
