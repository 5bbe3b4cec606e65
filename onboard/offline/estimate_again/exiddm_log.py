"""``heft identify --method exiddm``: a free-flyer's log by maximum likelihood.

The onboard estimator processes the log, detects capture and release and makes the ticks; the longest interval with one
payload is then fitted in one batch (:mod:`onboard.offline.estimate_again.likelihood_log`), with the momentum of each
held-out half re-estimated.
"""

import numpy as np

from onboard import config
from onboard.estimation.arrays import BoolArray
from onboard.estimation.gates import ReasonArray
from onboard.flight.estimator import Estimator
from onboard.flight.identification import build_exiddm, exiddm_prior, samples_per_tick
from onboard.flight.roles import roles_of
from onboard.identification.exiddm.batch import Exiddm
from onboard.identification.exiddm.free_base import free_exiddm
from onboard.identification.exiddm.online import ExiddmIdentifier
from onboard.identification.exiddm.ticks import Ticks, ticks_of
from onboard.offline.estimate_again.feed import feed
from onboard.offline.estimate_again.identified import Identified
from onboard.offline.estimate_again.likelihood_log import Judged, Kept, identified, longest_held
from onboard.recording.reader import LogReader
from onboard.regressor.signals import Signals


class _Recorder(ExiddmIdentifier):
    """The onboard identifier, which also keeps its ticks."""

    def __init__(self, online: ExiddmIdentifier, joints: int) -> None:
        super().__init__(online.exiddm)
        self.kept: list[Ticks] = [Ticks.none(joints)]

    def update(self, signals: Signals, attached: BoolArray, excluded: ReasonArray) -> ReasonArray:
        found = super().update(signals, attached, excluded)
        measured = np.where(found == 0, signals.measured, np.nan)
        self.kept.append(ticks_of(signals, measured))
        return found


def identify_exiddm(vehicle: config.Vehicle, log: LogReader) -> Identified:
    """Estimate of the payload that a free-flyer held the longest.

    Raises:
        ConfigError: the estimation section does not fit the URDF or the devices.
        ChannelError: a log of another vehicle.
    """
    online, model = build_exiddm(vehicle)
    recorder = _Recorder(online, len(model.joints))
    for _ in feed(Estimator(vehicle, recorder), log):
        pass
    settings, samples, frame = vehicle.file.estimation, samples_per_tick(vehicle), roles_of(vehicle).imu.frame
    period_s = 1.0 / settings.row_rate_hz
    links, imu_prior, payload_sigma = exiddm_prior(vehicle, model)
    held = settings.exiddm.held_at_start or settings.carried is not None
    ticks = longest_held(recorder.kept, online.exiddm.changes, held, period_s)
    refused = {str(reason.name).lower(): count for reason, count in recorder.refused.items() if count}
    idle = {"while nothing was held": recorder.rows_used}

    def build(some: Ticks, first: bool) -> Exiddm:
        return free_exiddm(model, frame, some.flight(period_s, samples), payload_sigma, links, imu_prior)

    kept = Kept(log, str(model.spec.payload_link), ticks, period_s, refused, idle)
    return identified(kept, build, lambda found, wider: Judged())
