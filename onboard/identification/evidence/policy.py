"""Prior odds and sizes of faults, and the probabilities from which on an answer reports them.

The other modules of this package compute numbers and contain no limit; the limits are here, each with its source.
"""

LIKELY_SIZE = 0.1
"""One sigma of a wrong scale, of a wrong zero or mounting angle in rad, or of a wrong body: propellant used, a part
exchanged, a knocked load cell. The fault classes of the accuracy campaigns go from 1 to 20 %."""
LIKELY_DELAY_s = 0.01
"""One sigma of a wrong delay: one step of the slower control loops that read encoders, 100 Hz."""
LIKELY_PLACE_m = 0.01
"""One sigma of each coordinate of a joint or IMU that is off the drawing: an additional bracket, spacer or flange."""
FARTHEST_SIZE = 3.0
"""In these sigmas; chance exceeds it in 0.3 % of the cases. A larger error is of another kind (a dead cell, a wrong
sign, half the gain) that no linear model explains: an instrument with such an error is left out entirely."""
ODDS = 1e-2
"""Prior odds that a body, or an instrument's scale, is so wrong, against the file as stated: one flight in a hundred.
The hypothesis becomes the more probable one from 4.6 nats of evidence on."""
ODDS_OF_PART = 2e-3
"""Prior odds of a link, of all links of the arm, of an encoder or an IMU. They hold no consumables and are not opened
between the balance and the flight; what remains is a part exchanged or drawn wrong."""
ODDS_OF_ALL = 3e-3
"""Prior odds that all masses of the file are wrong by one factor: one balance for all of them, or a wrong unit. Motion
and a load cell cannot distinguish it from a scale of that cell: an interval that covers one covers both."""
LEAST_WEIGHT = 1e-3
"""Hypotheses of less probability are left out of the answers: a 99.9 % interval leaves out as much."""
LIKELIER = 0.5
"""Below this probability of the file as stated, the likely faults are named and no answer is rated good."""
STEPS_PER_HOUR = 0.1
"""Rate of steps of a load cell's scale, and of its zero, in flight: a knock, a connector. It equals the rate at which
a change may be detected falsely; a step in the minute of a flight then has the odds of an instrument's part,
:data:`ODDS_OF_PART`."""
