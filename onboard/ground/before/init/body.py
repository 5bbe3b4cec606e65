"""A vehicle file, a URDF and a mapping of a body without joints on an air-bearing table, moved by its thrusters."""

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

from onboard import config
from onboard.config.keys import schema
from onboard.ground.before.init import devices
from onboard.ground.before.init.drawing import DrawnUrdf, with_frame
from onboard.ground.before.init.sketch import mount
from onboard.ground.before.init.vehicle import write_files

_NAME = re.compile(r"[A-Za-z]\w{0,27}", re.ASCII)
_MARKER = "marker"
_YOURS = "         <!-- yours -->"
_CORNERS = ((1, 1), (-1, 1), (-1, -1), (1, -1))


class NewBody(NamedTuple):
    """What a new body has.

    ``thrusters``: their names, those of frames of the URDF at hand where there is one; the force is along a frame's x.
    ``marker``: frame that is tracked.
    """

    name: str
    thrusters: tuple[str, ...]
    force_N: float = 1.0  # noqa: N815
    drawn: DrawnUrdf | None = None
    marker: str = _MARKER


def files(wanted: NewBody) -> dict[str, str]:
    """Text of each file by its name.

    Raises:
        ConfigError: no thrusters, a name that cannot be one, or a URDF that has joints.
    """
    bad = [name for name in wanted.thrusters if not _NAME.fullmatch(name)]
    if not wanted.thrusters or bad or len(set(wanted.thrusters)) < len(wanted.thrusters):
        raise config.ConfigError(
            f"--thrusters {','.join(wanted.thrusters)}: give each a name of letters, digits and _ once"
        )
    if not 0.0 < wanted.force_N < 1e6:
        raise config.ConfigError(f"--force {wanted.force_N:g}: give the force of a thruster that is on, in N")
    drawn = wanted.drawn
    if drawn is not None and drawn.joints:
        joints = ", ".join(drawn.joints)
        raise config.ConfigError(f"the URDF has joints that move ({joints}); a body by its thrusters has none")
    if drawn is not None:
        if missing := [name for name in wanted.thrusters if name not in drawn.frames]:
            raise config.ConfigError(
                f"the URDF has no frame {missing[0]!r}; --thrusters names its frames, each with x along the force"
            )
        if wanted.marker not in drawn.frames:
            drawn = drawn._replace(text=with_frame(drawn, wanted.marker, drawn.root))
    root = drawn.root if drawn else "body"
    return {
        "vehicle.toml": _vehicle(wanted, root),
        "vehicle.urdf": drawn.text if drawn else _sketch(wanted),
        "import.toml": _mapping(wanted),
    }


def _vehicle(wanted: NewBody, root: str) -> str:
    thrusters = "".join(
        f"""
[device.{name}]
kind = "recorded_thruster"
frame = {json.dumps(name)}
axis = [1.0, 0.0, 0.0]         # of the frame: direction of the force on the body
force_N = {wanted.force_N:g}{" " * max(1, 21 - len(f"{wanted.force_N:g}"))}# where the level is 1: yours
scale_sigma = 0.05             # relative, of this thruster alone: yours
period_ms = 20                 # of the commands: yours
"""
        for name in wanted.thrusters
    )
    return f"""{schema.FIRST_LINE}
# Made by heft init. Numbers that are "yours" are placeholders: put yours there. Every key: docs/vehicle.md,
# those of devices: docs/devices.md.

[vehicle]
name = {json.dumps(wanted.name)}
urdf = "vehicle.urdf"
base = "planar"                # it floats on an air-bearing table: x, y and yaw are free
base_link = {json.dumps(root)}

[body]                         # it has no joints: its thrusters move it. 1 sigma
# mass_sigma = 0.005           # relative, of the URDF's mass, if you weighed it: sets the scale of all forces
# common_force_sigma = 0.05    # of the force of all thrusters alike (supply pressure); silent: as scale_sigma
tilt_sigma_m_s2 = 0.01         # gravity along the table: a milliradian is 0.01
delay_ms = [-100, 700]         # from command to force: looked for between these
place_sigma_m = 2e-3           # of each thruster: yours
turn_sigma_rad = 0.01

[device.pose]                  # in channels pose_x, pose_y, pose_yaw
kind = "recorded_pose"
frame = {json.dumps(wanted.marker)}
period_ms = 10                 # yours
position_noise_m = 5e-4        # of a pose: yours
yaw_noise_rad = 1e-3
{thrusters}
[estimation]
method = "exiddm"              # predicts the tracked pose
"""


def _mapping(wanted: NewBody) -> str:
    text = devices.mapping(wanted.name, [])
    pose = (("pose_x", "x", "1e-6", "m"), ("pose_y", "y", "1e-6", "m"), ("pose_yaw", "yaw", "1e-7", "rad"))
    for channel, column, scale, unit in (*pose, *((name, name, "1e-4", "1") for name in wanted.thrusters)):
        text += f"""
[channel.{channel}]
record = "scalar"
value = {{ column = {json.dumps(column)}, values = "physical", scale = {scale}, unit = "{unit}" }}
"""
    return text


def _sketch(wanted: NewBody) -> str:
    frames = [mount(_MARKER, "body", "0 0 0", "0 0 0", _YOURS)]
    for k, name in enumerate(wanted.thrusters):
        x, y = _CORNERS[k // 2 % 4]
        yaw = (0.0 if x < 0 else 3.14159265) if k % 2 == 0 else (1.57079633 if y < 0 else -1.57079633)
        frames.append(mount(name, "body", f"{0.2 * x:g} {0.2 * y:g} 0", f"0 0 {yaw:g}", _YOURS))
    return f"""<?xml version="1.0"?>
<!-- Made by heft init: a sketch of a body on a table. SI units. Mass and places of the frames are yours to put in;
     each thruster's frame has its x along the force on the body. Centre and inertia will be identified: guess. -->
<robot name={quoteattr(wanted.name)}>

  <link name="body">
    <inertial>                                            <!-- yours -->
      <origin xyz="0 0 0" rpy="0 0 0"/>
      <mass value="10"/>
      <inertia ixx="0.2" iyy="0.2" izz="0.2" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
{"".join(frames)}</robot>
"""


def names_of(text: str) -> Sequence[str]:
    """Names of thrusters: how many, or names with commas."""
    return [f"t{k + 1}" for k in range(int(text))] if text.isdecimal() and len(text) < 3 else text.split(",")


def write(wanted: NewBody, directory: Path) -> list[Path]:
    """Write the vehicle into ``directory``; returns the files.

    Raises:
        ConfigError: as :func:`files`.
        FileExistsError: there is a vehicle already.
    """
    return write_files(directory, files(wanted))
