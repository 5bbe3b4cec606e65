"""What an estimator has noticed of the payload: that it came, or went, or that neither was so."""

from typing import NamedTuple


class Change(NamedTuple):
    """Something happened."""

    kind: str  # "capture", "ejection" as far as can be told at once; "contact" when nothing came or went after all
    time_s: float  # when it was found, or told
    since_s: float  # when it may have begun
    score: float  # of the innovations, sum of squares per degree of freedom; NaN when told
