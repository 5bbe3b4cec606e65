"""``[parabola]``: a free-flyer that is let go and caught by hand, in an aircraft's parabolas."""

from onboard.section import Positive, Section


class Parabola(Section):
    """How a log is cut into runs; each is estimated when the flight is over, and the runs are pooled.

    ``low``: specific force of the base's IMU below which the aircraft flies a parabola. ``free``: below which nothing
    holds the vehicle. ``settle``: left out after a release, before a catch and about a bump, a
    contact that lasts no longer. ``shortest``: free flight that is a run.
    """

    low_m_s2: Positive = 3.0
    free_m_s2: Positive = 1.5
    settle_s: Positive = 0.25
    shortest_s: Positive = 3.0
