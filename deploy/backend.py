"""Build backend of heft: setuptools', which compiles onboard/native and asks for ziglang where there is no C compiler.

HEFT_WHEEL_MACHINE=aarch64 or x86_64 makes a wheel for that machine, whichever this one is, with the package ziglang.
"""

import os
import sys
from pathlib import Path
from typing import Any

from setuptools import build_meta
from setuptools.build_meta import *  # noqa: F403 - all hooks but those below
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_py import build_py

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from onboard.native import build  # noqa: E402 - of this checkout, whatever is installed

FOR = os.environ.get("HEFT_WHEEL_MACHINE", "")


def get_requires_for_build_wheel(config_settings: Any = None) -> list[str]:
    """What pip installs before it builds."""
    needed = [build.ZIG] if FOR or not build.system_compilers() else []
    return [*build_meta.get_requires_for_build_wheel(config_settings), *needed]


def get_requires_for_build_editable(config_settings: Any = None) -> list[str]:
    """As for a wheel."""
    return get_requires_for_build_wheel(config_settings)


class BuildPy(build_py):
    """Python's files, and the library beside those of onboard/native."""

    def run(self) -> None:
        """Copy Python's files, and compile."""
        super().run()
        directory = (ROOT if self.editable_mode else Path(self.build_lib)) / "onboard" / "native"
        directory.mkdir(parents=True, exist_ok=True)
        for old in directory.glob("heft-*.so"):
            old.unlink()
        if FOR:
            build.compile_into(directory / build.file_name(FOR), build.zig(FOR))
        else:
            build.build(directory)


class Wheel(bdist_wheel):
    """Of any Python 3, for one machine: an installation puts it where files of one machine go."""

    def finalize_options(self) -> None:
        """Say so, though setuptools itself compiles nothing."""
        self.distribution.has_ext_modules = lambda: True
        super().finalize_options()

    def get_tag(self) -> tuple[str, str, str]:
        """Python, ABI and platform."""
        return "py3", "none", f"manylinux_2_28_{FOR}" if FOR else super().get_tag()[2]
