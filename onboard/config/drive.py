"""``[drive]``: the motion that the drives of the vehicle are to play, its limits, and what stops it."""

from typing import Annotated, Literal

from pydantic import Field

from onboard.section import NotNegative, Positive, Section


class Drive(Section):
    """What the drives with ``driven = true`` are sent; see docs/driving.md.

    Nothing is driven unless ``armed``, and then only when the operator (``heft fly --arm``) or the ``phase`` arms it.
    """

    armed: bool = False
    motion: str | None = None
    phase: Annotated[int, Field(ge=0)] | None = None
    mode: Literal["cyclic", "profile"] = "cyclic"
    margin_rad: Positive = 0.05
    rate_rad_s: Positive | None = None
    acceleration_rad_s2: Positive = 5.0
    quick_stop_rad_s2: Positive = 10.0
    following_error_rad: Positive = 0.02
    start_within_rad: Positive = 0.05
    heartbeat_ms: Annotated[int, Field(ge=20, le=1000)] = 100
    sync_limit_ms: Annotated[NotNegative, Field(ge=5, le=1000)] = 25.0
    master_node: Annotated[int, Field(ge=1, le=127)] = 127
    after_stop: Literal["release", "hold"] = "release"
