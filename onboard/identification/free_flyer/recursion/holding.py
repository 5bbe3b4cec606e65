"""Reads the held payload out of a filter: parameters, covariance, and whether it is known."""

import numpy as np

from onboard.dynamics.model.payload import BodyEstimate, body_estimate
from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.identification.evidence.mixture import Known
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD, ImuPredictor
from onboard.identification.free_flyer.prediction.joint_noise import NoiseAdded, NoiseCorrection, correction_of
from onboard.identification.free_flyer.prediction.line_noise import LineNoise
from onboard.identification.free_flyer.prediction.noise_in_gradient import noise_added
from onboard.identification.free_flyer.prediction.ticks import TickPrediction, Ticks
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
        # by state, covariance and noise
        self._correction: tuple[FloatArray, FloatArray, NoiseAdded, NoiseCorrection] | None = None
        self._known: tuple[NoiseCorrection, Known] | None = None  # by correction

    @property
    def holds(self) -> bool:
        """A payload is held and its state known, and no release of it is announced, be it taken in or not."""
        return self.state is not None and bool(self.held) and not self.lets_go

    def estimate(self) -> BodyEstimate | None:
        """The payload in its link's frame; None if none is held or it is still unknown (its mass not positive)."""
        if not self.holds or self.state is None or not self.state[PAYLOAD][0] > 0.0:
            return None
        (mean, covariance), doubt = self.known, self.correction.sigma[PAYLOAD]
        return body_estimate(mean[PAYLOAD], covariance[PAYLOAD, PAYLOAD] + np.outer(doubt, doubt))

    @property
    def known(self) -> Known:
        """Mean, (p,), and covariance, (p, p), without what noise of the joints has done; the same for the same."""
        assert self.state is not None
        if not (self.noise_added.information.size or self.noise_added.gradient.any()):
            return self.state, self.covariance
        of, by = self._known, self.correction
        if of is None or of[0] is not by:
            of = self._known = by, (self.state + by.shift, self.covariance + by.root @ by.root.T)
        return of[1]

    def _noise_of(
        self, ticks: Ticks, noise: FloatArray, lines: LineNoise, use: BoolArray, at: tuple[FloatArray, TickPrediction]
    ) -> NoiseAdded:
        """Take in what noise of the joints adds in a batch, of lines in use, (b, m), predicted at a state; that."""
        if self.state is not None and ticks.sample_sigma.any():
            first = round(float(ticks.time_s[0]) / self.predictor.period_s)
            added = noise_added(self.predictor, ticks, lines, use, self.state, first, noise, at=at)
            self.noise_added = self.noise_added.plus(added.moved(-self.predictor.lasting * self.state))
            return added
        return NoiseAdded.none(len(self.predictor.names))

    @property
    def correction(self) -> NoiseCorrection:
        """Of the state, for noise of the joints."""
        assert self.state is not None
        of = self._correction
        if of is None or of[0] is not self.state or of[1] is not self.covariance or of[2] is not self.noise_added:
            raw = self.state, self.covariance
            here = self.noise_added.moved(self.predictor.lasting * self.state)
            made = correction_of(raw, here, self.predictor.constant, self._released)
            of = self._correction = *raw, self.noise_added, made
        return of[3]

    @property
    def _released(self) -> FloatArray | None:
        """Root of the information that is stated and not taken for granted, (p, r)."""
        return None
