"""Reads the held payload out of a filter: parameters, covariance, and whether it is known."""

import numpy as np

from onboard.dynamics.model.payload import BodyEstimate, body_estimate
from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD, ImuPredictor
from onboard.identification.free_flyer.prediction.joint_noise import NoiseAdded, NoiseCorrection, correction_of
from onboard.identification.free_flyer.prediction.noise_in_gradient import noise_added
from onboard.identification.free_flyer.prediction.ticks import BATCH_TICKS, Ticks
from onboard.identification.free_flyer.recursion.bounded_work import BoundedWork


class Holding(BoundedWork):
    """State of a filter, and whether it is of a payload.

    Args:
        predictor: of the instruments.
        call_ticks: ticks of a call that does not come late.

    Attributes:
        state: mean, (p,), of the parameters that ``predictor`` names; None while nothing is known.
        covariance: (p, p).
        noise_added: what noise of the joints' samples has added since the start, to the payload since the last change:
            see :mod:`~onboard.identification.free_flyer.prediction.noise_in_gradient`.
        held: a payload is held; None while that is not decided.
    """

    def __init__(self, predictor: ImuPredictor, call_ticks: int) -> None:
        super().__init__(call_ticks, predictor.period_s, predictor.no_ticks, flexible=predictor.bends.size > 0)
        self.predictor = predictor
        self.state: FloatArray | None = None
        self.covariance = np.zeros((len(predictor.names), len(predictor.names)))
        self.held: bool | None = None
        self.noise_added = self._noise_before = NoiseAdded.none(len(predictor.names))
        self._noise_rate = np.zeros(
            len(predictor.names)
        )  # its gradient in a batch, mean of about as many as take turns
        self._correction: tuple[FloatArray, NoiseAdded, NoiseCorrection] | None = None  # by covariance and noise
        self._corrected: tuple[FloatArray, NoiseCorrection, FloatArray] | None = None  # by state and correction

    @property
    def holds(self) -> bool:
        """A payload is held and its state known, and no release of it is announced, be it taken in or not."""
        return self.state is not None and bool(self.held) and not self.lets_go

    def estimate(self) -> BodyEstimate | None:
        """The payload in its link's frame; None if none is held or it is still unknown (its mass not positive)."""
        if not self.holds or self.state is None or not self.state[PAYLOAD][0] > 0.0:
            return None
        covariance = self.covariance[PAYLOAD, PAYLOAD] + self.correction.part(PAYLOAD).covariance
        return body_estimate(self.corrected(self.state)[PAYLOAD], covariance)

    def corrected(self, state: FloatArray) -> FloatArray:
        """The filter's state, (p,), without what noise of the joints has done to it; the same array for the same."""
        if not self.noise_added.gradient.any():
            return state
        of, by = self._corrected, self.correction
        if of is None or of[0] is not state or of[1] is not by:
            of = self._corrected = state, by, state + by.shift
        return of[2]

    def _noise_of(self, ticks: Ticks, noise: FloatArray, sigma: FloatArray, use: BoolArray) -> None:
        """Take in what noise of the joints adds to the gradient of a batch, of lines in use, (b, m)."""
        if self.state is not None and ticks.sample_sigma.any():
            turn = round(float(ticks.time_s[0]) / (BATCH_TICKS * self.predictor.period_s))
            added = noise_added(self.predictor, ticks, sigma, use, self.state, turn, noise)
            self.noise_added = self.noise_added.plus(added)
            self._noise_rate = self._noise_rate + (added.gradient - self._noise_rate) / ticks.sample_sigma[0].size

    @property
    def correction(self) -> NoiseCorrection:
        """Of the state, for noise of the joints."""
        of = self._correction
        if of is None or of[0] is not self.covariance or of[1] is not self.noise_added:
            made = correction_of(self.covariance, self.noise_added, self.predictor.stated)
            of = self._correction = self.covariance, self.noise_added, made
        return of[2]
