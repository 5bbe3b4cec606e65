"""A vehicle file and a mapping of a recorded body on a spherical air bearing, which turns by its reaction wheels."""

import json
from pathlib import Path
from typing import NamedTuple

from onboard import config
from onboard.config.keys import schema
from onboard.ground.before.init import devices
from onboard.ground.before.init.devices import NewDevice
from onboard.ground.before.init.drawing import DrawnUrdf, with_frame
from onboard.ground.before.init.vehicle import write_files

_PHASES = """
# A run without the proof mass and another with it: heft merge --in-turn recording WITHOUT.mcap WITH.mcap -o both.mcap.
# heft identify takes it for set on from the second recording on. In a single run, where a column says when:
# [device.phase]
# kind = "recorded_value"
# period_ms = 5
# [estimation.phases]
# channel = "phase"
# identify = [1, 2]            # without and with the proof mass; any other number while it is touched
# payload_taken = 2
# settle_ms = 100
"""


class NewBed(NamedTuple):
    """What a new body on a pivot has.

    ``drawn``: its URDF, whose base link has its origin at the pivot and whose joints turn the wheels. ``imu_frame``: a
    link of it, or one to be added at the pivot. ``proof``: a link, the known mass that is set on for a part of the run;
    none where empty.
    """

    name: str
    drawn: DrawnUrdf
    imu_frame: str
    proof: str = ""


def write(wanted: NewBed, directory: Path) -> list[Path]:
    """Write the vehicle into ``directory``; returns the files.

    Raises:
        ConfigError: no wheels, or a proof mass that weighs nothing.
        FileExistsError: there is a vehicle already.
    """
    drawn = wanted.drawn
    if not drawn.joints:
        raise config.ConfigError(
            "a body on a pivot is moved by reaction wheels: no joint of the URDF turns a wheel; thrusters on a "
            "bearing do not take part, they are identified on a table: --base planar --thrusters (docs/recordings.md)"
        )
    if wanted.proof and wanted.proof not in drawn.links:
        raise config.ConfigError(
            f"--payload-link {wanted.proof} is the proof mass, which is known: give it its mass and place in the URDF"
        )
    if wanted.imu_frame not in drawn.frames:
        drawn = drawn._replace(text=with_frame(drawn, wanted.imu_frame, drawn.root))
    chosen = [
        devices.imu(devices.RECORDED, wanted.imu_frame),
        *map(_wheel, devices.of_joints(drawn.joints), drawn.joints),
    ]
    phases = _PHASES if wanted.proof else ""
    text = "".join([_head(wanted), *(device.text for device in chosen), phases, _rest(wanted)])
    mapping = devices.mapping(wanted.name, chosen)
    return write_files(directory, {"vehicle.toml": text, "vehicle.urdf": drawn.text, "import.toml": mapping})


def _head(wanted: NewBed) -> str:
    proof = f"payload_link = {json.dumps(wanted.proof)}        # a known mass that is set on for a part of the run"
    return f"""{schema.FIRST_LINE}
# Made by heft init. Numbers that are "yours" are placeholders: put yours there. Every key: docs/vehicle.md,
# those of devices: docs/devices.md. All of it: docs/spherical_bearing.md.

[vehicle]
name = {json.dumps(wanted.name)}
urdf = "vehicle.urdf"
base = "pivot"                 # three rotations about the base link's origin; gravity turns it there
base_link = {json.dumps(wanted.drawn.root)}
{proof if wanted.proof else ""}
"""


def _wheel(device: str, joint: str) -> NewDevice:
    return NewDevice(
        f"""
[device.{device}]
kind = "recorded_rate"
joint = {json.dumps(joint)}             # of the URDF
period_ms = 5                  # yours
noise_rad_s = 0.02             # of a sample: yours
scale_sigma = 0.003            # yours: of what it stores, inertia in the URDF times speed; all answers scale with it
delay_sigma_ms = 0.2           # yours
repeats = true                 # a wheel at rest
""",
        "",
    )


def _rest(wanted: NewBed) -> str:
    proof = (
        "\nproof_sigma = 0.002            # relative, of the proof mass times its lever: yours" if wanted.proof else ""
    )
    return f"""
[estimation]
method = "exiddm"              # predicts the IMU from what the wheels do
row_rate_hz = 20
smoothing_ms = 100             # of the wheels' speeds

[estimation.exiddm]
held_at_start = false

[estimation.imu_prior]         # 1 sigma by axis of what calibration leaves of the IMU: yours
gyro_bias_rad_s = 0.02
gyro_drift_rad_s2 = 1e-4
gyro_scale = 0.003
gyro_misalignment_rad = 8.7e-3
accelerometer_bias_m_s2 = 0.1
accelerometer_scale = 0.003
accelerometer_misalignment_rad = 8.7e-3
delay_s = 1e-4
position_m = 3e-3

[pivot]{proof}

# [[pivot.balance]]            # each mass that can be moved: how far it is to go is answered as move_NAME
# name = "trim_x"
# mass_kg = 0.2
# axis = [1.0, 0.0, 0.0]
"""
