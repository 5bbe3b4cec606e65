"""Interface of the onboard estimators, and the changes that they detect."""

from typing import Final, NamedTuple, Protocol

from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.gates import GateReason, ReasonArray
from onboard.identification.quantities import Estimate, Findings
from onboard.regressor.signals import Signals

CONTACT_s: Final = 0.4  # of contact after a capture is detected: a grip of 4 Hz needs 0.5 s from the touch


class Change(NamedTuple):
    """A detected or announced change: of the payload, of an instrument, or a contact that changes nothing."""

    kind: str  # "change" of which the kind is not known yet, then "capture", "ejection", "contact", "instrument" or
    # "altered"; "release_contradicted", "capture_contradicted"; "left_out", "taken_back" of an instrument
    time_s: float  # time of detection, or of the announcement
    since_s: float  # earliest possible beginning
    score: float  # sum of squared innovations per degree of freedom; NaN if announced
    what: str = ""  # instrument or reason


class OnlineIdentifier(Protocol):
    """Processes ticks as they arrive and gives the estimate at any time."""

    @property
    def rows_used(self) -> int:
        """That went into the answers."""

    @property
    def refused(self) -> dict[GateReason, int]:
        """Rows by reason; a row with two reasons counts in both."""

    @property
    def row_names(self) -> tuple[str, ...]:
        """Names of the columns of ``measured``."""

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the state's parameters."""

    @property
    def quantity_names(self) -> tuple[str, ...]:
        """Names of the further quantities."""

    def update(self, signals: Signals, attached: BoolArray, excluded: ReasonArray) -> ReasonArray:
        """Process new ticks; returns gate reasons by tick and row, (n, rows)."""

    def finish(self) -> None:
        """Nothing more arrives: do what updates have left to be done later."""

    def estimate(self) -> Estimate:
        """State and quantities with two-sided 95 % intervals."""

    def triangle(self) -> FloatArray:
        """Square-root information ``[R z]``, (s, s); zeros where there is none."""

    def news(self) -> tuple[Change, ...]:
        """Changes detected since the last call."""

    def findings(self) -> Findings:
        """Findings about the estimates that their intervals do not contain."""
