"""Which columns are what, by their names: ``fx``, ``Fx [N]``, ``force_x``, ``wrench.force.x``, ``qw``, ``roll_deg``.

A table without names is recognised by its numbers: four columns of length one are a quaternion, nine a rotation matrix,
and the last six the wrench.
"""

import re
from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.ground.calibrate.weigh.errors import PosesError
from onboard.ground.calibrate.weigh.table import LENGTH, WeighTable, by_rows, off
from onboard.ground.calibrate.weigh.units import FORCE_UNITS, MOMENT_UNITS, are_si

ANGLE_UNITS = {"deg": np.pi / 180.0, "degree": np.pi / 180.0, "degrees": np.pi / 180.0, "°": np.pi / 180.0, "rad": 1.0}
_UNITS = FORCE_UNITS | MOMENT_UNITS | ANGLE_UNITS | {"m": 1.0, "mm": 1e-3, "s": 1.0, "ms": 1e-3}
_FULL_TURN = 2.0 * np.pi + 0.1
ONE_G = 0.05  # of gravity: what an accelerometer at rest may be off

# Names, without marks between their parts, in the order in which they are looked for
_WRENCH = (
    r"(?:.*force|.*f)([xyz])$",
    (r".*torque([xyz])$", r".*moment([xyz])$", r".*tau([xyz])$", r"(?:.*[^a-z])?m([xyz])$", r"(?:.*[^a-z])?t([xyz])$"),
)
_ORIENTATION = (
    ("quaternion", r"(?:.*quat(?:ernion)?|.*orientation|.*ori|.*rot(?:ation)?|(?:.*[^a-z])?q)([wxyz])$", "wxyz"),
    ("quaternion?", r"(?:.*quat(?:ernion)?|q)([0-3])$", "0123"),
    ("quaternion?", r"(?:.*quat(?:ernion)?|q)([1-4])$", "1234"),  # ABB
    ("matrix", r"(?:.*rot(?:ation)?(?:matrix|mat)?|r|m|t|h)([0-3][0-3])$", ""),
    ("rotvec", r".*(?:rotvec|rotationvector|axisangle|rotvector)([xyz])$", "xyz"),
    ("angles", r"(?:.*)(roll|pitch|yaw)$", ("roll", "pitch", "yaw")),
    ("angles", r"(?:.*(?:rpy|euler))([xyz])$", "xyz"),
    ("sequence", r"(?:.*[^a-z])?(phi|theta|psi)$", ("phi", "theta", "psi")),
    ("sequence", r"(?:.*[^a-z])?(alpha|beta|gamma)$", ("alpha", "beta", "gamma")),
    ("angles?", r"(?:(?:.*[^a-z])?r|.*rot(?:ation)?)([xyz])$", "xyz"),
    ("ZYX", r"^([abc])$", "cba"),  # KUKA: A about z, B about y, C about x
    ("xyz", r"^([wpr])$", "wpr"),  # Fanuc
    ("quaternion", r"^([wxyz])$", "wxyz"),
    ("up", r"(?:.*acc(?:el(?:eration|erometer)?)?|.*grav(?:ity)?|(?:.*imu)?a|g)([xyz])$", "xyz"),
)
_LISTED = (
    ("(?:forces?|f)", "f"),
    ("(?:torques?|moments?|m|t|tau)", "m"),
    ("(?:rotvec|rotationvector|axisangle)", "rotvec"),
    ("(?:rpy|euler|eulerangles)", "rpy"),
    ("(?:orientation|ori|rot(?:ation)?)", "r"),
)
_COMPENSATED = re.compile(r"(?i)(?<![a-eg-z])ext(?![a-z])|tcp_?force")  # F_ext of Franka, actual_TCP_force of a UR
_NUMBERED = (  # parts of one name, numbered from 0 or 1, as a UR's RTDE writes them
    (
        r"(?:.*\.)?(?:wrench(?:es)?|forces?|ft|f\.ext(?:\.hat)?\.k)(?:\.(?:sensor|raw|data))?",
        ("fx", "fy", "fz", "mx", "my", "mz"),
    ),
    (r"(?:.*\.)?poses?", ("x", "y", "z", "rx", "ry", "rz")),
    (r"(?:.*\.)?poses?", ("x", "y", "z", "quat0", "quat1", "quat2", "quat3")),
    (r".*", tuple(f"t{row}{column}" for row in range(4) for column in range(4))),
    (r".*", tuple(f"rot{row}{column}" for row in range(3) for column in range(3))),
    (r"(?:.*\.)?(?:quat(?:ernion)?|orientation|ori|rot(?:ation)?)s?", ("quat0", "quat1", "quat2", "quat3")),
    *((rf"(?:.*\.)?{what}", (f"{as_}x", f"{as_}y", f"{as_}z")) for what, as_ in _LISTED),
)


class Column(NamedTuple):
    """A name without its unit, and the unit; both without marks, in small letters."""

    name: str
    unit: str


class Meaning(NamedTuple):
    """What the columns of a table are.

    Attributes:
        kind: of the orientation: ``quaternion`` (w, x, y, z), ``quaternion?`` (of unknown order), ``quaternion:xyzw``,
            ``matrix`` (by rows), ``rotvec``, ``angles`` (about x, y, z in an unknown order), ``angles?`` (these or a
            rotation vector), ``sequence`` (one after the other about axes that nobody named),
            ``sequence:ZYZ`` (about these, or each about the axis that it is named for), an order of Euler angles
            (``xyz``, ``ZYX``: SciPy's letters), ``joints``, or ``up`` (what an accelerometer reads, or gravity, in any
            unit).
        orientation: (n, k); angles are in rad.
        wrench: (n, 6) N, N m.
        said: how it was understood, in words.
        unnamed: ``force``, ``moment``, where nobody named a unit.
    """

    kind: str
    orientation: FloatArray
    wrench: FloatArray
    said: tuple[str, ...]
    unnamed: tuple[str, ...] = ()


class Units(NamedTuple):
    """Units that a person gave; empty for none."""

    force: str = ""
    moment: str = ""
    angle: str = ""


def split_name(text: str) -> Column:
    """``Fx [N]`` is ``fx`` in ``n``."""
    text = re.sub(r"(?<=\w)\[(\d+)\]", r"_\1", text)  # `wrench[0]` is no unit
    bracket = re.fullmatch(r"\s*(.*?)\s*[\[(]\s*(.*?)\s*[\])]\s*", text)
    name, unit = (bracket[1], bracket[2]) if bracket else (text, "")
    if not bracket and (tail := re.fullmatch(r"(.+[^a-zA-Z])([a-zA-Z°]+)", text.strip())):
        plain = _plain(tail[2])
        # `force_m`, `q_s`: single letters are units only where they cannot be a part of the name
        if plain in _UNITS and plain not in ("m", "s") and _plain(tail[1]):
            name, unit = tail[1], tail[2]
    return Column(_marked(re.sub(r"(?i)[\s_.-]+(mean|avg|average)$", "", name)), _plain(unit))


def _plain(text: str) -> str:
    return re.sub(r"[^a-z0-9°]", "", re.sub("[µμ]", "u", text.lower()))


def _marked(text: str) -> str:
    """Small letters and digits; a mark between parts that are read apart (``tcp_m_x`` is ``tcp.mx``)."""
    parts = [part for part in re.split(r"[^a-z0-9]+", text.strip().lower()) if part]
    if len(parts) > 1 and len(parts[-1]) <= 2:  # the axis
        parts[-2:] = [parts[-2] + parts[-1]]
    return ".".join(parts)


def understood(table: WeighTable, units: Units, joints: Sequence[str] = (), orientation: str = "") -> Meaning:
    """Find orientation and wrench.

    Args:
        table: read.
        units: that a person gave.
        joints: of the URDF, where angles of joints are in the table.
        orientation: what a person said of it: ``xyzw``, ``wxyz``, ``matrix``, ``rotvec`` or an order of Euler angles.

    Raises:
        PosesError: something is not there, or could be more than one thing.
    """
    if not any(table.names):
        return _unnamed(table, units, joints, orientation)
    columns = _numbered([split_name(name) for name in table.names])
    said: list[str] = []
    force = _vector(table, columns, [_WRENCH[0]], "xyz")
    moment = _vector(table, columns, list(_WRENCH[1]), "xyz", force or ())
    if force is None or moment is None:
        what = "forces (fx, fy, fz)" if force is None else "moments (mx, my, mz or tx, ty, tz)"
        raise PosesError(
            f"{table.label}: no columns of {what} among {_shown(table.names)}; give names by --columns NAME,NAME,..."
        )
    wrench, unnamed = _scaled(table, columns, force, moment, units, said)
    if joints:
        at, kind = _joints(table, columns, joints), "joints"
    else:
        kind, at = _orientation(table, columns, {*force, *moment})
    values = table.values[:, at]
    if kind == "homogeneous":
        kind, values = "matrix", by_rows(values)
    if kind not in ("quaternion", "quaternion?", "matrix", "up"):
        values = values * _angle(values, [columns[k].unit for k in at], units.angle, said)
    said.insert(0, f"orientation from {_shown([table.names[k] for k in at])}")
    return Meaning(_said_kind(table, kind, orientation), values, wrench, tuple(said), unnamed)


def _numbered(columns: list[Column]) -> list[Column]:
    """With ``wrench_0`` to ``wrench_5`` named ``wrench.fx`` to ``wrench.mz``, and so on."""
    parts = [re.fullmatch(r"(.*?[a-z])\.?(\d{1,2})", column.name) for column in columns]
    stems = dict.fromkeys(part[1] for part in parts if part)
    for stem, (pattern, axes) in product(stems, _NUMBERED):
        at = {int(part[2]): k for k, part in enumerate(parts) if part and part[1] == stem}
        first = min(at)
        if re.fullmatch(pattern, stem) and sorted(at) == [*range(first, first + len(axes))]:
            for n, axis in enumerate(axes, first):
                columns[at[n]] = columns[at[n]]._replace(name=f"{stem}.{axis}")
    return columns


def _said_kind(table: WeighTable, kind: str, said: str) -> str:
    """What a person said holds, where the columns can be that."""
    if not said:
        return kind
    quaternions = said in ("xyzw", "wxyz")
    of_matrix = said == "matrix"
    fits = {
        **dict.fromkeys(("quaternion", "quaternion?"), quaternions),
        "matrix": of_matrix,
        "joints": False,
        "up": False,
    }
    if not fits.get(kind, not quaternions and not of_matrix):
        raise PosesError(f"{table.label}: --orientation {said}, but its columns are {kind.rstrip('?')}: leave it out")
    if kind in ("quaternion", "matrix"):
        return kind
    return f"quaternion:{said}" if quaternions else f"sequence:{said}" if kind == "sequence" else said


def _vector(
    table: WeighTable,
    columns: Sequence[Column],
    patterns: Sequence[str],
    axes: str | tuple[str, ...],
    taken: Sequence[int] = (),
) -> list[int] | None:
    """Columns that a pattern finds for every axis.

    Raises:
        PosesError: more than one for an axis.
    """
    for pattern in patterns:
        found: dict[str, list[int]] = {}
        for k, column in enumerate(columns):
            if k not in taken and (match := re.fullmatch(pattern, column.name)):
                found.setdefault(match[1], []).append(k)
        if set(found) >= set(axes):
            if doubled := [k for axis in axes for k in found[axis] if len(found[axis]) > 1]:
                raise PosesError(
                    f"{table.label}: {_shown([table.names[k] for k in doubled])} could be the same thing; name the "
                    "columns by --columns, - for those that are not meant"
                )
            return [found[axis][0] for axis in axes]
    return None


def _orientation(table: WeighTable, columns: Sequence[Column], taken: set[int]) -> tuple[str, list[int]]:
    for kind, pattern, axes in _ORIENTATION:
        if kind == "matrix":
            sixteen = tuple(f"{row}{column}" for row in range(4) for column in range(4))
            at = _vector(table, columns, [r"(?:.*\.)?t([0-3][0-3])"], sixteen, tuple(taken))
            if at is not None and len(by_rows(table.values[:, at])):
                return "homogeneous", at
            for first in "10":
                wanted = tuple(f"{int(first) + i}{int(first) + j}" for i in range(3) for j in range(3))
                if (at := _vector(table, columns, [pattern], wanted, tuple(taken))) is not None:
                    return kind, at
        elif (at := _vector(table, columns, [pattern], axes, tuple(taken))) is not None and (
            (kind != "quaternion?" or _of_unit_length(table.values[:, at]))  # else joints
            and (kind != "up" or _of_one_length(table.values[:, at]))  # else rates
        ):
            return kind, at
    raise PosesError(
        f"{table.label}: no orientation among {_shown(table.names)}: quaternion (qw, qx, qy, qz), matrix (r11 .. r33), "
        "rotation vector (rotvec_x ..), Euler angles (roll, pitch, yaw; phi, theta, psi), or joints with --urdf; "
        "give names by --columns"
    )


def _of_unit_length(four: FloatArray) -> bool:
    return bool(np.nanmedian(np.abs(np.linalg.norm(four, axis=1) - 1.0)) < LENGTH)


def _of_one_length(three: FloatArray) -> bool:
    """Whether most of vectors (n, 3) are as long as one is at rest that shows where up is."""
    length = np.linalg.norm(three, axis=1)
    return bool(np.nanmedian(np.abs(length / np.nanmedian(length) - 1.0)) < ONE_G)


def _joints(table: WeighTable, columns: Sequence[Column], joints: Sequence[str]) -> list[int]:
    """Columns of joints, by the URDF's names, or numbered: ``q1``, ``joint_1``, ``j1``."""
    by_name = {_plain(name): k for k, name in enumerate(table.names)} | {
        column.name.replace(".", ""): k for k, column in enumerate(columns)
    }
    for first in (None, 1, 0):
        names = [_plain(joint) for joint in joints]
        for word in ("q", "joint", "j", "a", "axis", "angle", "theta", "position", "jointposition", "actualq"):
            if first is not None:
                names = [f"{word}{first + n}" for n in range(len(joints))]
            if all(name in by_name for name in names):
                return [by_name[name] for name in names]
    missing = [joint for joint in joints if _plain(joint) not in by_name]
    raise PosesError(
        f"{table.label}: no columns for the joints {_shown(missing)} among {_shown(table.names)}; name them so"
    )


def _scaled(
    table: WeighTable,
    columns: Sequence[Column],
    force: Sequence[int],
    moment: Sequence[int],
    units: Units,
    said: list[str],
) -> tuple[FloatArray, tuple[str, ...]]:
    """The wrench in N and N m, and of what nobody named the unit."""
    factors = []
    unnamed: list[str] = []
    for at, table_of, given, usual, what in (
        (force, FORCE_UNITS, units.force, "n", "force"),
        (moment, MOMENT_UNITS, units.moment, "nm", "moment"),
    ):
        names = {columns[k].unit for k in at}
        if number := re.fullmatch(r"\s*\d*\.?\d+(?:e[-+]?\d+)?\s*", given, re.IGNORECASE):  # N or N m in one
            factors.append(float(number[0]))
            continue
        unit = _plain(given) or (names.pop() if len(names) == 1 else "?")
        if not unit and not all(are_si(table.names[k]) for k in at):
            unnamed.append(what)
        if unit == "mn" and what == "moment":
            unit = "mnm"
        if (unit or usual) not in table_of:
            raise PosesError(
                f"{table.label}: the unit {given or unit!r} of {_shown([table.names[k] for k in at])} is not known; "
                f"give --{what}-unit, any of {', '.join(table_of)}, or its size in {usual}, 1e-6 for instance"
            )
        factors.append(table_of[unit or usual])
    six = table.values[:, [*force, *moment]]
    if unnamed and not units.force and (np.isnan(six) | (six == np.rint(six))).all():
        raise PosesError(
            f"{table.label}: forces and moments are whole numbers without a unit, as counts are: say its size in N and "
            "N m with --force-unit and --moment-unit, 1e-6 for instance (or N, Nm)"
        )
    if any(_COMPENSATED.search(table.names[k]) for k in force if table.names):
        said.append("such forces are without the payload set in the controller: set it to 0, or add it to this")
    wrench = np.hstack([table.values[:, list(force)] * factors[0], table.values[:, list(moment)] * factors[1]])
    return wrench, tuple(unnamed)


def _angle(values: FloatArray, names: Sequence[str], given: str, said: list[str]) -> float:
    """Radians in the unit of the angles."""
    unit = _plain(given) or next((name for name in names if name in ANGLE_UNITS), "")
    if unit:
        if unit not in ANGLE_UNITS:
            raise PosesError(f"the unit {given!r} of angles is not known: --angle-unit deg or rad")
        return ANGLE_UNITS[unit]
    degrees = bool(np.nanmax(np.abs(values)) > _FULL_TURN)
    said.append(f"angles go to {np.nanmax(np.abs(values)):.3g}: taken as {'degrees' if degrees else 'radians'}")
    return ANGLE_UNITS["deg"] if degrees else 1.0


def _unnamed(table: WeighTable, units: Units, joints: Sequence[str], orientation: str) -> Meaning:
    """By the numbers.

    Raises:
        PosesError: they show no orientation, or not six columns after it.
    """
    values = table.values
    width = values.shape[1]
    kinds = []
    blocks = [
        (first, size)
        for size in (16, 12)
        for first in range(width - size - 5)
        if len(by_rows(values[:, first : first + size]))
    ]
    for first in range(0 if blocks else width - 9):
        if _of_unit_length(values[:, first : first + 4]):
            kinds.append(("quaternion?", first, 4))
        if first + 15 <= width and np.nanmedian(off(values[:, first : first + 9].reshape(-1, 3, 3))) < 1e-2:
            kinds.append(("matrix", first, 9))
    if orientation and orientation not in ("xyzw", "wxyz", "matrix"):  # three angles before the wrench, as is said
        kinds = [("angles", width - 9, 3)]
    elif joints:
        kinds = [("joints", 0, len(joints))]
    elif blocks:
        kinds = [("matrix", *blocks[0])]
    if len(kinds) != 1 or kinds[0][1] < 0 or width - kinds[0][1] - kinds[0][2] != 6:
        raise PosesError(f"{table.label} has {width} columns without names: {_remedy(width, bool(kinds))}")
    kind, first, count = kinds[0]
    said: list[str] = [f"columns without names: {kind.rstrip('?')} in {first + 1} to {first + count}, then the wrench"]
    names = [Column("", "")] * width
    last = range(first + count, width)
    wrench, unnamed = _scaled(table, names, last[:3], last[3:], units, said)
    found = values[:, first : first + count]
    if blocks and kind == "matrix":
        found = by_rows(found)
    if kind in ("angles", "joints"):
        found = found * _angle(found, [], units.angle, said)
    return Meaning(_said_kind(table, kind, orientation), found, wrench, tuple(said), unnamed)


def _remedy(width: int, quaternion: bool) -> str:
    """How to name the columns of a table, with its own number of them."""
    if width < 9:
        return "an orientation and a wrench have nine or more; put them side by side: heft weigh POSES WRENCHES"
    before = ["qx", "qy", "qz", "qw"] if quaternion and width > 9 else ["roll", "pitch", "yaw"]
    given = [*"-" * (width - 6 - len(before)), *before, "fx", "fy", "fz", "mx", "my", "mz"]
    by_angles = "" if quaternion else "; or, where three angles stand before the wrench, --orientation xyz (or ZYX ...)"
    return f"give names by --columns, e.g. --columns={','.join(given)}{by_angles}"


def _shown(names: Sequence[str]) -> str:
    some = ", ".join(name[:40] or "(no name)" for name in names[:20])
    return some + (f" and {len(names) - 20} more" if len(names) > 20 else "")
