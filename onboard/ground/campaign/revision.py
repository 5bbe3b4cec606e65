"""The revision of the code that a result depends on: a hash of its files and of the versions of what computes for it.

A commit's name would do for a clean checkout alone; this does for an installed package and for edited files too.
Commands, pages and what looks after a campaign do not count: they change no answer.
"""

import hashlib
import importlib.util
from functools import cache
from importlib import metadata
from pathlib import Path

_ROOT = Path(__file__).parents[3]
_ROOMS = ("drivers", "onboard", "hil_sim")
_HERE = "onboard/ground/campaign/"
_OTHERS = (
    *("onboard/cli/", "onboard/live/", "onboard/page/", "onboard/ground/report/"),
    *(f"{_HERE}{name}.py" for name in ("engine", "store", "statistics", "view", "plan_file")),
)
_KINDS = {".py", ".toml", ".urdf"}
_LIBRARIES = ("numpy", "scipy", "filterpy", "pin", "mujoco", "mcap")


@cache
def revision(called: str = "") -> str:
    """Twelve hexadecimal digits.

    Args:
        called: ``package.module:function`` that flies; the files of its folder count too.
    """
    made = hashlib.sha256()
    for name in _LIBRARIES:
        made.update(f"{name} {_version(name)}\n".encode())
    folders = [_ROOT / room for room in _ROOMS]
    if called:
        found = importlib.util.find_spec(called.partition(":")[0])
        folders += [Path(found.origin).parent] if found is not None and found.origin else []
    for folder in folders:
        for path in sorted(path for path in folder.rglob("*") if path.suffix in _KINDS):
            place = path.relative_to(folder.parent).as_posix()
            if not place.startswith(_OTHERS):
                made.update(f"{place} {hashlib.sha256(path.read_bytes()).hexdigest()}\n".encode())
    return made.hexdigest()[:12]


def _version(library: str) -> str:
    try:
        return metadata.version(library)
    except metadata.PackageNotFoundError:
        return "none"
