"""The filter of rows: what holds of rows holds of filtered ones, and stated, formal and real errors agree."""

import copy
import pickle

import numpy as np
import pytest

from onboard.estimation.smoothing import Response, SmoothingWindow, correlation_inflation
from onboard.identification.rows.stated_errors.whitening import NoisyRows, Whitening
from onboard.regressor.rows import BaseMotion
from onboard.regressor.signals import OfSamples, SignalNoise, Signals, orders_of

WIDTH_S, PERIOD_S, SECONDS = 0.1, 0.01, 10.0
AT = np.arange(0.2, SECONDS, PERIOD_S)
INFLATION = correlation_inflation(WIDTH_S, PERIOD_S)
OWN = 0.002  # of a smoothed reading
LOUD = 50.0  # times as much by the acceleration's noise
MOTION = np.column_stack([np.sin(2.0 * AT), np.cos(3.1 * AT), np.ones(len(AT))])
TRUE = np.array([1.0, -0.5, 0.1])


def fresh(columns: int = 4) -> Whitening:
    return Whitening(1, columns, PERIOD_S, WIDTH_S, Response(WIDTH_S))


def kernel_noise(rng, order: int):
    """Of unit variance, differentiated so often."""
    times = np.arange(-WIDTH_S, SECONDS + WIDTH_S, 0.0025)
    smoothed = SmoothingWindow(times, AT, WIDTH_S).apply(rng.standard_normal(len(times)), order)
    return smoothed.values[:, 0] / smoothed.noise_gain


def filtered(whitening, y, order: int, share: float = 1.0, use=None, loud=LOUD, step=64):
    """Rows whose reading has noise of one source besides its own; so many ticks at a time."""
    n = len(AT)
    used = np.ones((n, 1), bool) if use is None else use
    samples = OfSamples(np.full((n, 1), share), np.array([order]))
    none = np.zeros((n, 0))
    nothing = SignalNoise(*[none] * 6, INFLATION, samples)
    signals = Signals(AT, none, none, none, BaseMotion(none, none, none), none, none, None, nothing)
    parts = []
    for first in range(0, n, step):
        now = slice(first, first + step)
        mine = used[now, 0]
        count = int(mine.sum())
        effect = np.broadcast_to(loud, n)[now][mine][:, None] * OWN * INFLATION
        own = np.full(count, OWN * INFLATION)
        rows = NoisyRows(MOTION[now][mine], y[now][mine], None, own, own, None)
        parts.append(whitening.filter(signals, np.arange(n)[now], used[now], rows, effect, np.ones(count)))
    return [np.concatenate(column) for column in zip(*((p.Y, p.y, p.sigma) for p in parts), strict=True)]


def estimate(Y, y, sigma):
    information = (Y / sigma[:, None]).T @ (Y / sigma[:, None])
    covariance = np.linalg.inv(information)
    return covariance @ (Y / sigma[:, None] ** 2).T @ y, np.sqrt(np.diag(covariance))


@pytest.mark.parametrize(
    ("order", "loud"), [*(pytest.param(*one, marks=pytest.mark.campaign) for one in ((0, 3.0), (1, 8.0))), (2, LOUD)]
)  # of less noise
def test_stated_errors_are_real_ones(rng, order, loud):
    errors, sigmas = [], []
    for _ in range(20):
        noise = OWN * kernel_noise(rng, 0) + loud * OWN * kernel_noise(rng, order)
        found, sigma = estimate(*filtered(fresh(), MOTION @ TRUE + noise, order, loud=loud))
        errors.append(found - TRUE)
        sigmas.append(sigma)
    ratio = np.sqrt(np.mean(np.square(errors) / np.square(sigmas), axis=0))
    assert (ratio > 0.6).all()
    assert (ratio < 1.4).all()


def test_slow_motion_is_not_hidden_by_the_noise_of_its_accelerations(rng):
    noise = OWN * kernel_noise(rng, 0) + LOUD * OWN * kernel_noise(rng, 2)
    white = np.full(len(AT), np.hypot(1.0, LOUD) * OWN * INFLATION)
    _, before = estimate(MOTION, MOTION @ TRUE + noise, white)
    found, sigma = estimate(*filtered(fresh(), MOTION @ TRUE + noise, 2))
    assert (sigma < 0.1 * before).all()
    assert (np.abs(found - TRUE) < 4.0 * sigma).all()


def test_noise_that_is_not_of_samples_counts_as_white():
    Y, y, sigma = filtered(fresh(), MOTION @ TRUE, 2, share=0.0)
    np.testing.assert_allclose(Y, MOTION)
    assert y == pytest.approx(MOTION @ TRUE)
    assert sigma == pytest.approx(np.hypot(1.0, LOUD) * OWN * INFLATION)


def test_noise_that_begins_is_stated_from_its_first_row_on(rng):
    """An encoder at rest repeats its count: rows of rest are good, and those of the first motion are not as good."""
    whitening, moves = fresh(), (AT > 4.0) * 1.0
    noise = OWN * kernel_noise(rng, 0) + moves * LOUD * OWN * kernel_noise(rng, 2)
    Y, y, sigma = filtered(whitening, MOTION @ TRUE + noise, 2, loud=LOUD * moves, step=5)
    after = (AT[: len(y)] > 4.0) & (AT[: len(y)] < 4.5)
    assert after.sum() > 40
    assert np.sqrt(np.mean(((y - Y @ TRUE) / sigma)[after] ** 2)) < 1.5


def test_what_holds_of_rows_holds_of_filtered_ones(rng):
    use = rng.random((len(AT), 1)) > 0.1
    use[500:560] = False
    Y, y, _ = filtered(fresh(), MOTION @ TRUE, 2, use=use)
    assert len(y) == use.sum() > 700
    assert y == pytest.approx(Y @ TRUE, abs=1e-12)
    assert np.abs(Y - MOTION[use[:, 0]]).max() > 0.1  # and it is a filter


def test_a_hole_begins_it_anew():
    use = np.ones((len(AT), 1), bool)
    use[500:560] = False
    Y, _, _ = filtered(fresh(), MOTION @ TRUE, 2, use=use)
    other = fresh()
    other._levels = np.array([[OWN**2, 0.0, (LOUD * OWN) ** 2]]) * INFLATION**2
    again, _, _ = filtered(other, MOTION @ TRUE, 2, use=use & (np.arange(len(AT)) > 559)[:, None])
    assert Y[-len(again) :] == pytest.approx(again)


def test_it_can_be_pickled():
    one = fresh()
    filtered(one, MOTION @ TRUE, 2)
    other = pickle.loads(pickle.dumps(one))
    rows = [filtered(which, MOTION @ TRUE, 2) for which in (copy.deepcopy(one), other)]
    assert all(np.array_equal(a, b) for a, b in zip(*rows, strict=True))


def test_how_often_samples_were_differentiated():
    assert orders_of([False, True]).tolist() == [0, 0, 1, 0, 2, 1, 0, 0, 0, 1, 1, 1, 0, 0, 0]
