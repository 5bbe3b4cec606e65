"""Detected changes of the payload: capture, ejection, or a contact without a change."""

from typing import NamedTuple


class Change(NamedTuple):
    """A detected or announced change."""

    kind: str  # "capture", "ejection" as first classified; "contact" if the payload turned out unchanged;
    # "release_contradicted"; "left_out", "taken_back" of an instrument
    time_s: float  # time of detection, or of the announcement
    since_s: float  # earliest possible beginning
    score: float  # sum of squared innovations per degree of freedom; NaN if announced
    what: str = ""  # instrument or reason
