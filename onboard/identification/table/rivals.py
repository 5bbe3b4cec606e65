"""What of a run's encoders may not be as stated, weighed by :mod:`onboard.identification.evidence.bank`.

Of each encoder the zero, the scale or the delay, and the scale from some time on (a coupling, a counter). With r the
residuals and B their derivative after :func:`joint_step`, P the covariance, and h what an error of one sigma changes
the residuals by, the estimate moves by ``-P B'h`` for it; gradient and information of its size are ``-h'r`` and ``h'h -
h'B P B'h``. Residuals above the noise count by so much less. The answer is the mixture of all that counts. Where a
fault is more probable than the file as stated, the run is fitted anew about each of the likeliest, with that error
taken out, and these are weighed by the squares that are left: about an estimate that is ten sigmas off, of a scale that
is 5 % off, the residuals are not linear. About the best all others are weighed again.

Errors of the joints, cyclic ones of their encoders too, are further unknowns of a run. They are milliradians and
millimetres, so the residuals are linear in them: with J the derivative of the whitened residuals r by the fitted
parameters x, G that by the errors z (by differences of their stated sigmas), and L and Z the prior information about
zero, one Gauss-Newton step

    [dx; z] = -[J'J + L, J'G; G'J, G'G + Z]^-1 [J'r + L x; G'r]

gives the estimate with the errors fitted too, and the inverse is the covariance of both (derived here).
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from onboard.dynamics.joint_errors import JOINT_ERRORS, PER_JOINT
from onboard.dynamics.model.errors import ModelError
from onboard.estimation.arrays import FloatArray
from onboard.estimation.errors import EstimationError
from onboard.estimation.maximum_likelihood import Fit, inverse_of
from onboard.estimation.policy import (
    FARTHEST_SIZE,
    LEAST_WEIGHT,
    LIKELIER,
    LIKELY_SIZE,
    ODDS_OF_PART,
    STEPS_PER_HOUR,
    LIKELY_DELAY_s,
)
from onboard.identification.corrections import expected_sigma
from onboard.identification.evidence.bank import Bank, Changed, Suspect, Weighed
from onboard.identification.evidence.mixture import Known, Mixture
from onboard.identification.free_flyer.batch import PayloadFit
from onboard.identification.quantities import Findings
from onboard.identification.table.air_bearing import TableFit


class JointCorrections(NamedTuple):
    """Fitted errors of joints, k of them."""

    names: tuple[str, ...]
    values: FloatArray  # (k,)
    stated: FloatArray  # (k,) their sigmas before the run
    sigma: FloatArray  # (k,) after it

    @property
    def in_stated_sigmas(self) -> dict[str, float]:
        """By name."""
        return dict(zip(self.names, (self.values / self.stated).tolist(), strict=True))

    @property
    def in_told_sigmas(self) -> dict[str, float]:
        """By name, in sigmas of what the data tell: :mod:`onboard.identification.corrections`."""
        return dict(
            zip(self.names, (self.values / expected_sigma(self.stated**2, self.sigma**2)).tolist(), strict=True)
        )


class Step(NamedTuple):
    """One Gauss-Newton step of parameters and errors of joints, and of c further errors of one sigma each."""

    fit: Fit  # of the parameters, (p,)
    joints: JointCorrections
    covariance: FloatArray  # (p + k + c, p + k + c)
    left: FloatArray  # (m,) residuals after it
    derivative: FloatArray  # (m, p + k + c) of these
    further: FloatArray  # (c,) sizes of the further errors, beyond those that they are at


def joint_step(run: TableFit, found: Fit, further: FloatArray | None = None, at: FloatArray | None = None) -> Step:
    """The step, as this module's head says.

    Args:
        run: its fit.
        found: its fit of all ticks, joints exact.
        further: (m, c) derivative of the residuals by the further errors.
        at: (c,) of which size they are in ``run``, in sigmas.

    Raises:
        SingularError: errors that cannot be separated.
    """
    x, p = found.x, found.x.size
    names, stated = _unknown(run)
    r, both, information = _normal(run, x, further)
    gradient = both.T @ r
    gradient[:p] += run.prior_information @ x
    if at is not None:
        gradient[p + len(names) :] += at
    covariance = inverse_of(information)
    moved = -covariance @ gradient
    z, sigma = moved[p : p + len(names)], np.sqrt(np.diag(covariance)[p : p + len(names)])
    squares = found.residual_sum + float(gradient @ moved)
    fit = found._replace(x=x + moved[:p], covariance=covariance[:p, :p], residual_sum=squares)
    corrections = JointCorrections(names, z, stated, sigma)
    return Step(fit, corrections, covariance, r + both @ moved, both, moved[p + len(names) :])


def bound(run: TableFit, x: FloatArray) -> FloatArray:
    """Covariance of the parameters (p, p) with the errors of the joints unknown, at parameters ``x``, (p,).

    Raises:
        SingularError: a direction determined by neither rows nor prior.
    """
    return inverse_of(_normal(run, x, None)[2])[: x.size, : x.size]


def _unknown(run: TableFit) -> tuple[tuple[str, ...], FloatArray]:
    """Names of the errors that have a sigma, and these, (k,)."""
    names, sigma = (*run.joints.names, *run.cyclic.names), np.append(run.joints.sigma, run.cyclic.sigma)
    own = np.flatnonzero(sigma > 0.0)
    return tuple(names[k] for k in own), sigma[own]


def _normal(run: TableFit, x: FloatArray, further: FloatArray | None) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Residuals (m,), their derivative by parameters and errors, (m, p + k + c), and the information on these."""
    sigma, (r, J), own = (np.append(run.joints.sigma, run.cyclic.sigma), run.residuals(x), run.joints.sigma.size)
    columns = [J]
    for place in np.flatnonzero(sigma > 0.0):
        each = np.where(np.arange(sigma.size) == place, sigma, 0.0)
        wrong = run.with_errors(each[:own].reshape(-1, PER_JOINT), multiples=each[own:])
        columns.append(((wrong.left(x) - r) / sigma[place])[:, None])
    both = np.concatenate([*columns, *([] if further is None else [further])], axis=1)
    information = both.T @ both
    information[: x.size, : x.size] += run.prior_information
    stated = _unknown(run)[1]
    information[x.size :, x.size :] += np.diag(np.append(stated**-2, np.ones(both.shape[1] - x.size - stated.size)))
    return r, both, information


PARTS = 16  # of a run, at the ends of which a scale may step
_SMALL = 0.01  # of a sigma: for derivatives
_FEW = 6  # errors about which the run is fitted anew: of five joints, one each and one more
_SIGMAS = {"zero": LIKELY_SIZE, "scale": LIKELY_SIZE, "delay": LIKELY_DELAY_s}
_AT, _ALONG = np.zeros(0, np.intp), np.zeros((0, 1))  # none of these is a constant of the fit


class EncoderError(NamedTuple):
    """An error of an encoder that competes."""

    suspect: Suspect
    errors: FloatArray  # (joints, 6) of one sigma
    since: int  # tick


class Answered(NamedTuple):
    """The payload of a run."""

    found: PayloadFit  # the mixture of all that counts
    stated: PayloadFit  # if all is as stated
    joints: JointCorrections  # if the likeliest is true, of what it does not say is wrong
    findings: Findings


def answered(run: TableFit, found: PayloadFit) -> Answered:
    """The fit with the errors of the joints, and with what may not be as stated of their encoders.

    Args:
        run: its fit.
        found: its fit of all ticks, joints exact.

    Raises:
        SingularError: errors that cannot be separated.
        SignalError: a payload without a mass.
    """
    step = joint_step(run, found.fit)
    stated, (weighed, some) = run.found(step.fit), _weighed(run, found.fit, step)
    if weighed.every[0].weight >= LIKELIER:
        return Answered(_mixed(run, step, weighed.mixed(weighed.known)), stated, step.joints, Findings())
    solved = list(_likeliest(run, found.fit, weighed, some))
    wider = max(1.0, min([stated.misfit, *(one.squares / stated.freedom for one in solved)]))
    logs = [0.0, *((step.fit.residual_sum - one.squares) / (2.0 * wider) + one.log for one in solved)]
    weights = np.exp(logs - np.max(logs))
    weights /= weights.sum()
    counts = [k for k in np.argsort(-weights).tolist() if weights[k] > LEAST_WEIGHT]
    each = [_known_of(step), *(_known_of(one.step) for one in solved)]
    against, doubts, corrections = list[str](), list[str](), step.joints
    if counts[0]:
        doubts.append(f"not as stated: {' or '.join(solved[k - 1].error.suspect.name for k in counts if k)}")
        best = solved[counts[0] - 1]
        with suppress(EstimationError, ModelError):
            best = _solved(run, best)
        if abs(best.size) >= FARTHEST_SIZE:
            against.append(f"{best.error.suspect.name} is farther from what is stated than any error that is estimated")
        others, _ = _weighed(best.run, best.fit, best.step, best.error)
        each[counts[0]], corrections = others.mixed(others.known).known, best.step.joints
        doubts += [f"{said} as well" for part in others.judged for said in part]
    means, covariances = (np.array([each[k][part] for k in counts]) for part in (0, 1))
    mixture = Mixture(weights[counts] / weights[counts].sum(), means, covariances)
    return Answered(_mixed(run, step, mixture), stated, corrections, Findings(tuple(against), tuple(doubts)))


def _known_of(step: Step) -> Known:
    """Mean and covariance of the parameters."""
    return step.fit.x, step.fit.covariance


def _mixed(run: TableFit, step: Step, mixture: Mixture) -> PayloadFit:
    mean, covariance = mixture.known
    return run.found(step.fit._replace(x=mean, covariance=covariance))


class _Some(NamedTuple):
    """Errors, and the information on their sizes."""

    errors: tuple[EncoderError, ...]
    changed: Changed


def _weighed(run: TableFit, fit: Fit, step: Step, taken: EncoderError | None = None) -> tuple[Weighed, _Some]:
    """Each error by itself against none, but for one that is taken out already."""
    errors = tuple(one for one in _errors(run) if taken is None or (one.errors != taken.errors).any())
    h, p, wider = _columns(run, fit.x, errors), fit.x.size, max(1.0, run.found(step.fit).misfit)
    Bh = step.derivative.T @ h
    moves = -step.covariance @ Bh
    changed = Changed(moves[:p], -(h.T @ step.left) / wider, (h.T @ h + Bh.T @ moves) / wider, np.zeros_like(moves[:p]))
    each = changed.hypotheses([one.suspect for one in errors], every=True)
    alone = [one for one in each if len(one.steps) == 1]
    return Bank((), np.ones(p)).weigh(_known_of(step), alone), _Some(errors, changed)


class _Solved(NamedTuple):
    """The run with an error taken out, fitted anew."""

    error: EncoderError
    size: float  # in sigmas
    log: float  # of its odds, and of what its prior costs
    run: TableFit
    fit: Fit
    step: Step

    @property
    def squares(self) -> float:
        """That are left, with what the size takes."""
        return self.step.fit.residual_sum + self.size**2


def _likeliest(run: TableFit, fit: Fit, weighed: Weighed, some: _Some) -> Iterator[_Solved]:
    """The likeliest errors, each name once."""
    of_name = dict[str, int]()
    for one in sorted((one for one in weighed.every if one.steps), key=lambda one: -one.weight):
        of_name.setdefault(some.errors[one.steps[0]].suspect.name, one.steps[0])
    for k in [*of_name.values()][:_FEW]:
        size, error = float(some.changed.sizes((k,))[0][0]), some.errors[k]
        log = float(np.log(error.suspect.odds) - 0.5 * np.log1p(some.changed.J[k, k]))
        with suppress(EstimationError, ModelError):  # about an error that the data do not tell so exactly
            yield _about(run, fit, error, size, log)


def _about(run: TableFit, fit: Fit | None, error: EncoderError, size: float, log: float) -> _Solved:
    """``fit``: of a run near this; None: minima are searched for."""
    corrected = run.with_errors(size * error.errors, error.since)
    near = (corrected.fit() if fit is None else corrected.near(fit.x)).fit
    step = joint_step(corrected, near, _columns(corrected, near.x, [error]), np.array([size]))
    return _Solved(error, size, log, corrected, near, step)


def _solved(run: TableFit, one: _Solved) -> _Solved:
    """The same at its likeliest size and at the likeliest minimum: drags have many."""
    found = _about(run, None, one.error, one.size + float(one.step.further[0]), one.log)
    return _about(run, found.fit, one.error, found.size + float(found.step.further[0]), one.log)


def _errors(run: TableFit) -> Iterator[EncoderError]:
    names = run.joints.names
    rate = STEPS_PER_HOUR * run.ticks * run.period_s / 3600.0
    for place, name in enumerate(names):
        kind = JOINT_ERRORS[place % PER_JOINT]
        if kind in _SIGMAS:
            errors = np.where(np.arange(len(names)) == place, _SIGMAS[kind], 0.0).reshape(-1, PER_JOINT)
            yield EncoderError(Suspect(name, _AT, _ALONG, ODDS_OF_PART), errors, 0)
            for part in range(1, PARTS) if kind == "scale" else ():
                step = Suspect(f"a step of {name}", _AT, _ALONG, rate / PARTS)
                yield EncoderError(step, errors, part * run.ticks // PARTS)


def _columns(run: TableFit, x: FloatArray, some: Sequence[EncoderError]) -> FloatArray:
    """Derivatives of the residuals by errors of one sigma each, (m, c)."""
    r = run.left(x)
    each = [(run.with_errors(_SMALL * one.errors, one.since).left(x) - r) / _SMALL for one in some]
    return np.reshape(each, (len(some), len(r))).T
