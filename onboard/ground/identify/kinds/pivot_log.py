"""``heft identify`` of a run on a spherical air bearing: the onboard estimator's fit of all ticks."""

from onboard import config
from onboard.estimation.gates import named_refusals
from onboard.flight.estimate.answers import useful_of
from onboard.flight.estimate.estimator import Estimator
from onboard.ground.identify.kinds.identified import Identified, by_axis, judged, standings
from onboard.ground.identify.replay.feed import fed
from onboard.identification.pivot.online import PivotRun
from onboard.identification.verdict import Evidence
from onboard.recording.reader import LogReader


def identify_pivot(vehicle: config.Vehicle, log: LogReader) -> Identified:
    """Estimate of a body on a pivot.

    Raises:
        ConfigError: the estimation section does not fit the URDF or the devices.
        ChannelError: a log of another vehicle.
    """
    estimator = Estimator(vehicle, at_the_end=True)
    run = estimator.online
    assert isinstance(run, PivotRun)
    run.wait()
    fed(estimator, log)
    answers = tuple(
        one._replace(bound=bound) for one, bound in zip(run.estimate().quantities, run.bounds().tolist(), strict=True)
    )
    evidence = Evidence(
        run.rows_used,
        named_refusals(run.refused),
        {one.name: one.supported for one in answers},
        None,
        failure=f"the fit failed: {run.failure}" if run.failure else "",
        findings=run.findings(),
        standings=standings(answers, useful_of(vehicle)),
        unchecked="",  # its windows are held against each other
    )
    misfit = None if run.found is None else max(run.found.by_sensor)
    residuals = {} if run.found is None else by_axis(*run.residuals(), 1.0 / vehicle.file.estimation.row_rate_hz)
    return judged(log, evidence, answers, misfit=misfit, budget=run.budget(), residuals=residuals)
