"""A vehicle file and a URDF to begin with: valid at once, every number that only the builder knows marked ``yours``."""

import json
import math
import shutil
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

from onboard import config
from onboard.config.keys import schema
from onboard.devices.base import ImuDevice, JointDevice, LoadCellDevice
from onboard.dynamics.model.bases import BASES as KINDS
from onboard.dynamics.model.bases import BaseKind
from onboard.flight.estimate.problem.identification import build_online
from onboard.ground.before.init import devices, drawing, drives, pucks
from onboard.ground.before.init.devices import NewDevice
from onboard.ground.before.init.drawing import DrawnUrdf
from onboard.ground.before.init.sketch import link, mount

BASES = tuple(name for name in KINDS if name != BaseKind.PIVOT.name)  # that one has no arm: bed.py
IMUS = (*devices.kinds(ImuDevice), devices.RECORDED, "none")
ENCODERS = (*devices.kinds(JointDevice), devices.RECORDED)
LOAD_CELLS = (*devices.kinds(LoadCellDevice), devices.RECORDED, "none")
_IMPORT = "import.toml"
_VEHICLE, _URDF = "vehicle.toml", "vehicle.urdf"


class NewVehicle(NamedTuple):
    """What a new vehicle has.

    ``joints``: names, from the base outwards; those of ``drawn``, if there is a URDF at hand. ``imu_frame``,
    ``payload_link``: links of it; where it has none, they are added. ``urls``: of buses, in place of the usual ones.
    """

    name: str
    base: str  # of BASES
    joints: tuple[str, ...]
    imu: str = "mpu6050"
    encoder: str = "cia406"
    load_cell: str = "none"
    pulse: bool = True
    urls: dict[str, str] = {}  # noqa: RUF012  # a NamedTuple's, and read only
    drawn: DrawnUrdf | None = None
    imu_frame: str = "imu_base"
    payload_link: str = "payload"
    gains: tuple[float, ...] = ()  # N m/A of recorded currents, by joint
    drives: bool = False  # what measures the joints moves them, too
    further_imus: tuple[str, ...] = ()  # frames of recorded ones besides the first, on the base

    @property
    def root(self) -> str:
        """Link of the base."""
        return self.drawn.root if self.drawn else "base"

    @property
    def links(self) -> tuple[str, ...]:
        """Links with a mass, the base first, without the payload's."""
        if self.drawn is None:
            return ("base", *(f"link_{n}" for n in range(1, len(self.joints) + 1)))
        return tuple(link for link in self.drawn.links if link != self.payload_link)

    @property
    def floats_on_a_table(self) -> bool:
        """On air bearings."""
        return KINDS[self.base] is BaseKind.PLANAR

    @property
    def pucks(self) -> dict[str, str]:
        """Frames and places of an air-bearing table's."""
        return pucks.places(self.drawn) if self.floats_on_a_table else {}

    @property
    def by_torque(self) -> bool:
        """Whether the joints' torques are used: where they alone show the payload, and on a free base."""
        needed = self.load_cell == "none" and not KINDS[self.base].follows
        by_motor = self.encoder in devices.with_torque() and (needed or self.base == "free")
        return by_motor or (self.recorded and needed)

    @property
    def recorded(self) -> bool:
        """Whether it is known by recordings of others alone."""
        return self.encoder == devices.RECORDED


def make(wanted: NewVehicle, directory: Path) -> list[Path]:
    """Write the vehicle into ``directory``; returns the files.

    Raises:
        ConfigError: a vehicle that can tell nothing, or a name that cannot be one.
        FileExistsError: there is a vehicle already.
    """
    _require(wanted)
    chosen = _devices(wanted)
    buses = {device.bus: device.url for device in chosen if device.bus}
    if unknown := sorted(set(wanted.urls) - set(buses)):
        raise config.ConfigError(f"--bus {unknown[0]}: no device stands on it; the buses are {', '.join(buses)}")
    parts = [
        _head(wanted),
        *(_bus(name, url, wanted) for name, url in buses.items()),
        *(device.text for device in chosen),
    ]
    text = "".join([*parts, devices.IN_TURN if wanted.recorded else "", _rest(wanted)])
    files = {_VEHICLE: text, _URDF: _urdf(wanted) if wanted.drawn is None else _taken_over(wanted, wanted.drawn)}
    if wanted.drives:
        files[_VEHICLE] += drives.table(devices.keys_of_drive(wanted.encoder))
        files[drives.MOTION] = drives.motion(files[_URDF], wanted.joints)
    if wanted.recorded:
        files[_IMPORT] = devices.mapping(wanted.name, chosen)
    return write_files(directory, files)


def copy(name: str, directory: Path) -> list[Path]:
    """Copy a packaged vehicle into ``directory``; returns the files.

    Raises:
        ConfigError: no such packaged vehicle.
        FileExistsError: there is a vehicle already.
    """
    vehicle = config.named(name)
    text = f"{schema.FIRST_LINE}\n{vehicle.text}"
    return write_files(directory, {_VEHICLE: text, vehicle.urdf_path.name: vehicle.urdf_text})


def write_files(directory: Path, files: dict[str, str]) -> list[Path]:
    """The files and the schema, once they are known to be a vehicle."""
    there = [name for name in files if (directory / name).exists()]
    if there:
        raise FileExistsError(f"{directory / there[0]} is there already; name another directory")
    made = directory.exists()
    directory.mkdir(parents=True, exist_ok=True)
    try:
        for name, text in files.items():
            (directory / name).write_text(text, encoding="utf-8")
        vehicle = config.load(directory / _VEHICLE)
        if drives.MOTION in files:
            armed = vehicle.model_copy(update={"arm": True})
            for bus in vehicle.file.bus:
                armed.play(bus)
        if vehicle.file.body is None:  # that one is identified afterwards
            build_online(vehicle)
    except BaseException:
        for name in files:
            (directory / name).unlink(missing_ok=True)
        if not made:
            shutil.rmtree(directory)
        raise
    (directory / schema.FILE).write_text(schema.as_text(), encoding="utf-8")
    return [directory / name for name in (*files, schema.FILE)]


_JOINTLESS = {  # by base
    "free": "; a thrown body shows its inertia by a rotor alone, without it only ratios of its moments: "
    "heft init --from tudelft, docs/free_body.md; with wheels on a spherical bearing: --base pivot",
    BaseKind.PLANAR.name: ", or --thrusters of a body without an arm",
}


def _require(wanted: NewVehicle) -> None:
    if not wanted.joints:
        where = _JOINTLESS.get(wanted.base, "")
        raise config.ConfigError(f"an arm without joints shows nothing of what it holds; give --joints{where}")
    told = wanted.drawn is None and not all(name.isidentifier() for name in wanted.joints)
    if told or len(set(wanted.joints)) < len(wanted.joints):
        raise config.ConfigError(f"--joints {','.join(wanted.joints)}: give each a name of letters, digits and _ once")
    if wanted.gains and not (wanted.recorded and wanted.by_torque):
        raise config.ConfigError(
            "--gains is of recorded currents, of an arm that is weighed by them: --encoder recorded"
        )
    if wanted.gains and len(wanted.gains) != len(wanted.joints):
        raise config.ConfigError(f"--gains has {len(wanted.gains)} numbers, the arm {len(wanted.joints)} joints")
    if wanted.drives and wanted.encoder not in devices.drives():
        raise config.ConfigError(f"--drives: {wanted.encoder} moves nothing; --encoder {' or '.join(devices.drives())}")
    if wanted.imu == "none" and KINDS[wanted.base].moves:
        raise config.ConfigError(f"a base that is {wanted.base} has to be measured: give --imu")
    others = {one for one in (wanted.imu, wanted.load_cell) if one != "none"}
    if (devices.RECORDED in others or wanted.recorded) and {wanted.encoder, *others} != {devices.RECORDED}:
        raise config.ConfigError("what is recorded by somebody else is all of it: give recorded for each device")
    if wanted.load_cell == "none" and not KINDS[wanted.base].follows and not wanted.by_torque:
        text = f"give --load-cell, or --encoder {' or '.join(devices.with_torque())} for the torques of the joints"
        raise config.ConfigError(f"a base that is {wanted.base} shows nothing of the payload: {text}")


def _devices(wanted: NewVehicle) -> list[NewDevice]:
    frames = (wanted.imu_frame, *wanted.further_imus) if wanted.imu != "none" else ()
    rows = not KINDS[wanted.base].follows
    chosen = [devices.imu(wanted.imu, frame, number, by_rows=rows) for number, frame in enumerate(frames, 1)]
    for n, (name, device) in enumerate(zip(wanted.joints, devices.of_joints(wanted.joints), strict=True), 1):
        largest_N_m, smoothed = _largest(wanted, n) if wanted.by_torque else None, wanted.base != "free"
        gain = wanted.gains[n - 1] if wanted.gains else None
        slides = wanted.drawn is not None and name in wanted.drawn.sliding
        options = {"smoothed": smoothed, "driven": wanted.drives, "slides": slides}
        chosen.append(devices.joint(wanted.encoder, n, device, name, largest_N_m, gain_N_m_A=gain, **options))
    chosen += devices.load_cells(wanted.load_cell, len(wanted.joints) + 1, wanted.joints[-1])
    if any(device.bus == devices.CAN for device in chosen):
        chosen.append(devices.SYNC)
    return [*chosen, devices.PULSE] if wanted.pulse and not wanted.recorded else chosen


def _head(wanted: NewVehicle) -> str:
    about = KINDS[wanted.base].about
    return f"""{schema.FIRST_LINE}
# Made by heft init. Numbers that are "yours" are placeholders: put yours there. Every key: docs/vehicle.md,
# those of devices: docs/devices.md. `heft preflight vehicle.toml` says what does not fit.

[vehicle]
name = {json.dumps(wanted.name)}
urdf = "{_URDF}"
base = "{wanted.base}"{" " * max(1, 22 - len(wanted.base))}# it {about}
base_link = {json.dumps(wanted.root)}
payload_link = {json.dumps(wanted.payload_link)}       # what is held: of it nothing need be known
{pucks.tables(wanted.pucks) if wanted.floats_on_a_table else ""}"""


def _bus(name: str, usual: str, wanted: NewVehicle) -> str:
    return f'\n[bus.{name}]\nurl = "{wanted.urls.get(name, usual)}"\n'


# of a link in a fixed or prescribed arm: screws and cables are in no drawing
_DRAWN = (
    "{ mass_relative = 0.02, centre_m = 2e-3, inertia_relative = 0.02 }",
    "as each was weighed, balanced and swung: yours",
)
# of a link in somebody's URDF: bodies of CAD without cables, of another revision, or guessed from a picture
_TAKEN_OVER = (
    "{ mass_relative = 0.3, centre_m = 0.03, inertia_relative = 0.5 }",
    "which somebody drew: less where you know it better",
)
_CALIBRATED = """
[estimation.imu_prior]         # 1 sigma by axis of what calibration leaves of the IMU: yours. As it comes it is useless
gyro_bias_rad_s = 2e-3         # here: an MPU-6050 is off by up to 0.3 rad/s and 0.8 m/s^2
accelerometer_bias_m_s2 = 0.03
"""


def _rest(wanted: NewVehicle) -> str:
    smoothing = devices.smoothing_ms(wanted.encoder, floats=KINDS[wanted.base].follows)
    if KINDS[wanted.base].follows:
        known = "".join(
            f"{json.dumps(link)} = {{ mass_relative = 0.01, centre_m = 1e-3, inertia_relative = 0.03 }}\n"
            for link in wanted.links
        )
        mark, chooses = ("# ", "; silent: heft identify chooses") if wanted.encoder == "recorded" else ("", "")
        rate_hz = "50" if wanted.imu == "nimu" else "100"
        return f"""
[estimation]
method = "exiddm"              # predicts the base IMU; finds the payload, its capture and its ejection
row_rate_hz = {rate_hz}{" " * (17 - len(rate_hz))}# two samples of every device, or more, in a row's period
{mark}smoothing_ms = {smoothing}             # of the joints{chooses}

[estimation.exiddm]
held_at_start = true           # false: it is caught in flight

[estimation.imu_prior]         # 1 sigma by axis of what calibration leaves of the IMU: yours
gyro_bias_rad_s = 8.7e-3
gyro_drift_rad_s2 = 8.7e-5
gyro_scale = 0.003
accelerometer_bias_m_s2 = 0.1
accelerometer_drift_m_s3 = 1e-3
accelerometer_scale = 0.003
mounting_rad = 3.5e-3          # of its housing
delay_s = 1e-4

[estimation.prior.link]        # 1 sigma about the URDF, as each was weighed, balanced and swung: yours
{known}{_of_torques(wanted) if wanted.by_torque else ""}"""
    first, second = ("MX", "MY", "MZ"), ("XX", "XY", "YY", "XZ", "YZ", "ZZ")
    sigmas = {"M": 5.0, **dict.fromkeys(first, 1.0), **dict.fromkeys(second, 0.2)}
    own = {f"{part}_{wanted.payload_link}": sigma for part, sigma in sigmas.items()}
    zeros = {f"bias_{cell}": 5.0 for cell in devices.cells(wanted.load_cell)}
    own |= _torque_sigmas(wanted, devices.IN_GRAVITY) if wanted.by_torque else zeros
    held = "".join(f"{json.dumps(name)} = {sigma}\n" for name, sigma in own.items())
    known, about = _TAKEN_OVER if wanted.recorded and wanted.drawn is not None else _DRAWN
    drawn = "".join(f"{json.dumps(link)} = {known}\n" for link in wanted.links)
    calibrated = _CALIBRATED if wanted.imu != "none" else ""
    mark, chooses = ("# ", "; silent: heft identify chooses") if wanted.recorded and wanted.by_torque else ("", "")
    return f"""
[estimation]
{mark}smoothing_ms = {smoothing}             # of both sides of every row{chooses}
row_noise = "by_frequency"     # what differentiated encoders add at high frequencies hides no slow motion
{calibrated}
[estimation.prior.link]        # 1 sigma about the URDF, {about}; where
# the rows contradict it, it is taken wider, and heft identify says by how much
{drawn}
[estimation.prior.relative]    # of all parameters of a link that is not known
{json.dumps(wanted.payload_link)} = 1.0

[estimation.prior.absolute]    # 1 sigma about none: how large a payload could be, and what the instruments add
{held}"""


def _torque_sigmas(wanted: NewVehicle, usual: devices.OfTorque) -> dict[str, float]:
    """Of what joints add to their torques, by the names of the columns; of a recorded or free arm by its largest."""
    own: dict[str, float] = {}
    for number, (joint, device) in enumerate(zip(wanted.joints, devices.of_joints(wanted.joints), strict=True), 1):
        each, bias = usual, f"bias_{device}_torque"
        if wanted.recorded:
            each = devices.OfTorque(*(float(f"{part * _largest(wanted, number):.2g}") for part in devices.OF_LARGEST))
        elif usual is devices.FREE:
            more = max(1.0, _largest(wanted, number) / devices.USUAL_N_m)
            each = devices.OfTorque(*(float(f"{more * part:.2g}") for part in usual))
        own |= {f"Ia_{joint}": each.rotor, f"Fv_{joint}": each.friction, f"Fc_{joint}": each.friction}
        own[bias] = each.offset
    return own


def _of_torques(wanted: NewVehicle) -> str:
    own = "".join(f"{json.dumps(name)} = {sigma}\n" for name, sigma in _torque_sigmas(wanted, devices.FREE).items())
    return f"""
[estimation.prior.absolute]    # 1 sigma about none: friction, rotor and offset in each joint's torque
{own}"""


def _taken_over(wanted: NewVehicle, drawn: DrawnUrdf) -> str:
    """The URDF at hand, with the frames that it lacks."""
    needed = {wanted.imu_frame: drawn.root} if wanted.imu != "none" else {}
    needed[wanted.payload_link] = drawn.last
    places = wanted.pucks
    for name, parent in (needed | dict.fromkeys(places, drawn.root)).items():
        if name not in drawn.frames:
            drawn = drawn._replace(text=drawing.with_frame(drawn, name, parent, places.get(name, "0 0 0")))
    return drawn.text


def _urdf(wanted: NewVehicle) -> str:
    parts = [link("base", 10.0, (0.0, 0.0, 0.0), 0.2)]
    if wanted.imu != "none":
        parts.append(mount("imu_base", "base", "0 0 0"))
    parts += [mount(name, "base", place) for name, place in wanted.pucks.items()]
    before = "base"
    for number, name in enumerate(wanted.joints, 1):
        own = f"link_{number}"
        axis = "0 0 1" if number % 2 or wanted.floats_on_a_table else "0 1 0"
        place = "0.15 0 0" if number == 1 else "0.25 0 0"
        parts.append(link(own, 1.0, (0.12, 0.01, 0.0), 0.25))
        parts.append(
            f"""  <joint name="{name}" type="revolute">
    <parent link="{before}"/>
    <child link="{own}"/>
    <origin xyz="{place}" rpy="0 0 0"/>                 <!-- yours: from the axis before it -->
    <axis xyz="{axis}"/>
    <limit lower="-1.5" upper="1.5" effort="{_effort(wanted, number):g}" velocity="1"/>
  </joint>
"""
        )
        before = own
    parts.append(mount("payload", before, "0.25 0 0"))
    return f"""<?xml version="1.0"?>
<!-- Made by heft init: a sketch of a {len(wanted.joints)}-joint arm. SI units; inertia about the centre of mass. Every
     mass, length and inertia is yours to put in; from a CAD program take its URDF and keep the names. -->
<robot name={quoteattr(wanted.name)}>

{"".join(parts)}</robot>
"""


def _largest(wanted: NewVehicle, number: int) -> float:
    """Torque of a joint [N m]: the sketch's, or what the URDF at hand says; 10 where it says nothing."""
    if wanted.drawn is None:
        return _effort(wanted, number)
    return wanted.drawn.efforts.get(wanted.joints[number - 1], 10.0)


def _effort(wanted: NewVehicle, number: int) -> float:
    """Of a joint [N m]: 10, or in gravity twice what holds the sketched arm stretched, with 1.5 kg, in tens."""
    if KINDS[wanted.base].follows:
        return 10.0
    links = len(wanted.joints) - number + 1
    moment_kg_m = sum(0.12 + 0.25 * k for k in range(links)) + 1.5 * 0.25 * links
    return 10.0 * math.ceil(2.0 * 9.81 * moment_kg_m / 10.0)
