"""What a table may mean: order of a quaternion, pose or its inverse, axes of the wrench, and its sign.

Where nobody says, every meaning is fitted and the likeliest is taken; where two are as likely and differ in the answer,
a person has to say.
"""

from collections.abc import Callable, Iterator, Sequence
from itertools import product
from typing import Literal, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.calibration import wrist_model
from onboard.ground.calibrate.place import Gravity
from onboard.ground.calibrate.weigh.columns import ONE_G, Meaning
from onboard.ground.calibrate.weigh.errors import PosesError

_UNIT = 0.05  # of a quaternion's length or a matrix's elements: rounding, a mean
_ANY_MOUNTING_rad = np.pi / 2.0  # flanges are turned to any angle; where poses tell nothing of it, the nearest to none
_SAME_RAD = np.deg2rad(0.5)  # a robot's dither; the gravity along an axis changes by less than 1 %
_DWELL = 5  # rows a pose, from which on rows between poses are motion
_SETTLED = 3  # rows that a pose has at least then

Sense = Literal["sensor-in-base", "base-in-sensor"]
Axes = Literal["sensor", "base"]
Sign = Literal["weight", "reaction"]
Down = tuple[float, float, float]
DOWN: Down = (0.0, 0.0, -1.0)


class Said(NamedTuple):
    """What a person said; None: every possibility is tried."""

    sense: Sense | None = None
    axes: Axes | None = None
    sign: Sign | None = None


class Known(NamedTuple):
    """What is known besides the table.

    Attributes:
        place: gravity.
        down: (3,) unit vector in base axes; None: nobody said.
        scale: 1 sigma of an axis of the sensor, relative.
        tilt_rad: 1 sigma of the base's tilt.
        said: conventions.
    """

    place: Gravity
    down: Down | None
    scale: float
    tilt_rad: float
    said: Said = Said()

    @property
    def by_up(self) -> "Known":
        """Where poses are by an accelerometer: no base that could be tilted, or whose axes a wrench could be in."""
        return self._replace(
            down=DOWN, tilt_rad=np.deg2rad(1e-3), said=Said("sensor-in-base", "sensor", self.said.sign)
        )

    @property
    def prior(self) -> wrist_model.Priors:
        """For the fit."""
        down = np.array(self.down or DOWN, np.float64)
        gravity = self.place.gravity_m_s2 * down / np.linalg.norm(down)
        return wrist_model.Priors(gravity, self.scale, self.tilt_rad, _ANY_MOUNTING_rad)


class Convention(NamedTuple):
    """One meaning of the table."""

    orientation: str
    sense: Sense
    axes: Axes
    sign: Sign
    down: Down = DOWN

    @property
    def text(self) -> str:
        """In words."""
        pose = "the sensor's in the base" if self.sense == "sensor-in-base" else "the base's in the sensor"
        force = "the weight on the sensor" if self.sign == "weight" else "what the sensor pushes with (the reaction)"
        turned = "" if self.down == DOWN else f"; downwards in the base's axes is {self.gravity}"
        return f"{self.orientation}; orientation is {pose}; wrench in the {self.axes}'s axes, {force}{turned}"

    @property
    def gravity(self) -> str:
        """``down`` as an option writes it."""
        return ",".join(f"{part:g}" for part in self.down)


class Poses(NamedTuple):
    """Static poses by one convention."""

    convention: Convention
    R: FloatArray  # (n, 3, 3) sensor's frame in the base
    wrench: FloatArray  # (n, 6) weight on the sensor, in its axes


class Still(NamedTuple):
    """Rows that belong to poses."""

    groups: tuple[FloatArray, ...]  # rows of each pose, intp
    moving: int  # rows left out, between poses
    bad: int  # rows left out: a cell that is no number, a quaternion that is none


def rotations(meaning: Meaning) -> Iterator[tuple[str, FloatArray]]:
    """Rotation matrices (n, 3, 3) by each way to read the orientation, NaN where a row is none; with its name."""
    values = meaning.orientation
    match meaning.kind:
        case "quaternion":
            yield "quaternion by its names", _of_quaternion(values)
        case "quaternion?" | "quaternion:xyzw" | "quaternion:wxyz":
            if not meaning.kind.endswith("xyzw"):
                yield "quaternion w, x, y, z", _of_quaternion(values)
            if not meaning.kind.endswith("wxyz"):
                yield "quaternion x, y, z, w", _of_quaternion(values[:, [3, 0, 1, 2]])
        case "matrix":
            matrices = values.reshape(-1, 3, 3)
            off = np.abs(matrices @ matrices.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
            good = (off < 2.0 * _UNIT) & (np.linalg.det(np.nan_to_num(matrices)) > 0.0)
            yield "rotation matrix", _where(good, lambda rows: Rotation.from_matrix(matrices[rows]))
        case "rotvec":
            yield "rotation vector", _of_vector(values)
        case "angles" | "angles?":
            if meaning.kind == "angles?":
                yield "rotation vector", _of_vector(values)
            for order in ("xyz", "XYZ"):
                yield f"Euler angles {order}", of_euler(order, values)
        case "up":
            yield "upwards by an accelerometer", of_up(values)
        case kind if kind.startswith("sequence"):
            yield from _sequences(kind.removeprefix("sequence").removeprefix(":"), values)
        case order:
            yield f"Euler angles {order}", of_euler(order, values)


def of_up(up: FloatArray) -> FloatArray:
    """Rotations (n, 3, 3) whose third row is upwards in the sensor's axes, along ``up`` (n, 3).

    The turn about it is any. NaN where ``up`` is longer or shorter than most, as in motion.
    """
    length = np.linalg.norm(up, axis=1)
    x, y, z = (up / length[:, None]).T
    q = np.stack([1.0 + z, y, -x, np.zeros(len(up))], axis=1)  # the smallest turn
    q[z < -1.0 + 1e-12] = 0.0, 1.0, 0.0, 0.0
    q[np.abs(length / np.nanmedian(length) - 1.0) > ONE_G] = np.nan
    return _of_quaternion(q / np.linalg.norm(q, axis=1)[:, None])


def _sequences(said: str, values: FloatArray) -> Iterator[tuple[str, FloatArray]]:
    """By the order that a person said, or by the usual ones."""
    for order in [said] if said else ("xyz", "XYZ", "ZYX", "ZYZ", "ZXZ"):
        by_axis = of_euler(order, values)
        yield f"Euler angles {order}", of_sequence(order, values)
        if said and len({*said}) == 3 and said.lower() != "xyz":  # phi is the roll, the last to turn, in ZYX
            yield f"Euler angles {said}, the first about x", by_axis


def of_euler(order: str, values: FloatArray) -> FloatArray:
    """Angles about x, y, z (n, 3), or in the order of the letters where an axis comes twice.

    Raises:
        PosesError: no such order.
    """
    letters = order.lower()
    if len(order) != 3 or set(letters) - set("xyz") or order not in (letters, letters.upper()):
        raise PosesError(
            f"{order!r} is no order of Euler angles; write xyz (fixed axes), ZYX (moving axes) and the like"
        )
    columns = ["xyz".index(letter) for letter in letters] if len(set(letters)) == 3 else [0, 1, 2]
    return of_sequence(order, values[:, columns])


def of_sequence(order: str, values: FloatArray) -> FloatArray:
    """Angles (n, 3) rad in the order of the letters."""
    good = np.asarray(np.isfinite(values).all(axis=1))
    return _where(good, lambda rows: Rotation.from_euler(order, values[rows]))


def _of_quaternion(values: FloatArray) -> FloatArray:
    good = np.asarray(np.abs(np.linalg.norm(values, axis=1) - 1.0) < _UNIT)
    return _where(good, lambda rows: Rotation.from_quat(values[rows], scalar_first=True))


def _of_vector(values: FloatArray) -> FloatArray:
    return _where(np.asarray(np.isfinite(values).all(axis=1)), lambda rows: Rotation.from_rotvec(values[rows]))


def _where(good: BoolArray, made: Callable[[BoolArray], Rotation]) -> FloatArray:
    out = np.full((len(good), 3, 3), np.nan)
    if good.any():
        out[good] = made(good).as_matrix()
    return out


def still(R: FloatArray, wrench: FloatArray) -> Still:
    """Rows grouped by pose: those next to each other with the same orientation.

    Where poses were held for some rows each, single rows between them were taken in motion and are left out.
    """
    usable = np.isfinite(R).all(axis=(1, 2)) & np.isfinite(wrench).all(axis=1)
    rows = np.flatnonzero(usable)
    groups: list[list[int]] = []
    for row in rows.tolist():
        if groups and _angle(R[groups[-1][0]], R[row]) < _SAME_RAD:
            groups[-1].append(row)
        else:
            groups.append([row])
    moving = 0
    if groups and np.median([len(one) for one in groups for _ in one]) >= _DWELL:
        moving = sum(len(one) for one in groups if len(one) < _SETTLED)
        groups = [one for one in groups if len(one) >= _SETTLED]
    return Still(tuple(np.array(one) for one in groups), moving, int((~usable).sum()))


def _angle(a: FloatArray, b: FloatArray) -> float:
    return float(2.0 * np.arcsin(min(1.0, float(np.linalg.norm(a - b)) / np.sqrt(8.0))))


def averaged(R: FloatArray, wrench: FloatArray, groups: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Mean orientation and wrench of each pose."""
    means = [Rotation.from_matrix(R[rows]).mean().as_matrix() for rows in groups]
    return np.array(means).reshape(-1, 3, 3), np.array([wrench[rows].mean(axis=0) for rows in groups]).reshape(-1, 6)


def meanings(
    orientation: str, R: FloatArray, wrench: FloatArray, said: Said, down: Down | None = DOWN
) -> Iterator[Poses]:
    """Every meaning that a person did not exclude, the usual one first.

    Without ``down`` the base may stand, hang, or be fixed to a wall; where the sign is not said either, half of these
    directions do, as the opposite one with the other sign is the same.
    """
    downs: list[Down] = [down] if down else [DOWN, (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0)]
    if down is None and said.sign:
        downs += [(-x, -y, -z) for x, y, z in downs]
    senses: tuple[Sense, ...] = ("sensor-in-base", "base-in-sensor") if said.sense is None else (said.sense,)
    axes: tuple[Axes, ...] = ("sensor", "base") if said.axes is None else (said.axes,)
    signs: tuple[Sign, ...] = ("weight", "reaction") if said.sign is None else (said.sign,)
    for sense in senses:
        turned = R if sense == "sensor-in-base" else R.transpose(0, 2, 1)
        for which in axes:
            parts = wrench.reshape(-1, 2, 3)
            own = parts if which == "sensor" else parts @ turned  # R' f, by rows
            for sign, towards in product(signs, downs):
                yield Poses(
                    Convention(orientation, sense, which, sign, towards),
                    turned,
                    (own if sign == "weight" else -own).reshape(-1, 6),
                )
