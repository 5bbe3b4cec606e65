"""Which kernels of OpenBLAS a replay needs: those that the flight computed with.

They add up in an order of their own on each kind of processor. OpenBLAS chooses them when it is loaded, by the
processor or as ``OPENBLAS_CORETYPE`` says, so that a replay with others is another process.
"""

import os
from collections.abc import Sequence

import numpy as np

from onboard.flight.store.flight_log import blas_kernels
from onboard.recording.reader import LogReader

_NEED = {"Nehalem": "X86_V2", "Sandybridge": "X86_V3", "Haswell": "X86_V3", "SkylakeX": "X86_V4"}  # NumPy's names


def kernels_needed(log: LogReader) -> str | None:
    """The kernels of a log, if this process computes with others and this processor has what they need."""
    needed = log.metadata.get("flight", {}).get("blas_kernels", "")
    if needed in (blas_kernels(), os.environ.get("OPENBLAS_CORETYPE")) or _NEED.get(needed) not in _of_this_processor():
        return None
    return needed


def _of_this_processor() -> Sequence[str]:
    """Levels of x86-64 that it has, as NumPy names them; of another processor what that one has."""
    found = np.show_config(mode="dicts")["SIMD Extensions"]
    return [*found.get("baseline", ()), *found.get("found", ())]
