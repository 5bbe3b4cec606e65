"""Structures of ``src/heft_native.h`` and of the files beside it, with the arrays that they point to."""

import ctypes
from typing import Any, ClassVar

from onboard.native.library import FloatArray, IndexArray, address


class _Structure(ctypes.Structure):
    """Numbers and arrays, in the order of the C structure; the arrays are kept as long as it."""

    NUMBERS: ClassVar[int] = 0

    def __init__(self, *values: "int | FloatArray | IndexArray | _Structure | None") -> None:
        count = self.NUMBERS
        self.made_of, self.kept = values, values[count:]
        super().__init__(*values[:count], *map(address, self.kept))  # type: ignore[arg-type]

    def __reduce__(self) -> tuple[Any, ...]:
        """A copy, also one in another process, points to arrays of its own."""
        return type(self), self.made_of


def _fields(numbers: str, arrays: str) -> list[tuple[str, Any]]:
    first = [(name, ctypes.c_int64) for name in numbers.split()]
    return [*first, *((name, ctypes.c_void_p) for name in arrays.split())]


class TreeStruct(_Structure):
    """``heft_tree``."""

    NUMBERS = 2
    _fields_ = _fields("joints links", "parent body seat_axes seat_origin axis turned revolute link_axes link_origin")


class MovingFrames(_Structure):
    """``heft_frames``."""

    NUMBERS = 2
    _fields_ = _fields("n links", "R p V A chi")


class Pushed(_Structure):
    """``heft_push``."""

    NUMBERS = 1
    _fields_ = _fields("count", "of_each gain")


class ColumnsStruct(_Structure):
    """``heft_columns``."""

    NUMBERS = 1
    _fields_ = _fields("count", "links bases")


class ErrorsStruct(_Structure):
    """``heft_errors``."""

    NUMBERS = 2
    _fields_ = _fields("joints functions", "beyond stays of")


class MovingStruct(_Structure):
    """``heft_moving``."""

    NUMBERS = 3
    _fields_ = _fields("n links total", "R p parts twist along by_rate by_wrench screws functions")


class Cut(_Structure):
    """``heft_cut``."""

    NUMBERS = 2
    _fields_ = _fields("carried_by columns", "group is_beyond R p projection")


class BaseStruct(_Structure):
    """``heft_base``."""

    NUMBERS = 2
    _fields_ = _fields("n total", "rate acceleration specific_force by_rate by_wrench along")


class Read(_Structure):
    """``heft_readings``."""

    NUMBERS = 4
    _fields_ = _fields("n joints functions taken", "q dq ddq cyclic of errors multiples")


class ReadTicks(_Structure):
    """``heft_read_ticks``."""

    NUMBERS = 4
    _fields_ = _fields("ticks total count used", "gains gain along values d_errors measured sigma places use")


class SamplesStruct(_Structure):
    """``heft_samples``."""

    NUMBERS = 4
    _fields_ = _fields("count ticks columns gap", "times_s at_s values delays_s noise wrong")


class UnderKernel(_Structure):
    """``heft_windows``."""

    NUMBERS = 3
    _fields_ = _fields("samples ticks length", "times_s at_s low high")


class AirBearingRun(_Structure):
    """``heft_table``."""

    NUMBERS = 3
    _fields_ = _fields("ticks free pucks", "inverse known growth over columns puck others")


class PredictorStruct(_Structure):
    """``heft_predictor``."""

    NUMBERS = 17
    _fields_ = _fields(
        "states unknowns joints links thrusters disturbed imus cells lines motion changing drifting pushes "
        "links_at joints_at cyclic_at thrusters_at",
        "tree columns errors estimated bodies chi drawn factor wrenches frames imu cell own own_here own_there "
        "runs samples changes drifts of push",
    )


class NoiseStruct(_Structure):
    """``heft_noise``."""

    NUMBERS = 3
    _fields_ = _fields("imus cells lines", "tree beyond frames free")


class BankStruct(_Structure):
    """``heft_bank``."""

    NUMBERS = 4
    _fields_ = _fields("states suspects columns places", "count width at slopes inner")
