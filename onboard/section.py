"""What the sections of a vehicle file share: number types and their base class. Units stand in the keys."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Vector3 = tuple[float, float, float]
Vector6 = tuple[float, float, float, float, float, float]
Sigma3 = tuple[NotNegative, NotNegative, NotNegative]
Sigma6 = tuple[NotNegative, NotNegative, NotNegative, NotNegative, NotNegative, NotNegative]


class Section(BaseModel):
    """A table of the file: unknown keys are refused, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)  # bases need no validator
