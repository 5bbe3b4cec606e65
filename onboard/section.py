"""Base class and number types of the sections of a vehicle file. Units are in the keys."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

LARGEST = 1e12  # no quantity of a vehicle is larger, and none but zero smaller than its inverse
Positive = Annotated[float, Field(ge=1 / LARGEST, le=LARGEST)]
NotNegative = Annotated[float, Field(ge=0, le=LARGEST)]
Real = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
Vector3 = tuple[Real, Real, Real]
Vector6 = tuple[Real, Real, Real, Real, Real, Real]
Sigma3 = tuple[NotNegative, NotNegative, NotNegative]
Sigma6 = tuple[NotNegative, NotNegative, NotNegative, NotNegative, NotNegative, NotNegative]


class Section(BaseModel):
    """A table of the file: unknown keys are refused, numbers are finite, values do not change."""

    model_config = ConfigDict(  # bases need no validator
        extra="forbid", frozen=True, defer_build=True, allow_inf_nan=False
    )
