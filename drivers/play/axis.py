"""One drive as its master has it, of whatever kind and on whatever bus: its limits, its answers, its commands.

Known limit: positions are whole counts within 32 bits; a kind that counts otherwise converts.
"""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Final, Protocol

from drivers.errors import ConfigurationError

RATE_SLACK: Final = 1.25  # of the rate limit, for the drive's control
RATE_WINDOW_NS: Final = 25_000_000
_WRAP, _HALF = 1 << 32, 1 << 31


class DriveTicks(Protocol):
    """What numbers the instants at which drives answer, and are sent something: SYNCs, or rounds of requests.

    Attributes:
        WHAT: What they are, for messages.
    """

    WHAT: ClassVar[str]

    @property
    def tick(self) -> int | None:
        """Number of the last, None before the first."""

    @property
    def host_ns(self) -> int:
        """CLOCK_MONOTONIC at which it was seen."""

    @property
    def period_ns(self) -> int:
        """Time between two."""


class DriveConfig(Protocol):
    """What is read from a drive, by its own kind's configuration."""

    @property
    def name(self) -> str:
        """Its first channel."""

    @property
    def counts_per_revolution(self) -> int:
        """Counts in a revolution of the joint, gear included."""


@dataclass(frozen=True)
class AxisConfig:
    """A drive that is driven; counts are the drive's position units, as it sends them.

    Attributes:
        drive: What is read from it.
        sent: Channel of what it is sent.
        low: Least position, counts.
        high: Largest.
        rate: Largest rate, counts/s.
        acceleration: Of a profile, counts/s2.
        quick_stop: Deceleration, counts/s2.
        following_error: Largest, counts.
        start_within: How far it may stand from where the motion begins, counts.
        holds: It holds its position after a quick stop, instead of being released.
    """

    drive: DriveConfig
    sent: str
    low: int
    high: int
    rate: float
    acceleration: float
    quick_stop: float
    following_error: int
    start_within: int
    holds: bool = False

    def __post_init__(self) -> None:
        if not -_HALF <= self.low < self.high < _HALF:
            text = f"{self.drive.name}: may be between {self.low} and {self.high} counts: a drive counts in 32 bits"
            raise ConfigurationError(f"{text}, the least below the most: correct limits, zero_count or margin")
        if min(self.rate, self.acceleration, self.quick_stop, self.following_error, self.start_within) < 1:
            raise ConfigurationError(f"{self.drive.name}: a limit of less than a count: give larger limits")

    def degrees(self, counts: float) -> float:
        """Of the joint, without sign of the direction of its counts."""
        return 360.0 * counts / abs(self.drive.counts_per_revolution)


class Axis(ABC):
    """One drive, as its master has it.

    Args:
        config: The drive.
        ticks: Numbers the instants that its positions are of.

    Attributes:
        position: Counts, within 32 bits; None before the first.
        now_ns: What is sent is sent at this time.
    """

    ANSWERS: ClassVar[str] = ""  # what it has not answered, for messages
    SHOWS: ClassVar[str]  # what ``shown`` is

    def __init__(self, config: AxisConfig, ticks: DriveTicks) -> None:
        self.config, self.name = config, config.drive.name
        self.position: int | None = None
        self.now_ns = 0
        self._ticks = ticks
        self._past: deque[tuple[float, int]] = deque()  # instants in periods, and positions

    # What it says

    @property
    @abstractmethod
    def is_ready(self) -> bool:
        """Whether it is set up, and says where it is."""

    @property
    @abstractmethod
    def heard_ns(self) -> int:
        """When what came last came that has been missing longest."""

    @property
    @abstractmethod
    def is_enabled(self) -> bool:
        """Whether it follows set points."""

    @property
    @abstractmethod
    def may_move(self) -> bool:
        """Whether it follows set points, or nothing is known of that."""

    @property
    @abstractmethod
    def shown(self) -> str:
        """Its state, for messages."""

    @property
    @abstractmethod
    def has_taken(self) -> bool:
        """Whether it has acknowledged the last way point, which was not confirmed since."""

    @property
    @abstractmethod
    def has_arrived(self) -> bool:
        """Whether it says that it is at its last way point."""

    @abstractmethod
    def not_to_be_armed(self) -> str:
        """Why it must not be enabled; empty while nothing stands against it."""

    @abstractmethod
    def broken(self) -> str:
        """Why it must not go on, by what it says of itself; empty while all is well."""

    @abstractmethod
    def astray(self) -> Iterator[str]:
        """What is wrong with it while it should follow set points."""

    def distance(self, counts: int) -> int:
        """Counts from ``counts`` to where it is, across the end of 32 bits."""
        assert self.position is not None
        return (self.position - counts + _HALF) % _WRAP - _HALF

    def unwell(self, now_ns: int, limit_ns: int) -> str:
        """Why it must not go on, whatever it is sent; empty while all is well."""
        slack = self.config.following_error
        if wrong := self.broken():
            return wrong
        if (silent_ns := now_ns - self.heard_ns) > limit_ns:
            return f"has not answered{self.ANSWERS} for {silent_ns // 1_000_000} ms"
        if self.position is None or not self.config.low - slack <= self.position <= self.config.high + slack:
            return "is outside its limits"
        return self._too_fast()

    def _is_at(self, position: int, instant: float) -> None:
        """Take a position that it has reported, of an instant in periods."""
        self.position = position
        self._past.append((instant, position))

    def _forget(self) -> None:
        """Nothing is known of where it is."""
        self.position = None
        self._past.clear()

    def _too_fast(self) -> str:
        """Its rate between ticks, over a window long enough for the counts; when answers arrived does not matter."""
        window = -(-RATE_WINDOW_NS // self._ticks.period_ns)
        while len(self._past) > 2 and self._past[-1][0] - self._past[1][0] >= window:
            self._past.popleft()
        periods = self._past[-1][0] - self._past[0][0] if self._past else 0
        if periods < window:
            return ""
        per_s = 1e9 / (periods * self._ticks.period_ns)
        rate = abs(self.distance(self._past[0][1])) * per_s
        if rate <= RATE_SLACK * self.config.rate + 2.0 * per_s:
            return ""
        return f"moves at {self.config.degrees(rate):.1f} deg/s, faster than its limit"

    # Commands

    def beat(self) -> None:  # noqa: B027 - most buses need none
        """Say that the master is there, for all drives of its bus."""

    @abstractmethod
    def enable(self) -> None:
        """A step towards following set points, where it stands; it is called until it does."""

    @abstractmethod
    def target(self, counts: int) -> None:
        """Go to a position until the next tick; outside the limits it is cut to them."""

    @abstractmethod
    def way_point(self, counts: int) -> None:
        """Go to a position by a profile of its own, from now on; outside the limits it is cut to them."""

    @abstractmethod
    def confirm(self) -> None:
        """All drives have taken the way point."""

    @abstractmethod
    def quick_stop(self) -> None:
        """Stop, and leave the enabled state as configured; it is called until it has."""

    @abstractmethod
    def cut(self) -> None:
        """Take the current away, now."""

    @abstractmethod
    def hand_over(self) -> None:
        """Pass what it was sent to the reporter."""

    def _held(self, counts: int) -> int:
        return min(max(counts, self.config.low), self.config.high)
