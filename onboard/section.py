"""Base class and number types of the sections of a vehicle file. Units are in the keys."""

from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

LARGEST = 1e12  # no quantity of a vehicle is larger, and none but zero smaller than its inverse
Positive = Annotated[float, Field(ge=1 / LARGEST, le=LARGEST)]
NotNegative = Annotated[float, Field(ge=0, le=LARGEST)]
ZeroCount = Annotated[int, Field(ge=-(2**32), le=2**32)]  # of instruments that count in 32 bits, with a sign or none
Real = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
Vector3 = tuple[Real, Real, Real]
Vector6 = tuple[Real, Real, Real, Real, Real, Real]
Sigma3 = tuple[NotNegative, NotNegative, NotNegative]
IDENTITY = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


def _near_one(value: float) -> float:
    if not 0.5 <= abs(value) <= 2.0:
        raise ValueError("a gain is near 1 or -1; correct the unit or the counts instead")
    return value


def _directed(axis: Vector3) -> Vector3:
    if not any(axis):
        raise ValueError("needs a direction: give at least one component")
    return axis


def _invertible(matrix: tuple[Vector3, Vector3, Vector3]) -> tuple[Vector3, Vector3, Vector3]:
    for row, own in enumerate(matrix):
        others = sum(abs(value) for column, value in enumerate(own) if column != row)
        if not 0.5 <= own[row] <= 2.0 or others >= 0.5:
            raise ValueError("its rows are near those of the unit matrix: scales on the diagonal, small angles beside")
    return matrix


Direction = Annotated[Vector3, AfterValidator(_directed)]
Gain = Annotated[float, AfterValidator(_near_one)]
Matrix3 = Annotated[tuple[Vector3, Vector3, Vector3], AfterValidator(_invertible)]
Sigma6 = tuple[NotNegative, NotNegative, NotNegative, NotNegative, NotNegative, NotNegative]


class Section(BaseModel):
    """A table of the file: unknown keys are refused, numbers are finite, values do not change."""

    model_config = ConfigDict(  # bases need no validator
        extra="forbid", frozen=True, defer_build=True, allow_inf_nan=False
    )
