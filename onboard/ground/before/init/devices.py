"""Device tables of a new vehicle file, by kind, with comments that say where each number is from.

Values are those of data sheets, or of a small arm where only the builder knows: each of these says so.
"""

import itertools
import json
import re
from collections.abc import Sequence
from typing import NamedTuple

from onboard.devices.base import BusDevice, JointDevice, LoadCellDevice
from onboard.devices.buses import ComponentDevice
from onboard.devices.driven import DrivenDevice, MotorDevice
from onboard.devices.registry import DEVICES

RECORDED = "recorded"  # by somebody else: an import brings it in
CAN, GPIO = "can_0", "sync_line"
COMPONENTS = ("fx", "fy", "fz", "mx", "my", "mz")  # of a wrist sensor, each a device
_NAME = re.compile(r"[A-Za-z]\w{0,23}", re.ASCII)  # room for what a channel adds to it
_OTHERS = re.compile(rf"imu_base|imu_\d+|load_cell|can_sync|pulse|recording|phase|{'|'.join(COMPONENTS)}")  # no joint's
URLS = {CAN: "can+socketcan://can0?bitrate=500000", GPIO: "gpio:///dev/gpiochip0?line=17"}


class NewDevice(NamedTuple):
    """A table, the bus that it stands on ("" of one that is read from a recording), and that bus's usual URL."""

    text: str
    bus: str
    url: str = ""


def kinds(role: type) -> tuple[str, ...]:
    """Kinds of a role that can be made: those that say what their table has."""
    made = [k for k, model in DEVICES.items() if issubclass(model, role) and issubclass(model, BusDevice)]
    return tuple(kind for kind in made if _model(kind).new_keys)


def with_torque() -> tuple[str, ...]:
    """Kinds of joints' devices that know the motor's torque."""
    return tuple(kind for kind in kinds(JointDevice) if issubclass(_model(kind), MotorDevice))


def drives() -> tuple[str, ...]:
    """Kinds of joints' devices that can move their joint."""
    return tuple(kind for kind in kinds(JointDevice) if issubclass(_model(kind), DrivenDevice))


def keys_of_drive(kind: str) -> str:
    """Keys of its own in ``[drive]``."""
    return str(getattr(_model(kind), "new_drive", ""))


def smoothing_ms(kind: str, *, floats: bool) -> int:
    """Of joints that a kind measures: of their rows, or where the motion of a floating base is predicted from them."""
    model = DEVICES.get(kind, JointDevice)
    model = model if issubclass(model, JointDevice) else JointDevice
    return (floats and model.new_floating_smoothing_ms) or model.new_smoothing_ms


def _model(kind: str) -> type[BusDevice]:
    model = DEVICES[kind]
    assert issubclass(model, BusDevice)
    return model


def _table(device: str, kind: str, number: int, common: str) -> NewDevice:
    """The table of a device of a bus; ``common``: keys that its role has, before its own."""
    model = _model(kind)
    bus = model.new_bus.format(number=number) or f"tty_{device}"
    url = model.new_url or URLS.get(bus, f"serial:///dev/{bus}?baud={model.new_baud}")
    if bus.startswith("i2c_"):
        url = f"i2c:///dev/{bus.replace('_', '-')}"
    if bus.startswith("spi_"):
        url = f"spi:///dev/spidev0.{number - 1}"
    keys = model.new_keys.format(number=number)
    return NewDevice(f'\n[device.{device}]\nkind = "{kind}"\nbus = "{bus}"\n{common}{keys}', bus, url)


_LEFT_OF_AXES = """accel_scale_sigma = 0.003      # what calibration leaves: yours. An MPU-6050 as it comes: 0.015
gyro_scale_sigma = 0.003
misalignment_sigma_rad = 5e-3  # of its axes and its board; as it comes, on standoffs: 0.011
"""


def imu(kind: str, frame: str, number: int = 1, *, by_rows: bool = False) -> NewDevice:
    """The IMU that measures the base, or, recorded, a further one on it, counted from 2.

    ``by_rows``: what it reads is taken as it is, so the file states what errors it may have.
    """
    if kind != RECORDED:
        common = f"frame = {json.dumps(frame)}           # link of the URDF whose axes are the chip's\n"
        return _table("imu_base", kind, 1, common + _LEFT_OF_AXES * by_rows)
    return NewDevice(
        f"""
[device.{"imu_base" if number == 1 else f"imu_{number}"}]
kind = "recorded_imu"
frame = {json.dumps(frame)}           # link of the URDF whose axes are the sensor's
period_ms = 5                  # yours
accel_noise_m_s2 = 0.05        # of a sample: yours
gyro_noise_rad_s = 2e-3
""",
        "",
    )


def of_joints(joints: Sequence[str]) -> list[str]:
    """Names of the devices that measure the joints: the joint's where that can name a channel, and of no other."""
    own = [one if _NAME.fullmatch(one) and not _OTHERS.fullmatch(one) else "" for one in joints]
    own = ["" if name.removesuffix("_torque") in {*own} - {name} else name for name in own]
    free = (name for name in map("joint_{}".format, itertools.count(1)) if name not in own)
    numbered = [next(free) for _ in joints]
    return [name or numbered[place] for place, name in enumerate(own)]


def joint(
    kind: str,
    number: int,
    device: str,
    name: str,
    largest_N_m: float | None = None,
    *,
    smoothed: bool = True,
    gain_N_m_A: float | None = None,
    driven: bool = False,
    slides: bool = False,
) -> NewDevice:
    """The ``device`` that measures joint ``name``, the ``number``-th from 1.

    ``largest_N_m``: a drive's torque is used too, and this is the joint's largest; ``smoothed``: as rows are;
    ``gain_N_m_A``: what was recorded is the motor's current; ``driven``: it moves the joint, too; ``slides``: along its
    axis, and does not turn about it.
    """
    about = _SLIDES if slides else ""
    if kind == RECORDED:
        return NewDevice(_recorded_joint(device, name, largest_N_m, gain_N_m_A, about), "")
    moves = getattr(_model(kind), "new_driven", "") if driven else ""
    made = _table(device, kind, number, f"joint = {json.dumps(name)}             # of the URDF{about}\n{moves}")
    if largest_N_m is None:
        return made
    keys = _torque(largest_N_m, _OF_LARGEST if smoothed else _OF_A_TICK, getattr(_model(kind), "new_torque", ""))
    return made._replace(text=made.text + keys)


_SLIDES = "; it slides: rad are m here, N m are N, and a revolution is 6.2832 m"


def _recorded_joint(device: str, name: str, largest_N_m: float | None, gain_N_m_A: float | None, about: str) -> str:
    angle = f"""
[device.{device}]
kind = "recorded_angle"
joint = {json.dumps(name)}             # of the URDF{about}
period_ms = 5                  # yours
noise_rad = 1e-5               # of a sample: yours
"""
    if largest_N_m is None:
        return angle
    sigma = f"sigma_N_m = {_OF_RECORDED * largest_N_m:.2g}"
    by_current = "" if gain_N_m_A is None else f"gain_N_m_A = {gain_N_m_A:g}\n"
    return f"""{angle}zero_sigma_rad = 5e-3          # of its zero against the URDF's: yours; 0.3 deg, as by a mark

[device.{device}_torque]
kind = "recorded_torque"       # N m; of a motor's current in A say gain_N_m_A too
joint = {json.dumps(name)}
{by_current}period_ms = 5                  # yours
{sigma:31s}# yours: what the model leaves; here 0.3 % of the joint's largest
scale_sigma = 0.05             # yours: of a torque constant; motors' data sheets give it to 10 %, here 2 sigma
still_rad_s = 0.02             # below this rate friction is not known
"""


_OF_RECORDED = 3e-3  # of a recorded arm, whose friction is known to that at best
_OF_LARGEST = 1e-3  # of a torque by current: its noise of 0.2 % and steps of 0.1 % behind 100 ms of smoothing
_OF_A_TICK = 2e-3  # the same of a mean over a tick, which has two samples or more: as a free base takes it


def _torque(largest_N_m: float, share: float, own: str) -> str:
    """Keys of a drive's torque, ``own`` among them; the sigma is by the joint's largest: it measures its current."""
    sigma = f"torque_sigma_N_m = {share * largest_N_m:.2g}"
    return f"""torque = true                  # recorded, by the motor's current
{sigma:31s}# yours: {share:.1%} of the joint's largest; more where friction and gear leave more
{own}torque_still_rad_s = 0.02      # below this rate friction is not known
"""


class OfTorque(NamedTuple):
    """1 sigma of what a joint's torque has in it besides the bodies'."""

    rotor: float  # kg m^2
    friction: float  # N m, Coulomb's; viscous at 1 rad/s
    offset: float  # N m


IN_GRAVITY, FREE = OfTorque(1.0, 5.0, 1.0), OfTorque(0.1, 0.5, 0.1)  # arms of USUAL_N_m or some more
USUAL_N_m = 10.0  # a stronger joint has a larger motor and gear: what a free arm's adds is in proportion
OF_LARGEST = OfTorque(0.02, 0.1, 0.03)  # over a joint's largest torque: gears of 100 and more lose as much


def load_cell(kind: str, node: int, frame: str) -> NewDevice:
    """A load cell that feels the moment about z of ``frame``, or component ``node`` of a wrist sensor in its axes."""
    if kind == RECORDED:
        text = f'\n[device.load_cell]\nkind = "recorded_load_cell"\nperiod_ms = 5\n{_felt(frame)}'
        return NewDevice(text + LoadCellDevice.new_delay, "")
    if issubclass(_model(kind), ComponentDevice):
        return _component(kind, node, frame)
    made = _table("load_cell", kind, node, "")
    delay = getattr(_model(kind), "new_delay", "")
    return made._replace(text=made.text + _felt(frame) + delay)


def cells(kind: str) -> tuple[str, ...]:
    """Names of the devices that are a load cell: a wrist sensor is six."""
    wrist = kind in DEVICES and issubclass(_model(kind), ComponentDevice)
    return COMPONENTS if wrist else ("load_cell",) if kind != "none" else ()


def load_cells(kind: str, node: int, frame: str) -> list[NewDevice]:
    """All of them."""
    names = cells(kind)
    numbers = range(1, len(names) + 1) if len(names) > 1 else [node] * len(names)
    return [load_cell(kind, number, frame) for number in numbers]


def _component(kind: str, number: int, frame: str) -> NewDevice:
    made = _table(COMPONENTS[number - 1], kind, number, f"component = {number}\n")
    axis = [float(place == (number - 1) % 3) for place in range(3)]
    measures, unit, capacity, noise = ("force", "N", 50.0, 0.1) if number < 4 else ("moment", "N m", 10.0, 0.005)
    keys = f"""frame = {json.dumps(frame)}            # yours: whose axes are the sensor's; it feels what lies beyond
axis = {axis}
measures = "{measures}"
capacity_N = {capacity:<18}# {unit}: range of its data sheet, yours
scale_sigma = 0.01             # behind a known weight
noise_N = {noise:<21}# {unit}, of a sample at rest: yours
"""
    return made._replace(text=made.text + keys + LoadCellDevice.new_delay)


def _felt(frame: str) -> str:
    return f"""frame = {json.dumps(frame)}            # the moment is about `axis` of it, of all that lies beyond it
axis = [0.0, 0.0, 1.0]
measures = "moment"            # or "force": along `axis`
lever_m = 0.04                 # yours
lever_sigma_m = 1e-4
capacity_N = 50.0              # yours: larger samples are saturated
scale_sigma = 0.0025           # relative, of its calibration
noise_N = 0.0025               # of a sample
"""


def mapping(name: str, devices: Sequence[NewDevice]) -> str:
    """How a recording's columns become these devices' channels, for ``heft import``; column names are the user's."""
    text = f"""# Which column of a recording is what: put your column names in. Every key: docs/import.md.
# heft import import.toml RECORDING.csv -o logs; heft identify --vehicle vehicle.toml logs/RECORDING.mcap

[mapping]
name = {json.dumps(name)}
format = "csv"                 # or "npz"

[time]
column = "t"                   # yours
unit = "s"
"""
    for one in "".join(d.text for d in devices).split("\n[device.")[1:]:
        device, kind = one.partition("]")[0], one.split('"')[1]
        by_current = "\ngain_N_m_A" in one
        text += _CHANNELS[kind].format(name=device).replace("N m", "A" if by_current else "N m")
    return text


_VALUE = """
[channel.{name}]
record = "scalar"

[channel.{name}.value]
column = "{name}"
values = "physical"
scale = %s
unit = "%s"
"""
_CHANNELS = {
    "recorded_angle": _VALUE % ("1e-8", "rad"),
    "recorded_rate": _VALUE % ("1e-3", "rad/s"),
    "recorded_value": _VALUE % ("1", "1"),
    "recorded_torque": _VALUE % ("1e-6", "N m"),
    "recorded_load_cell": _VALUE % ("1e-6", "N"),
    "recorded_imu": """
[channel.{name}]
record = "imu"

[channel.{name}.accel]
columns = ["ax", "ay", "az"]   # as the axes of its frame
values = "physical"
scale = 1e-3
unit = "m/s^2"

[channel.{name}.gyro]
columns = ["gx", "gy", "gz"]
values = "physical"
scale = 1e-4
unit = "rad/s"
""",
}


IN_TURN = """
# The arm without its load and with it: heft merge --in-turn recording EMPTY.mcap LOADED.mcap -o both.mcap. heft
# identify takes the load for held from the second recording on. To say otherwise:
# [device.recording]
# kind = "recorded_value"
# period_ms = 100
# [estimation.phases]
# channel = "recording"        # 1 in the first recording, 2 in the second
# identify = [1, 2]
# payload_taken = 2
"""

SYNC = NewDevice(
    f"""
[device.can_sync]
kind = "canopen_sync"          # all nodes of the bus sample on it
bus = "{CAN}"
period_ms = 5
delay_ms = 0.110               # a frame of 1 byte at 500 kbit/s
""",
    CAN,
    URLS[CAN],
)
PULSE = NewDevice(
    f"""
[device.pulse]
kind = "sync_pulse"            # a common time for all devices; docs/sync_pulse.md
bus = "{GPIO}"
sync_period_ms = 5             # pulse intervals are whole numbers of these
""",
    GPIO,
    URLS[GPIO],
)
