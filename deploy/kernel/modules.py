"""Kernel modules by the init_module system call, with what they depend on: this guest has no kmod.

A module names its dependencies in its ``.modinfo`` section as ``depends=a,b``; names are file names with ``-`` or
``_``, which the kernel takes for the same.
"""

import ctypes
import errno
import os
import re
from pathlib import Path

_DEPENDS = re.compile(rb"\0depends=([^\0]*)\0")
_libc = ctypes.CDLL(None, use_errno=True)
_SYS_INIT_MODULE = 175  # x86-64


class Modules:
    """The modules of a directory tree, and which are loaded.

    Args:
        directory: ``.../modules/RELEASE``.
    """

    def __init__(self, directory: Path) -> None:
        self._files = {_plain(path.stem): path for path in directory.rglob("*.ko")}
        self._loaded: set[str] = set()

    def load(self, name: str) -> None:
        """Load a module after those it depends on; one that is loaded already is left.

        Raises:
            FileNotFoundError: There is no such module.
            OSError: The kernel refuses it.
        """
        name = _plain(name)
        if name in self._loaded:
            return
        if name not in self._files:
            raise FileNotFoundError(errno.ENOENT, f"the kernel package has no module {name}")
        image = self._files[name].read_bytes()
        found = _DEPENDS.search(image)
        for other in found[1].decode("ascii").split(",") if found else ():
            if other:
                self.load(other)
        if _libc.syscall(_SYS_INIT_MODULE, image, ctypes.c_ulong(len(image)), b"") != 0:
            code = ctypes.get_errno()
            if code != errno.EEXIST:
                raise OSError(code, f"module {name}: {os.strerror(code)}")
        self._loaded.add(name)


def _plain(name: str) -> str:
    return name.replace("-", "_")
