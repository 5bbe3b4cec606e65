"""Detected changes: of the payload (capture, ejection), of an instrument, or a contact that changes nothing."""

from typing import NamedTuple


class Change(NamedTuple):
    """A detected or announced change."""

    kind: str  # "change" of which the kind is not known yet, then "capture", "ejection", "contact" or "instrument";
    # "release_contradicted", "capture_contradicted"; "left_out", "taken_back" of an instrument
    time_s: float  # time of detection, or of the announcement
    since_s: float  # earliest possible beginning
    score: float  # sum of squared innovations per degree of freedom; NaN if announced
    what: str = ""  # instrument or reason
