"""Detected changes: of the payload (capture, ejection), of an instrument, or a contact that changes nothing."""

from typing import Final, NamedTuple

CONTACT_s: Final = 0.4  # of contact after a capture is detected: a grip of 4 Hz needs 0.5 s from the touch


class Change(NamedTuple):
    """A detected or announced change."""

    kind: str  # "change" of which the kind is not known yet, then "capture", "ejection", "contact", "instrument" or
    # "altered"; "release_contradicted", "capture_contradicted"; "left_out", "taken_back" of an instrument
    time_s: float  # time of detection, or of the announcement
    since_s: float  # earliest possible beginning
    score: float  # sum of squared innovations per degree of freedom; NaN if announced
    what: str = ""  # instrument or reason
