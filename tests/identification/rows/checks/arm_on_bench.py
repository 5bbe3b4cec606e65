"""An arm on a bench, by MuJoCo, and what may be wrong with what is read of it."""

from functools import cache

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from hil_sim.plants.body import Solid
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.identification.rows.checks.suspected import of_no_key
from onboard.identification.rows.checks.suspects import RowSuspects
from onboard.identification.rows.identifier import Identifier
from onboard.identification.rows.stated_errors.considered import Considered
from onboard.identification.standing import standing
from onboard.regressor.base_parameters import base_parameters
from onboard.regressor.prior import prior_root
from onboard.regressor.rows import BaseMotion, RowModel, joint_torque_row
from tests.identification.rows import test_grasped as bench

TOOL = Solid.box(1.4, (0.22, 0.05, 0.03), (0.02, 0.06, 0.01))
HEAVY = Solid.box(5.0, (0.22, 0.08, 0.05), (0.02, 0.06, 0.01))
AXES = [f"wrist_{kind}_{axis}" for kind in ("force", "moment") for axis in "xyz"]
ZEROS = tuple(Considered(f"zero of joint_{k}", f"joint_{k}", "joint_zero", 1e-4) for k in range(1, 6))

ONCE_A_TURN = tuple(  # cosine and sine, 10 mrad rms each
    Considered(f"cyclic error of joint_{k}", f"joint_{k}", "joint_cyclic", 0.01, axis=2 * (k - 1) + part)
    for k in range(1, 6)
    for part in (0, 1)
)
SCALES = tuple(Considered(f"scale of {axis}", axis, "scale", 2.5e-3) for axis in AXES)


def model_of(urdf):
    return RowModel(VehicleModel(urdf, VehicleSpec(BaseKind.FIXED, "bench", "tool")), bench.six_axes("wrist"))


@cache
def base_of(urdf):
    return base_parameters(model_of(urdf), np.random.default_rng(0))


def identifier(urdf=bench.URDF, more=(), silent=True, scales=SCALES):
    """By six axes; ``more`` errors; ``silent``: those too of which no key says anything, as on board."""
    model = model_of(urdf)
    vehicle = model.vehicle
    links = dict.fromkeys(vehicle.links, 1.0) | {"gripper": 0.01}
    extras = {"M_tool": 5.0} | {f"{h}_tool": 1.0 for h in ("MX", "MY", "MZ")}
    extras |= {f"{i}_tool": 0.2 for i in ("XX", "XY", "YY", "XZ", "YZ", "ZZ")}
    extras |= {name: 5.0 if "force" in name else 0.5 for name in model.names if name.startswith("bias")}
    base, root = base_of(urdf), prior_root(model, links, extras)
    errors = (*ZEROS, *scales, *more)
    errors += tuple(of_no_key(errors, model)) if silent else ()
    weighs, stated = RowSuspects(model, base, root, errors), bench.stated_of(model)
    return Identifier(model, base, root, 5 * bench.WIDTH_S, considered=errors, stated=stated, suspects=weighs)


def driven(vehicle):
    """By the torques of five motors with rotors and friction, each torque's scale stated to 1 %."""
    model = RowModel(vehicle, [joint_torque_row(vehicle, joint.name) for joint in vehicle.joints])
    links = dict.fromkeys(vehicle.links, 1.0) | {"gripper": 0.01}
    extras = {"M_tool": 5.0} | {f"{h}_tool": 1.0 for h in ("MX", "MY", "MZ")}
    extras |= {f"{i}_tool": 0.2 for i in ("XX", "XY", "YY", "XZ", "YZ", "ZZ")}
    extras |= {name: 1.0 for name in model.names if name[:3] in ("Ia_", "Fv_", "Fc_")}
    base, root = base_parameters(model, np.random.default_rng(0)), prior_root(model, links, extras)
    errors = [*ZEROS, *(Considered(f"scale of {row.name}", row.name, "scale", 0.01) for row in model.rows)]
    errors += of_no_key(errors, model)
    weighs = RowSuspects(model, base, root, errors)
    return Identifier(model, base, root, 5 * bench.WIDTH_S, considered=errors, suspects=weighs)


@cache
def run(heavy=False):
    given = bench.signals(20, identifier().model.vehicle, HEAVY if heavy else TOOL)
    return given._replace(measured_rate=np.gradient(given.measured, given.time_s, axis=0))


def read(row, factor, since_s=0.0):
    """One axis of the cell wrong by a factor, bias and all."""

    def wrong(given):
        measured = given.measured.copy()
        measured[given.time_s >= since_s, AXES.index(row)] *= factor
        return given._replace(measured=measured)

    return wrong


def zero(*off_rad):
    return lambda given: given._replace(q=given.q + np.array(off_rad))


def geared(joint, factor):
    scale = np.where(np.arange(1, 6) == joint, factor, 1.0)
    return lambda given: given._replace(q=given.q * scale, dq=given.dq * scale, ddq=given.ddq * scale)


def once_a_turn(given, off_rad=0.0, phase=0.0):
    """Encoders of magnets that are beside their axes, by ``off_rad`` times the sine of the angle and a phase."""
    angle = given.q
    turned = angle[:, None] + 0.5 * np.pi * np.array([0.0, -1.0])[:, None]  # a cosine, and a sine
    of = np.cos(turned), -np.sin(turned), -np.cos(turned)  # (n, 2, joints) each, by the angle
    dq, ddq = given.dq[:, None], given.ddq[:, None]
    three = np.stack([of[0], of[1] * dq, of[1] * ddq + of[2] * dq**2], axis=1)  # (n, 3, 2, joints)
    more = off_rad * (np.sin(phase) * three[:, :, 0] + np.cos(phase) * three[:, :, 1])
    read = given._replace(q=given.q + more[:, 0], dq=given.dq + more[:, 1], ddq=given.ddq + more[:, 2])
    return read._replace(cyclic=three.swapaxes(2, 3).reshape(*three.shape[:2], -1))


def late(joint, by_s):
    def wrong(given):
        parts = [np.array(part) for part in (given.q, given.dq, given.ddq)]
        for part in parts:
            part[:, joint - 1] = CubicSpline(given.time_s, part[:, joint - 1])(given.time_s - by_s)
        return given._replace(**dict(zip(("q", "dq", "ddq"), parts, strict=True)))

    return wrong


def stuck(joint, since_s, for_s):
    """An encoder that says the same for a while."""

    def wrong(given):
        during = (given.time_s >= since_s) & (given.time_s < since_s + for_s)
        q, dq, ddq = (np.array(part) for part in (given.q, given.dq, given.ddq))
        q[during, joint - 1] = q[during.argmax(), joint - 1]
        dq[during, joint - 1] = ddq[during, joint - 1] = 0.0
        return given._replace(q=q, dq=dq, ddq=ddq)

    return wrong


def mounted(by_rad):
    """All cells turned in their mount."""

    def wrong(given):
        R = Rotation.from_rotvec(by_rad).as_matrix()
        return given._replace(measured=np.hstack([given.measured[:, :3] @ R, given.measured[:, 3:] @ R]))

    return wrong


def tilted(by_rad):
    """The bench not level: gravity of another direction than its file says."""
    R = Rotation.from_rotvec(by_rad).as_matrix()
    return lambda given: given._replace(motion=BaseMotion(*given.motion[:2], given.motion[2] @ R))


def fed(wrong=None, heavy=False):
    who, given = identifier(), run(heavy)
    bench.feed(who, wrong(given) if wrong else given)
    return who


def part(signals, which):
    """Some ticks of signals."""
    noise = signals.noise._replace(**{name: getattr(signals.noise, name)[which] for name in signals.noise._fields[:6]})
    arrays = ("time_s", "q", "dq", "ddq", "measured", "sigma", "measured_rate")
    some = {name: getattr(signals, name)[which] for name in arrays}
    return signals._replace(**some, motion=BaseMotion(*(one[which] for one in signals.motion)), noise=noise)


def mass(who, true_kg=TOOL.mass_kg):
    """Error of the tool's mass in sigmas, and its sigma over the mass."""
    one = who.estimate().quantities[0]
    assert one.supported
    return (one.value - true_kg) / one.sigma, one.sigma / true_kg


def level(who):
    return standing(who.estimate().quantities[0], who.findings()).level
