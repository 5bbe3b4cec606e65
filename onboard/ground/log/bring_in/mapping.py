"""Mapping files: which columns of a foreign recording become which channels, with what scale, unit and axes.

::

    [mapping]
    name = "bench_2024"
    format = "csv"                  # or "npz", ...
    bad_rows = "refuse"             # or "skip": those with a cell that is no number are left out and counted

    [csv]                           # only for csv; these are the defaults
    delimiter = ","                 # " ": blanks, as many as there are
    decimal = "."                   # or ",", as 0,25: with another delimiter
    header = true                   # false: columns have no names, and are numbered from 1
    header_line = 1                 # the line that names the columns
    # rows_from = 3                 # the first line of numbers, where it is not the next one
    # comment = "#"                 # lines that begin so are passed over
    encoding = "utf-8"

    [time]
    column = "t"
    unit = "s"                      # ns, us, ms, s
    offset = 0                      # added to the column, in its unit
    # rate_Hz = 500                 # instead of column: samples without times, evenly spaced (heft resync finds when)

    [channel.imu_base]
    record = "imu"

    [channel.imu_base.accel]        # and the same for gyro
    columns = ["ax", "ay", "az"]    # or column = "acc", an array of three columns
    axes = ["-y", "+x", "+z"]       # body x, y, z, each by the recorded axis it is read from
    values = "counts"               # whole numbers; "physical": values in `unit`, rounded to counts of size `scale`
    scale = [9.81, 2048]            # `unit` per count, as a number or [numerator, denominator]
    unit = "m/s^2"

    [channel.joint_1]
    record = "scalar"
    time = { column = "t2", unit = "s" }    # a channel may have a clock of its own

    [channel.joint_1.value]
    column = "angle"                # or "angles[0]", of an array of several columns
    sign = "-"
    values = "physical"
    scale = 1e-6
    unit = "deg"

    [channel.torque_5]
    record = "scalar"
    file = "currents.csv"           # a file beside the recording that this channel's columns are in

    [channel.torque_5.value]        # 45 times one column and 32 times another: a coupled wrist, seen at its motors
    sum = { "motor_5" = 45.0, "motor_6" = 32.0 }
    values = "physical"
    scale = 1e-5
    unit = "N m"

    [channel.pose_yaw]
    record = "scalar"

    [channel.pose_yaw.value]        # of a tracker's attitude, about its vertical
    quaternion = ["qw", "qx", "qy", "qz"]
    up = "y"                        # "z" where it is silent
    values = "physical"
    scale = 1e-7
    unit = "rad"
"""

import math
from pathlib import Path
from typing import Annotated, ClassVar, Literal, NamedTuple, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from onboard import config
from onboard.ground.log.bring_in.errors import MappingError

# unit to the unit it is stored in, and the factor
UNITS = {
    "1": ("1", 1.0),
    "s": ("s", 1.0),
    "ms": ("s", 1e-3),
    "m/s^2": ("m/s^2", 1.0),
    "g": ("m/s^2", 9.80665),  # standard gravity, CGPM 1901
    "mg": ("m/s^2", 9.80665e-3),
    "rad/s": ("rad/s", 1.0),
    "deg/s": ("rad/s", math.pi / 180),
    "rev/min": ("rad/s", 2 * math.pi / 60),
    "rad": ("rad", 1.0),
    "deg": ("rad", math.pi / 180),
    "rev": ("rad", 2 * math.pi),
    "m": ("m", 1.0),
    "mm": ("m", 1e-3),
    "%": ("1", 1e-2),
    "m/s": ("m/s", 1.0),
    "mm/s": ("m/s", 1e-3),
    "N": ("N", 1.0),
    "N m": ("N m", 1.0),
    "N mm": ("N m", 1e-3),
    "A": ("A", 1.0),
    "mA": ("A", 1e-3),
}
NS_PER = {"ns": 1, "us": 1_000, "ms": 1_000_000, "s": 1_000_000_000}

Column = Annotated[str, BeforeValidator(lambda name: str(name) if type(name) is int else name)]  # or its number from 1
_Positive = Annotated[float, Field(gt=0)]
Axis = Literal["+x", "-x", "+y", "-y", "+z", "-z"]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class About(_Section):
    """Name of the mapping and format of its recordings."""

    name: str
    format: Literal["csv", "npz", "mat", "json", "bag", "mcap", "ulog"]
    bad_rows: Literal["refuse", "skip"] = "refuse"


class Csv(_Section):
    """Layout of a CSV file."""

    delimiter: Annotated[str, Field(min_length=1, max_length=1)] = ","
    decimal: Literal[".", ","] = "."
    header: bool = True
    header_line: Annotated[int, Field(ge=1)] = 1
    rows_from: Annotated[int, Field(ge=1)] | None = None
    comment: Annotated[str, Field(min_length=1, max_length=4)] | None = None
    encoding: Literal["utf-8", "latin-1", "utf-16"] = "utf-8"

    @model_validator(mode="after")
    def _check_marks(self) -> Self:
        if self.delimiter == self.decimal:
            raise ValueError(f"`delimiter` and `decimal` are both {self.decimal!r}: name that between the cells")
        if not self.header and self.header_line != 1:
            raise ValueError("`header = false` has no `header_line`: say `rows_from`, the first line of numbers")
        if self.header and self.rows_from is not None and self.rows_from <= self.header_line:
            raise ValueError("`rows_from`, the first line of numbers, stands below `header_line`")
        return self


class Time(_Section):
    """The recording's clock: a column of times, or the nominal rate of evenly spaced samples."""

    column: Column | None = None
    unit: Literal["ns", "us", "ms", "s"] = "s"
    rate_Hz: _Positive | None = None  # noqa: N815  (a key ends in its SI symbol)
    offset: float = 0
    wraps: Annotated[int, Field(gt=1, le=1 << 53)] | None = None  # floats hold whole numbers up to that

    @model_validator(mode="after")
    def _check_one(self) -> Self:
        if (self.column is None) == (self.rate_Hz is None):
            raise ValueError("give either `column`, the name of the times, or `rate_Hz`, where there are none")
        if self.wraps is not None and self.column is None:
            raise ValueError("`wraps` is of a `column` that counts and starts at 0 again; leave it out")
        return self


def _as_ratio(scale: object) -> object:
    return scale if isinstance(scale, list) else [scale, 1]


MOST_A_COUNT = 1e30  # SI; records hold it as a number of four bytes


class _Quantity(_Section):
    keeps: ClassVar[tuple[str, ...]] = ()  # allowed stored units; empty: any

    values: Literal["counts", "physical"] = "counts"
    scale: Annotated[tuple[_Positive, _Positive], BeforeValidator(_as_ratio)]
    unit: str

    @model_validator(mode="after")
    def _check_unit(self) -> Self:
        good = [unit for unit, (kept, _) in UNITS.items() if not self.keeps or kept in self.keeps]
        if self.unit not in good:
            raise ValueError(f"unit {self.unit!r} is not known here; use any of {', '.join(map(repr, good))}")
        if not 1.0 / MOST_A_COUNT < self.si_count < MOST_A_COUNT:
            raise ValueError(f"a count of {self.si_count:.3g} {self.si_unit} cannot be stored; correct the scale")
        return self

    @property
    def si_unit(self) -> str:
        """Unit of the stored channel."""
        return UNITS[self.unit][0]

    @property
    def count(self) -> float:
        """Size of one count in ``unit``."""
        return self.scale[0] / self.scale[1]

    @property
    def si_count(self) -> float:
        """Size of one count in ``si_unit``."""
        return self.count * UNITS[self.unit][1]


class VectorMapping(_Quantity):
    """A quantity with three axes."""

    column: Column | None = None
    columns: tuple[Column, Column, Column] | None = None
    axes: tuple[Axis, Axis, Axis] = ("+x", "+y", "+z")

    @model_validator(mode="after")
    def _check_axes(self) -> Self:
        if (self.column is None) == (self.columns is None):
            raise ValueError("give either `column`, an array of three, or `columns`, three names")
        if sorted(axis[1] for axis in self.axes) != ["x", "y", "z"]:
            raise ValueError(f"axes {list(self.axes)} must name each of x, y and z once")
        return self


class Acceleration(VectorMapping):
    """Specific force."""

    keeps = ("m/s^2",)


class AngularRate(VectorMapping):
    """Angular velocity."""

    keeps = ("rad/s",)


class Scalar(_Quantity):
    """A quantity of one value: a column, a sum of some, or the yaw that a quaternion has about the vertical."""

    column: Column | None = None
    sum: Annotated[dict[str, float], Field(min_length=1)] | None = None
    quaternion: tuple[Column, Column, Column, Column] | None = None  # w, x, y, z
    up: Literal["y", "z"] = "z"
    sign: Literal["+", "-"] = "+"
    wraps: _Positive | None = None

    @model_validator(mode="after")
    def _check_one(self) -> Self:
        if self.wraps is not None and self.column is None:
            raise ValueError("`wraps` is of a `column` that starts again after a turn; leave it out")
        if sum(one is not None for one in (self.column, self.sum, self.quaternion)) != 1:
            raise ValueError(
                "give a `column`, `sum`, columns and what to multiply each by, or `quaternion`, four columns"
            )
        if self.column is None and self.values != "physical":
            raise ValueError('a sum of columns, or a yaw, is no count; say values = "physical"')
        if self.quaternion is not None and self.unit != "rad":
            raise ValueError('the yaw of a quaternion is in rad; say unit = "rad"')
        return self

    @property
    def terms(self) -> dict[str, float]:
        """Columns, and what each is multiplied by."""
        if self.quaternion is not None:
            return dict.fromkeys(self.quaternion, 1.0)
        return {self.column: 1.0} if self.column is not None else dict(self.sum or {})


class ImuChannel(_Section):
    """A channel of ``records.IMU``."""

    record: Literal["imu"]
    accel: Acceleration
    gyro: AngularRate
    time: Time | None = None
    file: str | None = None


class ScalarChannel(_Section):
    """A channel of ``records.SCALAR``."""

    record: Literal["scalar"]
    value: Scalar
    time: Time | None = None
    file: str | None = None


ChannelMapping = Annotated[ImuChannel | ScalarChannel, Field(discriminator="record")]


class MappingFile(_Section):
    """A whole mapping file."""

    mapping: About
    csv: Csv = Csv()
    time: Time
    channel: Annotated[dict[str, ChannelMapping], Field(min_length=1)]


class Mapping(NamedTuple):
    """A parsed mapping file and its text."""

    path: Path
    text: str
    file: MappingFile


def packaged() -> dict[str, Path]:
    """The mappings that come with heft, by name."""
    return {path.stem: path for path in sorted((Path(__file__).parent / "mappings").glob("*.toml"))}


def load(name: str | Path) -> Mapping:
    """Read and check a mapping: a packaged one by its name, or a file by its path.

    Raises:
        MappingError: no such mapping, not TOML, an unknown key or a wrong value.
    """
    known = packaged()
    path = known.get(str(name), Path(name))
    try:
        text = config.read(path, f"a mapping file, or any of these names: {', '.join(known)}")
        file = config.validated(MappingFile, config.tree_of(text, str(path)), config.Origin(str(path), text))
    except config.ConfigError as error:
        raise MappingError(str(error)) from error
    return Mapping(path, text, file)
