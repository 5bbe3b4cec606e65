"""Signals for the page, of devices and of the estimator: of each the lowest and highest sample of every step of time.

The steps become twice as long whenever there are too many, so a flight of any length takes the same memory, and no
peak is left out. Samples that the device calls not valid are.
"""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.records import IMU, POSE, SCALAR, Rows, SampleStatus
from onboard.channels import INNOVATION
from onboard.estimation.gates import GateReason
from onboard.recording.format.texts import printable

STEPS = 1200  # of a signal at most
STEP_NS = 50_000_000  # at first

_Kind = tuple[str, str, tuple[str, ...]]  # quantity, unit, components
_KINDS: dict[np.dtype[np.void], tuple[_Kind, ...]] = {
    IMU: (("specific force", "m/s^2", ("x", "y", "z")), ("rate", "rad/s", ("x", "y", "z"))),
    POSE: (("position", "m", ("x", "y", "z")), ("attitude", "1", ("w", "x", "y", "z"))),
}
_ERRORS: tuple[_Kind, ...] = (("rate", "sigma", ("x", "y", "z")), ("specific force", "sigma", ("x", "y", "z")))
_LINE: tuple[_Kind, ...] = (("", "sigma", ("",)),)
_ROWS: tuple[_Kind, ...] = (("rows", "%", ("used", "contradicting")),)


@dataclass
class _Channel:
    """Steps of one device: their number, and of each column the lowest and the highest."""

    kinds: tuple[_Kind, ...]
    every_ns: int = STEP_NS
    steps: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))  # (n,) times every_ns
    low: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 0), np.float32))  # (n, columns)
    high: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 0), np.float32))

    def add(self, at_ns: NDArray[np.int64], values: NDArray[np.float32]) -> None:
        steps = np.maximum.accumulate(at_ns // self.every_ns)
        if not len(self.steps):
            self._merge(steps, values, values)
            return
        steps = np.maximum(steps, self.steps[-1])
        last = slice(-1, None)  # what came before it is complete
        joined = [np.concatenate(pair) for pair in ((self.low[last], values), (self.high[last], values))]
        before = self.steps[:-1], self.low[:-1], self.high[:-1]
        self._merge(np.concatenate((self.steps[last], steps)), *joined)
        self.steps = np.concatenate((before[0], self.steps))
        self.low, self.high = np.concatenate((before[1], self.low)), np.concatenate((before[2], self.high))
        while len(self.steps) > STEPS:
            self.every_ns *= 2
            self._merge(self.steps // 2, self.low, self.high)

    def _merge(self, steps: NDArray[np.int64], low: NDArray[np.float32], high: NDArray[np.float32]) -> None:
        first = np.flatnonzero(np.diff(steps, prepend=steps[0] - 1))
        self.steps, self.low = steps[first], np.minimum.reduceat(low, first)
        self.high = np.maximum.reduceat(high, first)


class PageSignals:
    """Of all devices. Names are ``CHANNEL QUANTITY``, for example ``imu_0 rate``."""

    def __init__(self) -> None:
        self._channels: dict[str, _Channel] = {}

    def add(self, name: str, rows: Rows) -> None:
        """Take in rows of a device, of the regression, of prediction errors; those of a kind not known are left out."""
        if "gate" in (rows.dtype.names or ()):
            gate = rows["gate"].reshape(len(rows), -1)  # (n, lines of the regression)
            against = gate & (GateReason.RESIDUAL | GateReason.LEFT_OUT) != 0
            self._add(name, _ROWS, rows, 100.0 * np.stack([(gate == 0).mean(axis=1), against.mean(axis=1)], axis=1))
            if "innovation" in (rows.dtype.names or ()):
                for number, line in enumerate(rows["innovation"].reshape(len(rows), -1).T, 1):
                    self._add(f"innovation line {number}", _LINE, rows, line[:, None])
            return
        if rows.dtype == INNOVATION:
            with np.errstate(divide="ignore", invalid="ignore"):
                self._add("innovation", _ERRORS, rows, rows["error"] / rows["sigma"])
            return
        if "status" not in (rows.dtype.names or ()):
            return
        rows = rows[(rows["status"] & SampleStatus.NOT_VALID) == 0]
        if not len(rows):
            return
        if rows.dtype == SCALAR:
            values = (rows["value_raw"] * rows["scale"])[:, None]
            kinds: tuple[_Kind, ...] = (("", printable(rows["unit"][0]), ("",)),)
        elif rows.dtype == IMU:
            force, rate = rows["accel_scale_m_s2"][:, None], rows["gyro_scale_rad_s"][:, None]
            values = np.hstack((rows["accel_raw"] * force, rows["gyro_raw"] * rate))
            kinds = _KINDS[IMU]
        elif rows.dtype == POSE:
            values, kinds = np.hstack((rows["position_m"], rows["quaternion"])), _KINDS[POSE]
        else:
            return
        self._add(name, kinds, rows, values)

    def _add(self, name: str, kinds: tuple[_Kind, ...], rows: Rows, values: NDArray[np.float64]) -> None:
        known = np.isfinite(values).all(axis=1)
        if known.any():
            channel = self._channels.setdefault(name, _Channel(kinds))
            channel.add(rows["host_ns"][known], values[known].astype(np.float32))

    def names(self) -> list[str]:
        """Of all signals so far; those without a unit of physics, such as phases, are last."""
        found = [
            (unit in ("1", "%", "sigma"), _name(its, kind))
            for its, one in self._channels.items()
            for kind, unit, _ in one.kinds
        ]
        return [name for _, name in sorted(found)]

    def of(self, name: str, start_ns: int, since_s: float = -math.inf) -> dict[str, Any]:
        """Unit, components, length of a step (s), and the steps that end after ``since_s``.

        A step is its begin (seconds since ``start_ns``), then the lowest and the highest sample of each component.

        Raises:
            KeyError: there is no such signal.
        """
        for its, channel in self._channels.items():
            first = 0
            for kind, unit, components in channel.kinds:
                columns = slice(first, first := first + len(components))
                if _name(its, kind) != name:
                    continue
                at_s = np.round((channel.steps * channel.every_ns - start_ns) * 1e-9, 3)
                new = at_s + channel.every_ns * 1e-9 > since_s + 1e-6  # a step that has only begun is sent again
                at_s, low, high = at_s[new], channel.low[new, columns], channel.high[new, columns]
                ends = np.stack((low, high), axis=2).reshape(len(at_s), 2 * len(components))
                points = [[t, *map(_short, row)] for t, row in zip(at_s.tolist(), ends.tolist(), strict=True)]
                return {"unit": unit, "components": components, "every_s": channel.every_ns * 1e-9, "points": points}
        raise KeyError(name)


def _name(channel: str, kind: str) -> str:
    return f"{channel} {kind}".strip()


def _short(value: float) -> float:
    """To six digits, which is all that single precision has; a third of the bytes."""
    return value if not value or not math.isfinite(value) else float(f"{value:.6g}")
