"""What was foreseen before: kept in the user's cache by the content of vehicle, motion and code.

A file in ``$XDG_CACHE_HOME/heft/foreseen`` (``~/.cache`` where that is not set), named by the SHA-256 of all that the
result depends on; its first line is the SHA-256 of the rest. It is believed only if it is a regular file of this
user that nobody else may write, in a directory of which the same holds, and if it reads as a result; else it is made
again. A cache that cannot be written costs time, and nothing else.
"""

import hashlib
import json
import os
import stat
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import pinocchio
import scipy
from pydantic import BaseModel, ConfigDict, Field

import onboard
from onboard import config
from onboard.dynamics.model.inertia import RigidBody
from onboard.ground.before.foresee.plan import Expected, Foreseen, MotionPlan
from onboard.identification.standing import Level

_MOST_BYTES, _MOST_FILES = 1 << 20, 64
Said = Annotated[str, Field(max_length=500, pattern=r"^[^\x00-\x1f\x7f-\x9f]*$")]  # nothing that steers a terminal
Three = tuple[float, float, float]


class _Quantity(BaseModel):
    model_config = ConfigDict(extra="forbid")

    name: Said
    unit: Said
    value: float
    sigma: float
    level: Level
    why: Said


class _Payload(BaseModel):
    model_config = ConfigDict(extra="forbid")

    mass_kg: float
    centre_of_mass_m: Three
    inertia_kg_m2: tuple[Three, Three, Three]


class _Found(BaseModel):
    model_config = ConfigDict(extra="forbid")

    quantities: list[_Quantity]
    parameters: list[_Quantity]
    payload: _Payload | None
    span_s: float
    words: list[Said]


def kept(vehicle: config.Vehicle, plan: MotionPlan, make: Callable[[], Foreseen]) -> Foreseen:
    """The result of an earlier call with the same vehicle, motion and code; made, and kept, where there is none.

    Args:
        vehicle: its file.
        plan: the motion.
        make: the bound of both.
    """
    directory = _directory()
    if directory is None:
        return make()
    path = directory / f"{_name(vehicle, plan)}.json"
    found = _read(path)
    if found is None:
        found = make()
        _write(path, found)
    return found


def _directory() -> Path | None:
    """The cache, made where it is not there; None where it cannot be, or is another's."""
    told = Path(os.environ.get("XDG_CACHE_HOME", ""))
    try:
        directory = (told if told.is_absolute() else Path.home() / ".cache") / "heft" / "foreseen"
        directory.mkdir(mode=0o700, parents=True, exist_ok=True)
        about = directory.lstat()
    except (OSError, RuntimeError):  # no room, no permission, a file in its place; no home
        return None
    return directory if stat.S_ISDIR(about.st_mode) and _own(about) else None


def _own(about: os.stat_result) -> bool:
    return about.st_uid == os.geteuid() and not about.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _name(vehicle: config.Vehicle, plan: MotionPlan) -> str:
    """SHA-256 of all that the result depends on."""
    said = hashlib.sha256()
    for part in (np.__version__, scipy.__version__, pinocchio.__version__, *_code()):
        said.update(f"{part}\n".encode())
    said.update(vehicle.file.model_dump_json().encode())
    said.update(vehicle.urdf_text.encode())
    _add(said, plan)
    return said.hexdigest()


def _code() -> list[str]:
    """Name, size and time of every source file: an installed version has one set, a changed checkout another."""
    root = Path(onboard.__path__[0])
    files = [(path, path.stat()) for path in sorted(root.rglob("*.py"))]
    return [f"{path.relative_to(root)} {about.st_size} {about.st_mtime_ns}" for path, about in files]


def _add(said: Any, part: Any) -> None:
    """Numbers and arrays of nested tuples, with their shapes."""
    if isinstance(part, tuple):
        said.update(f"({len(part)}".encode())
        for one in part:
            _add(said, one)
    elif part is None:
        said.update(b"none")
    else:
        array = np.ascontiguousarray(part)
        said.update(f"{array.dtype.str}{array.shape}".encode())
        said.update(array.tobytes())


def _read(path: Path) -> Foreseen | None:
    try:
        file = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return None
    with os.fdopen(file, "rb") as opened:
        about = os.fstat(file)
        if not (stat.S_ISREG(about.st_mode) and _own(about) and about.st_size <= _MOST_BYTES):
            return None
        digest, _, body = opened.read(_MOST_BYTES).partition(b"\n")
    if digest != hashlib.sha256(body).hexdigest().encode():
        return None
    try:
        found = _Found.model_validate(json.loads(body))
    except (ValueError, RecursionError):
        return None
    quantities, parameters = (
        tuple(Expected(**one.model_dump()) for one in those) for those in (found.quantities, found.parameters)
    )
    body_of = found.payload
    payload = None
    if body_of is not None:
        payload = RigidBody(body_of.mass_kg, np.array(body_of.centre_of_mass_m), np.array(body_of.inertia_kg_m2))
    return Foreseen(quantities, parameters, payload, found.span_s, tuple(found.words))


def _write(path: Path, found: Foreseen) -> None:
    payload = None
    if found.payload is not None:
        mass_kg, centre_m, inertia = found.payload
        payload = {"mass_kg": mass_kg, "centre_of_mass_m": centre_m.tolist(), "inertia_kg_m2": inertia.tolist()}
    quantities, parameters = ([one._asdict() for one in those] for those in (found.quantities, found.parameters))
    told: Final = {"quantities": quantities, "parameters": parameters, "payload": payload}
    body = json.dumps(told | {"span_s": found.span_s, "words": found.words}).encode()
    with suppress(OSError):
        file, made = tempfile.mkstemp(dir=path.parent)
        try:
            with os.fdopen(file, "wb") as opened:
                opened.write(hashlib.sha256(body).hexdigest().encode() + b"\n" + body)
            Path(made).replace(path)
        except OSError:
            Path(made).unlink()
            raise
        by_age = sorted(path.parent.iterdir(), key=lambda one: one.lstat().st_mtime_ns)
        for old in by_age[:-_MOST_FILES]:
            old.unlink()
