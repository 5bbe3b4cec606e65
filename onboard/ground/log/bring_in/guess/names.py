"""What a column is by its name: ``actual_q_0`` is the first joint's angle, ``gyro_x [deg/s]`` a rate about x."""

import re
from collections.abc import Iterable
from itertools import pairwise
from typing import NamedTuple

_UNITS = {
    **dict.fromkeys(("m/s^2", "m/s2", "m/s²", "m_s2", "ms2", "mps2", "m/s/s", "ms-2"), "m/s^2"),
    **dict.fromkeys(("g",), "g"),
    **dict.fromkeys(("mg",), "mg"),
    **dict.fromkeys(("rad/s", "rad_s", "rads", "radps", "rad/sec", "rps"), "rad/s"),
    **dict.fromkeys(("deg/s", "deg_s", "degs", "dps", "degps", "°/s", "deg/sec"), "deg/s"),
    **dict.fromkeys(("rev/min", "rpm", "1/min"), "rev/min"),
    **dict.fromkeys(("rad", "radian", "radians"), "rad"),
    **dict.fromkeys(("deg", "degree", "degrees", "°"), "deg"),
    **dict.fromkeys(("m", "meter", "metre", "meters"), "m"),
    **dict.fromkeys(("mm", "millimeter"), "mm"),
    **dict.fromkeys(("m/s", "m_s", "mps"), "m/s"),
    **dict.fromkeys(("mm/s", "mm_s"), "mm/s"),
    **dict.fromkeys(("n", "newton"), "N"),
    **dict.fromkeys(("nm", "n m", "n.m", "n*m", "n·m", "n_m", "n-m"), "N m"),
    **dict.fromkeys(("nmm", "n mm", "n.mm", "n_mm"), "N mm"),
    **dict.fromkeys(("a", "amp", "amps", "ampere"), "A"),
    **dict.fromkeys(("ma",), "mA"),
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("ms", "msec", "millis", "milliseconds"), "ms"),
    **dict.fromkeys(("us", "usec", "µs", "micros", "microseconds"), "us"),
    **dict.fromkeys(("ns", "nsec", "nanos", "nanoseconds"), "ns"),
}
# single letters after a mark are parts of names, but for these words before them
_AFTER = {
    "s": r"(?i)(time|t|timestamp|stamp|elapsed|clock)$",
    "g": r"(?i)(acc[a-z_]*_?[xyz]|(^|[_\W])a_?[xyz])$",
    "n": r"(?i)(force|f)_?[xyz]?$",
    "m": r"(?i)((pos|position|p)_?[xyz]|(^|[_\W])[xyz])$",
    "a": r"(?i)(current|cur|curr|(^|[_\W])i)_?\d*$",
    "°": r".*",
}
_TIME = {
    *("time", "timestamp", "stamp", "t", "ts", "sec", "secs", "second", "seconds", "elapsed", "clock", "times"),
    *("timestamps", "rosbagtimestamp", "timestep", "utc", "millis", "micros", "date", "datetime", "ms", "us", "ns"),
}
_COMMANDED = {
    *("target", "desired", "des", "cmd", "command", "commanded", "ref", "reference", "setpoint", "goal", "d", "c"),
    *("ext", "hat", "model", "estimated", "external", "expected", "gravity", "error", "err", "residual", "window"),
    *("aspos", "espos"),  # KUKA's RSI
    *("max", "min", "limit", "limits", "covariance", "filtered", "dtau", "std", "var", "variance", "bias", "relative"),
}
_WORDS = {  # by kind, those of which one says it
    "gyro": {"gyro", "gyr", "gyros", "gyroscope", "angvel", "omega", "w", "wb", "turnrate"},
    "accel": {"acc", "accel", "accelerometer", "accels", "acceleration", "a", "linacc", "ab"},
    "quaternion": {"quat", "quaternion", "orientation", "ori", "rot", "rotation", "attitude", "q", "ee", "pose"},
    "position": {"pos", "position", "p", "translation", "location", "xyz"},
    "force": {"force", "forces", "f", "frc", "ft", "wrench"},
    "moment": {"torque", "torques", "moment", "moments", "t", "m", "mu", "tau", "trq", "ft", "wrench"},
    "current": {"current", "currents", "cur", "curr", "i", "amp", "amps", "motorcurrent", "macur"},
    "torque": {"tau", "torque", "torques", "effort", "efforts", "eff", "trq", "moment", "moments", "tq", "tauj"},
    "rate": {"qd", "dq", "qdot", "vel", "velocity", "velocities", "speed", "rate", "dtheta", "omega", "qp", "w"},
    "acceleration": {"qdd", "ddq", "qddot", "acc", "acceleration", "accelerations"},
    "angle": {
        *("q", "angle", "angles", "theta", "pos", "position", "positions", "joint", "joints", "j", "ang", "enc"),
        *("encoder", "jpos", "axis", "a", "jnt", "qpos", "th"),
    },
    "other": {
        *("temp", "temperature", "temperatures", "voltage", "volt", "mode", "status", "flag", "flags", "error"),
        *("mag", "magnetometer", "magnetic", "baro", "pressure", "altitude", "input", "output", "digital", "bits"),
        *("scaling", "speed_scaling", "counter", "seq", "index", "execution", "safety", "covariance"),
    },
}

_TURNING = {"angularvelocity", "angularrate", "angularrates", "rotationrate"}
_MOVING = {"linearacceleration", "specificforce"}
_OF_AN_IMU = {"imu", "gyro", "gyr", "accel", "accelerometer", "gyroscope", "acc"} | _TURNING | _MOVING

# of columns with a number each, or an axis, and no word that is known, in another language say
_BY_UNIT = {"rad": "angle", "deg": "angle", "rad/s": "rate", "deg/s": "rate", "N m": "torque", "N mm": "torque"}
_BY_UNIT_OF_AXES = {
    **dict.fromkeys(("m/s^2", "g", "mg"), "accel"),
    **dict.fromkeys(("rad/s", "deg/s"), "gyro"),
    **{"N": "force", "N m": "moment", "N mm": "moment"},
}

MEASURED = ("actual", "measured", "meas", "state", "states", "act", "msr")
_OF_QUANTITIES = frozenset().union(*_WORDS.values(), _COMMANDED, MEASURED)


class Name(NamedTuple):
    """A name's parts.

    Attributes:
        stem: words, without unit, number and axis; the topic first.
        label: a number, or x, y, z, w; "" of neither. A joint's name in an array by names.
        unit: that is named, as a mapping writes it; or "".
    """

    stem: tuple[str, ...]
    label: str
    unit: str

    @property
    def own(self) -> frozenset[str]:
        """Words, together those that belong together."""
        words = self.stem[-6:]
        return frozenset({*words, *("".join(pair) for pair in pairwise(words))})


def parsed(column: str, unit_line: str = "") -> Name:
    """Parts of a column's name; ``unit_line``: what a line of units says of it."""
    text, unit = _without_unit(column)
    unit = unit or known_unit(unit_line)
    topic, _, field = text.rpartition(":")
    by_name = re.fullmatch(r"(position|velocity|effort)\.(.+)", field)
    if by_name and topic:
        return Name((*_words(topic), by_name[1]), by_name[2], unit)
    words = _words(field)
    label = ""
    numbers = [k for k, word in enumerate(words) if word.isdigit()]
    if words and (words[-1] in ("x", "y", "z", "w") and len(words) > 1):
        label = words.pop()
    elif numbers:
        label = str(int(words.pop(numbers[-1])))
    elif words and (joined := re.fullmatch(_AXIS, words[-1])):
        words[-1:], label = [joined[1]], joined[2]
    elif words and words[-1] in _WORDS_ALONE:
        label = words[-1]
        words.pop()
    return Name((*_words(topic), *words), label, unit)


# fx, accX, angular_velocityZ, qw: what stands before the letter says that it is an axis
_AXIS = (
    r"(f|t|m|a|g|w|q|p|v|mu|acc|accel|gyr|gyro|omega|force|torque|moment|tau|vel|pos|quat|position|velocity|"
    r"acceleration|rot|ori|mag|r|u|tx|linacc|angvel|d)([xyzw])"
)
_WORDS_ALONE = ("roll", "pitch", "yaw", "x", "y", "z")


def _words(text: str) -> list[str]:
    """``actual_TCP_force_0``: actual, tcp, force, 0; ``tau_J[3]``: tau, j, 3; ``gyroX``: gyrox."""
    apart = re.sub(r"(?<=[a-z]{2})(?=[A-Z][a-z])", " ", text)
    apart = re.sub(r"(?<=[A-Za-z])(?=\d)|(?<=\d)(?=[A-Za-z])", " ", apart)
    return [word for word in re.split(r"[^a-z0-9°]+", apart.lower()) if word]


def known_unit(text: str) -> str:
    """``m/s^2`` of ``[m/s²]``; "" of none."""
    return _UNITS.get(text.strip().strip("[]()").strip().lower(), "")


def _without_unit(column: str) -> tuple[str, str]:
    for bracket in re.finditer(r"[\[(]([^\])]*)[\])]", column):
        if unit := known_unit(bracket[1]):
            return (column[: bracket.start()] + column[bracket.end() :]).strip(), unit
    index = re.search(r"\[\d+\]$", column)
    head, tail = (column[: index.start()], index[0]) if index else (column, "")
    for size in (3, 2, 1):
        parts = re.split(r"[_\s.]+", head)
        if len(parts) > size and (unit := _UNITS.get("_".join(parts[-size:]).lower(), "")):
            text = "_".join(parts[-size:])
            before = head[: len(head) - len(text)].rstrip("_ .")
            fits = re.search(_AFTER.get(text.lower(), ""), before)
            if fits and before and (text.lower() not in _TIME or len(text) < 3):
                return before + tail, unit
    if (inside := re.fullmatch(r"(.+?)_(deg|rad|mm|dps|radps|nm)_(\w+)", head, re.IGNORECASE)) is not None:
        return f"{inside[1]}_{inside[3]}{tail}", _UNITS[inside[2].lower()]
    return column, ""


def is_time(name: Name) -> bool:
    """Whether a name is that of a clock."""
    last = name.stem[-1:] or ("",)
    return not name.label and (
        last[0] in _TIME or (name.stem[:1] in (("time",), ("timestamp",)) and len(name.stem) <= 2)
    )


def commanded(stem: Iterable[str]) -> bool:
    """Whether a quantity is what was asked for, or computed, and not measured."""
    words = list(stem)
    return any(word in _COMMANDED for word in words[1:]) or (words[0] in _COMMANDED - {"d", "c"} if words else False)


def quantity(stem: tuple[str, ...]) -> tuple[str, ...]:
    """Words of a stem that say what is measured, and not of which part."""
    return tuple(word for word in stem if word in _OF_QUANTITIES)


def of_no_joint(part: str) -> bool:
    """Whether a part's name is an axis of a frame, an angle of an attitude or a letter."""
    return len(part) == 1 or set(part.split("_")) <= {*_WORDS_ALONE, "w"}


def kind_of(name: Name, labels: frozenset[str]) -> str:
    """What a group of columns is, by its stem and the labels of its columns; "" of nothing that is known."""
    words = name.own
    numbers = all(label.isdigit() for label in labels)
    if words & _WORDS["other"] or name.stem[-1:] == ("state",):  # `state.q` is an angle, `safety_state` none
        return ""
    if labels <= set("xyzw") and labels >= set("xyz"):
        return _of_axes(words, labels)
    if numbers and (kind := _of_an_array(words, labels)):
        return "" if kind == "other" else kind
    for kind in ("current", "torque", "acceleration", "rate", "angle"):
        if words & _WORDS[kind]:
            return kind if labels else ("load_cell" if kind == "torque" else "")
    return "load_cell" if words & {"force", "load", "loadcell"} else ""


def by_unit(name: Name, labels: frozenset[str]) -> str:
    """What a group of columns is by its unit alone; "" where a word says what it is, or nothing does."""
    if quantity(name.stem):
        return ""
    if labels == set("xyz"):
        return _BY_UNIT_OF_AXES.get(name.unit, "")
    return _BY_UNIT.get(name.unit, "") if all(label.isdigit() for label in labels) else ""


def _of_an_array(words: frozenset[str], labels: frozenset[str]) -> str:
    if _is_run(labels, 3) and words & _OF_AN_IMU:
        return "gyro" if words & ((_WORDS["gyro"] | _TURNING) - {"w"}) else "accel"
    if _is_run(labels, 4) and words & {"quat", "quaternion", "orientation", "attitude"}:
        return "quaternion"
    if _is_run(labels, 6) and words & {"force", "wrench", "ft"}:
        return "wrench"
    return "other" if words & {"tcp", "ee", "tool", "cartesian"} else ""


def _of_axes(words: frozenset[str], labels: frozenset[str]) -> str:
    if "w" in labels:
        return "quaternion" if words & _WORDS["quaternion"] or not words else ""
    if words & _TURNING or words & _WORDS["gyro"] or words == {"g"}:
        return "gyro"
    if words & _MOVING or words & _WORDS["accel"]:
        return "accel"
    for kind in ("force", "moment", "position"):
        if words & (_WORDS[kind] - {"ft", "wrench"}):
            return kind
    return ""


def _is_run(labels: frozenset[str], size: int) -> bool:
    numbers = sorted(int(label) for label in labels)
    return len(numbers) == size and numbers in (list(range(size)), list(range(1, size + 1)))
