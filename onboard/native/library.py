"""The library, loaded once, and how its functions are called.

It is looked for beside this file, where an installation puts it, then in the user's cache, where it is made if it is
missing: ``$XDG_CACHE_HOME/heft``, ``~/.cache/heft``, or where neither can be written a directory of the user's alone in
the one for temporary files.
"""

import contextlib
import ctypes
import os
import stat
import tempfile
from collections.abc import Sequence
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from onboard.native import build
from onboard.native.errors import ArrayError, NativeError

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]
_INT, _FLOAT, _ARRAY = ctypes.c_int64, ctypes.c_double, ctypes.c_void_p
_address_of, _char_at = ctypes.addressof, ctypes.c_char.from_buffer
_WORDS = {1: "an array's length is not that of the results", 2: "no memory"}
_SIGNATURES = {  # all end with the results and their number
    "heft_chain": (_ARRAY, _INT, _ARRAY, _ARRAY, _ARRAY, _ARRAY),
    "heft_bodies": (_ARRAY, _ARRAY, _ARRAY),
    "heft_rows": (_ARRAY, _INT, *[_ARRAY] * 6, _INT, _ARRAY, _INT, _ARRAY, _ARRAY, _INT, _ARRAY),
    "heft_sums": (_INT, _INT, _INT, _ARRAY, _ARRAY),
    "heft_move": (_ARRAY, _ARRAY, _FLOAT, _ARRAY, ctypes.c_int),
    "heft_predict_base": (*[_ARRAY] * 5, _INT, _ARRAY, _FLOAT, _ARRAY, ctypes.c_int),
    "heft_momentum": (_INT, _ARRAY, _ARRAY, _ARRAY, _FLOAT),
    "heft_sensitivity": (_INT, _INT, *[_ARRAY] * 5, _FLOAT),
    "heft_cut_wrench": (*[_ARRAY] * 4,),
    "heft_sensor": (*[_ARRAY] * 3,),
    "heft_imu_reading": (_INT, *[_ARRAY] * 4),
    "heft_imu_gain": (_ARRAY,),
    "heft_whitened": (_ARRAY, _FLOAT),
    "heft_predict": (*[_ARRAY] * 3, _INT, _FLOAT, *[_ARRAY] * 2),
    "heft_shown": (*[_ARRAY] * 5, _FLOAT, *[_ARRAY] * 2),
    "heft_linked": (_ARRAY, _INT, _INT, _ARRAY),
    "heft_corrected": (_ARRAY, _FLOAT, _ARRAY),
    "heft_polygon": (_INT, _INT, _ARRAY, _INT, _INT, _ARRAY),
    "heft_moments": (_INT, _ARRAY),
    "heft_carried": (_INT, _INT, *[_ARRAY] * 5),
    "heft_joint_noise": (*[_ARRAY] * 3, _INT, *[_ARRAY] * 2),
    "heft_tick_means": (_ARRAY, _FLOAT, _FLOAT),
    "heft_under": (_ARRAY, _FLOAT, _FLOAT),
    "heft_pieces": (_ARRAY, _INT, _INT, _INT, _ARRAY, _INT),
    "heft_weights": (_INT, _INT, *[_ARRAY] * 5, _FLOAT),
    "heft_weighed": (*[_INT] * 5, *[_ARRAY] * 3),
    "heft_predict_table": (_ARRAY,),
    "heft_alone": (*[_ARRAY] * 3, _INT, *[_ARRAY] * 2),
    "heft_pairs": (_INT, _INT, *[_ARRAY] * 4, _FLOAT, _ARRAY),
    "heft_scaled": (_INT, *[_ARRAY] * 3),
}


def open_library(path: Path) -> ctypes.CDLL:
    """Load a library and state what its functions take.

    Raises:
        NativeError: it is not of these sources, or cannot be loaded.
    """
    try:
        library = ctypes.CDLL(str(path))
        library.heft_identity.restype = ctypes.c_char_p
        of = library.heft_identity().decode()
        for name, takes in _SIGNATURES.items():
            getattr(library, name).argtypes = (*takes, _ARRAY, _INT)
    except (OSError, AttributeError) as error:
        raise NativeError(f"{path} cannot be loaded ({error}). Remove it, and run the same command again") from error
    if not of.startswith(f"{build.key()},"):
        raise NativeError(f"{path} is of other sources ({of}). Remove it, and run the same command again")
    return library


def _caches() -> list[Path]:
    stated = os.environ.get("XDG_CACHE_HOME")
    places = [Path(stated)] if stated else []
    with contextlib.suppress(RuntimeError):  # a user without a home
        places.append(Path.home() / ".cache")
    return [*(place / "heft" for place in places), Path(tempfile.gettempdir()) / f"heft-{os.getuid()}"]


def _ours(place: Path) -> bool:
    """Whether what lies in a directory is the user's own, and others cannot put anything there."""
    about = place.stat()
    return about.st_uid == os.getuid() and not about.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _found() -> Path:
    name = build.file_name()
    if (beside := Path(__file__).parent / name).exists():
        return beside
    for place in _caches():
        try:
            place.mkdir(mode=0o700, parents=True, exist_ok=True)
            if not (_ours(place) and os.access(place, os.W_OK)):
                continue
        except OSError:
            continue
        return place / name if (place / name).exists() else build.build(place)
    raise NativeError(f"there is no place for heft's compiled core; let {_caches()[0]} be made, or set XDG_CACHE_HOME")


LIBRARY = open_library(_found())


def identity() -> tuple[str, str]:
    """Key of the library's sources, and what it was compiled by: of one key all make the same bits."""
    key, by = str(LIBRARY.heft_identity().decode()).split(", ", 1)
    return key, by


def given(array: FloatArray, *shape: int) -> FloatArray:
    """The array as the library takes it, copied where it does not lie row by row.

    Raises:
        ArrayError: another shape.
    """
    if array.shape != shape:
        raise ArrayError(f"an array of {shape} is needed, and this is of {array.shape}")
    return array if array.dtype == np.float64 and array.flags.c_contiguous else np.ascontiguousarray(array, np.float64)


def indices(array: IndexArray, below: int) -> IndexArray:
    """Numbers of some of so many, (k,).

    Raises:
        ArrayError: one is of none.
    """
    found = np.ascontiguousarray(array, np.int64)
    if found.ndim != 1 or (found.size and not (int(found.min()) >= 0 and int(found.max()) < below)):
        raise ArrayError(f"numbers from 0 to {below - 1} are needed, and these are {found.tolist()}")
    return found


def address(array: "FloatArray | IndexArray | ctypes.Structure | None") -> int | None:
    """Where an array or a structure lies; the caller keeps it."""
    if array is None:
        return None
    try:
        return _address_of(_char_at(array))  # type: ignore[arg-type]  # a third of the time of array.ctypes.data
    except (TypeError, ValueError):  # read-only, or empty
        return int(array.ctypes.data)


def pointers(parts: "Sequence[FloatArray | ctypes.Structure | None]") -> Any:
    """Where some arrays or structures lie; the caller keeps them."""
    return (_ARRAY * len(parts))(*map(address, parts))


def call(name: str, *arguments: Any, out: FloatArray) -> FloatArray:
    """Call a function of the library, and give its results.

    Raises:
        ArrayError: lengths that do not fit: a bug of the caller.
        MemoryError: there is none.
    """
    code = getattr(LIBRARY, name)(*arguments, address(out), out.size)
    if code != 0:
        raise MemoryError(name) if code == 2 else ArrayError(f"{name}: {_WORDS.get(code, code)}")
    return out


def carved(out: FloatArray, shapes: Sequence[tuple[int, ...]]) -> list[FloatArray]:
    """Results, which lie one after the other, (size,), as arrays of these shapes."""
    parts, at = [], 0
    for shape in shapes:
        end = at + prod(shape)
        parts.append(out[at:end].reshape(shape))
        at = end
    return parts
