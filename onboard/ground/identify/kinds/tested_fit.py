"""A tested fit of a whole flight, as what is said of it takes it."""

from collections.abc import Sequence

from onboard.estimation.errors import EstimationError
from onboard.ground.identify.kinds import likelihood_log
from onboard.ground.identify.kinds.residuals import by_axis
from onboard.identification.corrections import doubtful
from onboard.identification.verdict import TOO_SHORT
from onboard.identification.whole_flight.parts import halves
from onboard.identification.whole_flight.stated import bound_of, leans_on
from onboard.identification.whole_flight.witnesses import Tested


def fitted_of(made: Tested, period_s: float, row_names: Sequence[str]) -> likelihood_log.CheckedFit:
    """A fit, its tests as they were within the stated sigmas, and the prediction of its halves.

    Args:
        made: the fit.
        period_s: between ticks.
        row_names: of the lines.
    """
    flight, found = made.flight, made.found
    held_out, unchecked = None, TOO_SHORT
    try:
        held_out = halves(flight, found)
    except EstimationError as error:
        unchecked = likelihood_log.half_too_short(error)
    return likelihood_log.CheckedFit(
        found.payload,
        found.chi,
        found.chi_covariance,
        bound_of(flight, found),
        sum(block.rows for block in found.blocks),
        found.misfit,
        max(1.0, found.misfit, *found.by_instrument.values()),
        made.corrections,
        held_out,
        unchecked,
        by_axis(flight.time_s, found.residuals, period_s, row_names[6:]),
        findings=made.findings.plus(doubts=doubtful(made.of_bodies, "sigmas of what the flight tells of it")),
        leans=leans_on(flight, found),
        outer=found.outer,
    )
