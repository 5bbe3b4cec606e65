"""File of motion segments that a flight may request: the motions, and the information of each, computed beforehand.

Each segment begins and ends at rest in one posture. What it tells is kept for several payload masses, as rows of
whitened derivatives of the instruments' readings by all unknowns of the estimator, reduced to those that say more than
is known before the flight.
"""

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from onboard.config.errors import ConfigError
from onboard.npz import NpzError, arrays_of

FORMAT = 1
FILE = "segments.npz"
MOST_BYTES = 256 << 20  # of its arrays
_MOTION = ("ticks_hz", "sigma", "cyclic")
_FIELDS = (
    *_MOTION,
    "names",
    "joints",
    "time_s",
    "q",
    "ticks",
    "unknowns",
    "masses",
    "roots",
    "base_rate",
    "excess",
    "breaks",
    "most",
)

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Library:
    """Segments, k of them; m payload masses; p unknowns."""

    names: tuple[str, ...]  # (k,)
    joints: tuple[str, ...]
    time_s: FloatArray  # (t,) from the start of a segment, even steps
    q: FloatArray  # (k, t, joints) rad or m
    ticks: NDArray[np.int64]  # (k,) of each that count
    unknowns: tuple[str, ...]  # (p,)
    masses: FloatArray  # (m,) kg, rising
    roots: NDArray[np.float32]  # (k, m, r, p) whitened derivatives: information is the product with itself
    ticks_hz: float  # at which readings are predicted, for another linearisation
    sigma: FloatArray  # (k, n - 2, lines) noise of the readings at these ticks
    cyclic: FloatArray  # (k, n, 3, c) functions of the joints' cyclic errors
    base_rate: FloatArray  # (k, m) rad/s, largest of the base, apart from its motion before
    excess: FloatArray  # (k, m) over the limits but that of the base's rate: positive where one is broken
    breaks: tuple[tuple[str, ...], ...]  # (k, m) the limit that is nearest
    most: float  # rad/s, limit of the base's rate; inf: none

    @property
    def durations_s(self) -> FloatArray:
        """Of the segments, (k,)."""
        return np.asarray(self.time_s[self.ticks - 1], np.float64)

    @property
    def posture(self) -> FloatArray:
        """At which all begin and end, (joints,)."""
        return np.asarray(self.q[0, 0], np.float64)


def to_bytes(library: Library) -> bytes:
    """The file."""
    file = io.BytesIO()
    fields = {name: np.asarray(getattr(library, name)) for name in _FIELDS}
    fields["format"] = np.array(FORMAT)
    np.savez_compressed(file, allow_pickle=False, **fields)
    return file.getvalue()


def read(path: Path) -> Library:
    """Read a file of segments.

    Raises:
        ConfigError: it cannot be read, is none, or one of another version.
    """
    try:
        file = arrays_of(path, MOST_BYTES)
        if int(file["format"]) != FORMAT:
            raise ConfigError(f"segments {path}: of another version: make it again with heft plan --segments")
        fields = {name: file[name] for name in _FIELDS}
    except (OSError, NpzError, KeyError, TypeError, ValueError) as error:
        text = f"segments {path} cannot be read: {error}; heft plan --segments writes such a file"
        raise ConfigError(text) from error
    found = _checked(fields, path)
    for array in (found.time_s, found.q, found.roots, found.base_rate, found.excess):
        array.setflags(write=False)
    return found


def _checked(fields: dict[str, NDArray[Any]], path: Path) -> Library:
    k, t, j, m, p = (fields[name].size for name in ("names", "time_s", "joints", "masses", "unknowns"))
    wanted = {"q": (k, t, j), "ticks": (k,), "base_rate": (k, m), "excess": (k, m), "breaks": (k, m), "most": ()}
    wanted |= {"names": (k,), "time_s": (t,), "joints": (j,), "masses": (m,), "unknowns": (p,)}
    shapes = {name: fields[name].shape == shape for name, shape in wanted.items()}
    shapes["roots"] = fields["roots"].shape[:2] == (k, m) and fields["roots"].shape[3:] == (p,)
    n = fields["cyclic"].shape[1] if fields["cyclic"].ndim == 4 else 0
    shapes["sigma"] = fields["sigma"].shape[:2] == (k, n - 2) and fields["ticks_hz"].shape == () and n > 3
    wrong = [name for name, fits in shapes.items() if not fits]
    numbers = ("time_s", "q", "masses", "roots", "sigma", "cyclic", "base_rate", "excess")
    wrong += [name for name in ("names", "joints", "unknowns", "breaks") if fields[name].dtype.kind != "U"]
    wrong += [name for name in numbers if fields[name].dtype.kind != "f" or not np.isfinite(fields[name]).all()]
    if wrong or not (k and m and t > 3) or (fields["ticks"] < 4).any() or (fields["ticks"] > t).any():
        raise ConfigError(
            f"segments {path}: {', '.join(wrong) or 'it'} cannot be: make it again with heft plan --segments"
        )
    q, ticks = np.asarray(fields["q"], np.float64), np.asarray(fields["ticks"], np.int64)
    ends = q[np.arange(k), ticks - 1]
    if np.abs(np.concatenate([q[:, 0], ends]) - q[0, 0]).max() > 1e-6:
        raise ConfigError(f"segments {path}: their postures at begin and end differ: make them again")
    text = {name: tuple(fields[name].tolist()) for name in ("names", "joints", "unknowns")}
    return Library(
        text["names"],
        text["joints"],
        np.asarray(fields["time_s"], np.float64),
        q,
        ticks,
        text["unknowns"],
        np.asarray(fields["masses"], np.float64),
        np.asarray(fields["roots"], np.float32),
        float(fields["ticks_hz"]),
        np.asarray(fields["sigma"], np.float64),
        np.asarray(fields["cyclic"], np.float64),
        np.asarray(fields["base_rate"], np.float64),
        np.asarray(fields["excess"], np.float64),
        tuple(tuple(row) for row in fields["breaks"].tolist()),
        float(np.asarray(fields["most"], np.float64)),
    )
