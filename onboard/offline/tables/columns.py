"""A channel's rows as flat columns for other programs: raw counts and, beside them, SI.

A converted column stands where the row carries its own scale: ``gyro_raw`` with ``gyro_scale_rad_s`` gives ``gyro_x``
to ``gyro_z`` in rad/s, ``value_raw`` with ``scale`` and ``unit`` gives ``value`` in that unit.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows

Values = NDArray[np.generic]

_UNIT_OF_SUFFIX = {  # of the last words of a field's name
    "ns": "ns",
    "us": "us",
    "ms": "ms",
    "s": "s",
    "hz": "Hz",
    "m": "m",
    "m_s": "m/s",
    "m_s2": "m/s^2",
    "rad": "rad",
    "rad_s": "rad/s",
    "rad_s2": "rad/s^2",
    "deg": "deg",
    "deg_s": "deg/s",
    "deg_c": "deg C",
    "n": "N",
    "n_m": "N m",
    "kg": "kg",
    "kg_m": "kg m",
    "kg_m2": "kg m^2",
    "v": "V",
    "a": "A",
    "w": "W",
    "pa": "Pa",
    "ppm": "ppm",
    "raw": "count",
    "tick": "count",
}
_CARTESIAN = {
    "accel",
    "acceleration",
    "angular",
    "axis",
    "field",
    "force",
    "gyro",
    "magnetic",
    "moment",
    "position",
    "specific",
    "torque",
    "velocity",
}


class Column(NamedTuple):
    """One column of a table.

    ``values`` takes rows (n,) to values (n,); ``digits`` is how many significant decimal digits a converted value
    carries, None for a value that is to be written as it is. ``product`` takes rows to the counts and the scale that a
    converted value is the product of, where it is nothing but that; ``made_of`` names the columns it stands for.
    """

    name: str
    unit: str
    values: Callable[[Rows], Values]
    digits: int | None = None
    product: tuple[Callable[[Rows], Values], Callable[[Rows], Values]] | None = None
    made_of: tuple[str, ...] = ()

    @property
    def converted(self) -> bool:
        """Whether it is SI made of counts beside it."""
        return self.digits is not None

    @property
    def header(self) -> str:
        """Name and unit, as the head of a column."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


def unit_of(field: str) -> str:
    """The unit that a field's name ends with; empty where it names none."""
    words = field.split("_")
    suffixes = ("_".join(words[-n:]) for n in (3, 2, 1) if n <= len(words))
    return next((_UNIT_OF_SUFFIX[suffix] for suffix in suffixes if suffix in _UNIT_OF_SUFFIX), "")


def columns(dtype: np.dtype[np.void], units: Mapping[str, str], sample: Rows) -> list[Column]:
    """The columns of a channel, in the order of its fields, each converted one after its raw one.

    Args:
        dtype: of the channel's rows.
        units: field to unit, where the log names one; the field's name tells the others.
        sample: some of the rows (possibly none): where a row names its unit itself, the first one's is that of the
            converted column, and rows of another unit are NaN there.
    """
    result: list[Column] = []
    for name, shape in _fields(dtype).items():
        unit = units.get(name, unit_of(name))
        for suffix, index in _components(name, shape):
            result.append(Column(name + suffix, unit, _getter(name, index)))
        if name.endswith("_raw"):
            result += _converted(dtype, name.removesuffix("_raw"), shape, sample)
    return result


def _fields(dtype: np.dtype[np.void]) -> dict[str, tuple[int, ...]]:
    assert dtype.names is not None
    assert dtype.fields is not None
    return {name: dtype.fields[name][0].shape for name in dtype.names}


def _components(name: str, shape: tuple[int, ...]) -> list[tuple[str, tuple[int, ...]]]:
    """Suffix of the column's name, and index in the field, of each element."""
    if shape == (3,) and _CARTESIAN & set(name.split("_")):
        return [(f"_{axis}", (n,)) for n, axis in enumerate("xyz")]
    return [("".join(f"_{n}" for n in index), index) for index in np.ndindex(shape)]


def _element(rows: Rows, name: str, index: tuple[int, ...]) -> Values:
    field: Values = rows[name]
    for n in index:
        field = field[:, n]
    return field


def _getter(name: str, index: tuple[int, ...]) -> Callable[[Rows], Values]:
    return lambda rows: _element(rows, name, index)


def _converted(dtype: np.dtype[np.void], base: str, shape: tuple[int, ...], sample: Rows) -> list[Column]:
    fields = _fields(dtype)
    own = next((name for name in fields if name.startswith(f"{base}_scale_")), None)
    if own is not None:
        scale, unit, text = own, unit_of(own), b""
    elif base == "value" and {"scale", "unit"} <= set(fields):
        text = bytes(sample["unit"][0]) if len(sample) else b""
        scale, unit = "scale", text.decode(errors="backslashreplace")
    else:
        return []
    digits = 9 if dtype[scale] == np.float32 else 17

    def converter(index: tuple[int, ...]) -> Callable[[Rows], Values]:
        def values(rows: Rows) -> Values:
            counts = _element(rows, f"{base}_raw", index).astype(np.float64)
            with np.errstate(over="ignore", invalid="ignore"):  # the product is then inf or NaN, and written so
                product: NDArray[np.float64] = counts * rows[scale].astype(np.float64)
            if text:
                product[rows["unit"] != text] = np.nan
            return product

        return values

    made: list[Column] = []
    for suffix, index in _components(base, shape):
        product = None if text else (_getter(f"{base}_raw", index), _getter(scale, ()))
        sources = (f"{base}_raw{suffix}", scale, *(("unit",) if text else ()))
        made.append(Column(base + suffix, unit, converter(index), digits, product, sources))
    return made
