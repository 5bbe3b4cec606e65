"""``[parabolas]``: a free-flyer in an aircraft that flies parabolas, released and caught by hand.

The sequence of the mission follows from it: each run is a parabola in which the arm moves while the vehicle is let go.
"""
# ruff: noqa: N815 - field names are the file's keys, and a key ends in its SI symbol

from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import Field, PositiveFloat, PositiveInt, model_validator

from hil_sim.scenario.sensor_tables import Fraction, NonNegative, Table

JOINED = {"pitch": ("pitch",), "yaw": ("yaw",), "both": ("pitch", "yaw")}  # what moves at the same time
Range = tuple[NonNegative, NonNegative]


class ParabolicRuns(Table):
    """``[[parabolas.run]]``: so many parabolas in succession with one motion of the arm."""

    joints: Literal["pitch", "yaw", "pitch_then_yaw", "both"]
    speed: Literal["slow", "medium", "fast"]
    runs: PositiveInt = 1

    @property
    def label(self) -> str:
        """``fast pitch``."""
        return f"{self.speed} {self.joints.replace('_', ' ')}"


class TipMotionTable(Table):
    """``[parabolas.pitch]``, ``[parabolas.yaw]``: a joint, and how far the tip of the arm is from its axis."""

    joint: str
    reach_m: PositiveFloat


class Parabolas(Table):
    """The aircraft's parabolas, what the operators do in each, and how the arm moves.

    ``strapped``: the first is flown strapped down to the floor, and the arm rests. ``tip_m_s``: of slow, medium and
        fast motions; ``strokes``: how often each goes out and back within ``motion_s``.
    ``release_s``, ``motion_at_s``, ``catch_s``: from the begin of free fall. ``early``: share of the runs that are
        caught in mid-motion. ``bumps``: share in which something pushes the vehicle.
    ``jitter``, ``vibration``: of the aircraft, slow and at 5 to 40 Hz, rms by axis; ``hand``, ``tremor``: of the
        operator who carries the vehicle, slow and at 6 to 11 Hz. ``launch``: sigmas of its motion against the cabin
        when it is let go. ``pitch_rad_s``: of the aircraft in free fall.
    """

    run: Annotated[tuple[ParabolicRuns, ...], Field(min_length=1)]
    strapped: bool = True
    pull_m_s2: PositiveFloat = 17.65
    pull_s: PositiveFloat = 8.0
    change_s: PositiveFloat = 2.0
    low_s: PositiveFloat = 22.0
    tip_m_s: tuple[PositiveFloat, PositiveFloat, PositiveFloat] = (0.05, 0.10, 0.25)
    strokes: tuple[PositiveInt, PositiveInt, PositiveInt] = (1, 2, 3)
    pitch: TipMotionTable
    yaw: TipMotionTable
    release_s: Range = (3.0, 4.5)
    motion_at_s: PositiveFloat = 5.5
    motion_s: PositiveFloat = 12.0
    catch_s: Range = (18.2, 20.0)
    early: Fraction = 0.1
    bumps: Fraction = 0.4
    bump_N_s: Range = (0.4, 4.0)
    launch_rate_rad_s: NonNegative = 0.06
    launch_velocity_m_s: NonNegative = 0.05
    pitch_rad_s: NonNegative = 0.06
    jitter_m_s2: NonNegative = 0.15
    vibration_m_s2: NonNegative = 0.12
    hand_m_s2: NonNegative = 0.15
    tremor_m_s2: NonNegative = 0.05

    @model_validator(mode="after")
    def _in_order(self) -> "Parabolas":
        times = 0.0, *self.release_s, self.motion_at_s, self.motion_at_s + self.motion_s, *self.catch_s, self.low_s
        if list(times) != sorted(times):
            raise ValueError("release_s, motion_at_s + motion_s, catch_s and low_s must come in this order")
        if self.pitch.joint == self.yaw.joint:
            raise ValueError("pitch and yaw are two joints")
        return self

    @property
    def flown(self) -> tuple[ParabolicRuns | None, ...]:
        """What is done in each parabola; None: strapped down."""
        runs = [one for one in self.run for _ in range(one.runs)]
        return (None, *runs) if self.strapped else tuple(runs)

    @property
    def period_s(self) -> float:
        """Of a parabola with the pull before it."""
        return self.pull_s + 2.0 * self.change_s + self.low_s

    @property
    def starts_s(self) -> tuple[float, ...]:
        """Mission time at which free fall begins, of each parabola."""
        first = self.pull_s + self.change_s
        return tuple(first + k * self.period_s for k in range(len(self.flown)))

    def sequence(self) -> list[dict[str, Any]]:
        """``[[sequence]]`` of the mission: phase 1 while the arm moves, 0 otherwise, 9 at the end."""
        steps = [step for one in self.flown for step in self._of_one(one)]
        return [*steps, {"phase": 9, "action": "hold", "duration_s": self.pull_s}]

    def _of_one(self, run: ParabolicRuns | None) -> Iterator[dict[str, Any]]:
        if run is None:
            yield {"phase": 0, "action": "hold", "duration_s": self.period_s}
            return
        before_s = self.pull_s + self.change_s + self.motion_at_s
        yield {"phase": 0, "action": "hold", "duration_s": before_s}
        parts = ("pitch", "yaw") if run.joints == "pitch_then_yaw" else (run.joints,)
        for part in parts:
            yield self._sweep(JOINED[part], run.speed, len(parts))
        yield {"phase": 0, "action": "hold", "duration_s": self.period_s - before_s - self.motion_s}

    def _sweep(self, which: tuple[str, ...], speed: str, parts: int) -> dict[str, Any]:
        level = ("slow", "medium", "fast").index(speed)
        moved = [{"pitch": self.pitch, "yaw": self.yaw}[name] for name in which]
        share = len(moved) ** -0.5  # two joints together: the tip has the same speed
        strokes = max(1, self.strokes[level] // parts)
        rates = {one.joint: share * self.tip_m_s[level] / one.reach_m for one in moved}
        duration_s = self.motion_s / parts
        return {"phase": 1, "action": "sweep", "duration_s": duration_s, "rates": rates, "strokes": strokes}
