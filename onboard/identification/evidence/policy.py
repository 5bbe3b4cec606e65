"""What is believed before a flight of what may be wrong, and what follows from how probable it is afterwards.

Numbers of the other modules of this package carry no limit; the limits are here, each with its source.
"""

LIKELY_SIZE = 0.1
"""One sigma of a scale that is wrong, of a zero or a housing in rad, or of a body: propellant used, a part exchanged, a
cell knocked. The classes of wrong files that answers are judged by go from 1 to 20 %."""
LIKELY_DELAY_s = 0.01
"""One sigma of a delay that is wrong: one step of the slower control loops that read encoders, 100 Hz."""
LIKELY_PLACE_m = 0.01
"""One sigma of each coordinate of a joint or an IMU that is not where it is drawn: a bracket, spacer or flange more."""
FARTHEST_SIZE = 3.0
"""Of these sigmas, 0.3 % of errors by chance: beyond, it is of another kind (a dead cell, a sign, half a gain), which
no linear model explains; the instrument is then left out as a whole, if any is."""
ODDS = 1e-2
"""That a body, or an instrument's scale, is so wrong, against all being as stated: one flight in a hundred. A
hypothesis is then the likelier one from 4.6 nats of evidence on."""
ODDS_OF_PART = 2e-3
"""The same of a link, of all links of the arm, of an encoder or an IMU: nothing is used up of them, and nobody opens
them between the balance and the flight; a part was exchanged, or drawn wrong."""
ODDS_OF_ALL = 3e-3
"""The same of all masses of the file by one factor, which takes one balance for all of them, or a wrong unit. To the
motion and a cell it is the same as a scale of that cell: what is said of either always covers both."""
LEAST_WEIGHT = 1e-3
"""A hypothesis that is less probable is in no answer: that is what a 99.9 % interval leaves out."""
LIKELIER = 0.5
"""All as stated is no longer believed below this probability: what is wrong is named, and no answer is good."""
STEPS_PER_HOUR = 0.1
"""Of a load cell's scale, and of its zero, in flight: a knock, a connector. As often as a change may be detected
falsely; one in the minute of a flight then has the odds of an instrument's part, :data:`ODDS_OF_PART`."""
