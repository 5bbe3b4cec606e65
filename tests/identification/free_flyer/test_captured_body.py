"""Motion of a captured body, reported on board once the payload is known; captures are detected by the filter."""

import pickle

import numpy as np
import pytest

from bench.true_flights import free_flyer
from onboard.identification.free_flyer import captured_body as module
from onboard.identification.free_flyer.before_capture import Payload, before_capture
from onboard.identification.free_flyer.captured_body import NAMES, CapturedBody
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD
from onboard.identification.online import Change
from tests.identification.free_flyer.captures import LARGE, Case

CAPTURE_s, END_s, BATCH = 3.0, 9.0, 10
SMALL = free_flyer.Body.box(1.0, (0.12, 0.11, 0.10), (0.01, -0.01, 0.05))
RATE = np.array([0.1, -0.15, 0.2])


def flown(case, *, told_s=None):
    """The filter's answer of every batch, as the estimator asks for it."""
    ekf, found, at = case.online, [], 0
    body = CapturedBody(ekf)
    while at < len(case.ticks.time_s):
        ticks = case.ticks.part(slice(at, at + BATCH))
        if told_s is not None and told_s <= ticks.time_s[-1]:
            ekf.announce(True, told_s)
            told_s = None
        ekf.update(ticks)
        body.take(ticks)
        if ekf.holds and ekf.confirmed and ekf.state is not None and body.due:
            body.tell(Payload(ekf.state[PAYLOAD], ekf.covariance[PAYLOAD, PAYLOAD]))
        found.append(body.quantities(known=True))
        at += BATCH
    return body, found


@pytest.fixture(scope="module")
def announced():
    """Makes a capture that is announced, flown once: the case, the estimator of its motion, its answers."""
    case = Case(1, LARGE, np.zeros(3), RATE, CAPTURE_s, END_s)
    kept = pickle.dumps((case, *flown(case, told_s=CAPTURE_s)))
    return lambda: pickle.loads(kept)


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.campaign) for seed in (2, 3))])
def test_a_large_body_that_tumbles_is_told_with_an_interval_that_holds(seed):
    case = Case(seed, LARGE, np.array([0.02, -0.01, 0.015]), RATE, CAPTURE_s, END_s)
    _, found = flown(case)
    assert [kind.kind for kind in case.online.changes] == ["change", "capture"]
    assert found[int(CAPTURE_s / 0.01 / BATCH) - 1] == ()
    last = found[-1]
    assert tuple(one.name for one in last) == NAMES
    assert {one.unit for one in last[:3]} == {"m/s"}
    assert {one.unit for one in last[3:]} == {"rad/s"}
    assert all(one.supported for one in last[3:])
    for one, true in zip(last[3:], case.rate, strict=True):
        assert abs(one.value - true) < 3.3 * one.sigma < 0.2
        assert one.high - one.value == pytest.approx(1.96 * one.sigma, rel=1e-3)
    for one, true in zip(last[:3], case.velocity, strict=True):
        assert not one.supported or abs(one.value - true) < 3.3 * one.sigma


def test_of_a_small_one_no_number_is_told_but_why():
    _, found = flown(Case(1, SMALL, np.array([0.02, -0.01, 0.0]), RATE, CAPTURE_s, END_s))
    assert found[-1]
    for one in found[-1][3:]:
        assert not one.supported
        assert np.isnan(one.value)
        assert one.note.endswith("rad/s only: momentum and time of the contact determine no more")


def test_an_announcement_tells_when_the_payload_was_touched_to_the_period_of_a_slow_flag(monkeypatch):
    touched = []
    monkeypatch.setattr(module, "before_capture", lambda *given: touched.append(given[-1]) or before_capture(*given))
    flown(Case(1, LARGE, np.zeros(3), RATE, CAPTURE_s, END_s), told_s=CAPTURE_s)
    for from_s, until_s in touched:
        assert from_s == pytest.approx(CAPTURE_s - 0.05, abs=0.02)
        assert until_s == pytest.approx(CAPTURE_s + 0.05, abs=0.02)
    assert touched


def test_minutes_later_it_is_told_with_the_zeros_at_the_capture_as_they_were_known_before(announced, monkeypatch):
    case, body, found = announced()
    monkeypatch.setattr(case.online, "ticks_used", 30000)
    assert body.due
    state, zeros = body._before(CAPTURE_s)
    drifted = zeros._replace(covariance=1e4 * zeros.covariance)
    monkeypatch.setattr(body, "_before", lambda at_s: (state, drifted))
    body.tell(Payload(case.online.state[PAYLOAD], case.online.covariance[PAYLOAD, PAYLOAD]))
    for now, before in zip(body.quantities(known=True), found[-1], strict=True):
        assert now.supported == before.supported
        assert not now.supported or now.sigma < 1.1 * before.sigma


def test_a_capture_that_is_announced_is_told_too_and_nothing_after_a_release(announced):
    case, body, found = announced()
    assert case.online.changes[0].kind == "capture"
    told = [one for one in found[-1][3:] if one.supported]
    assert told
    for one in told:
        assert abs(one.value - case.rate[NAMES.index(one.name) - 3]) < 3.3 * one.sigma
    case.online.changes.append(Change("ejection", END_s, END_s, np.nan))
    body.take(case.ticks.part(slice(-2, None)))
    assert {one.note for one in body.quantities(known=True)} == {"nothing is held"}
    assert not body.due


def test_without_the_base_imu_it_says_so_and_a_copy_goes_on_alike():
    case = Case(2, LARGE, np.zeros(3), RATE, CAPTURE_s, END_s)
    body, found = flown(case)
    again = pickle.loads(pickle.dumps(body))
    assert again.quantities(known=True) == found[-1]
    case.online.fusion.leave_out(0)
    body.tell(Payload(case.online.state[PAYLOAD], case.online.covariance[PAYLOAD, PAYLOAD]))
    assert {one.note for one in body.quantities(known=True)} == {"imu is left out"}


def test_while_the_payload_is_not_known_nothing_is_told_and_it_is_told_anew_when_it_is_found_again():
    case = Case(2, LARGE, np.zeros(3), RATE, CAPTURE_s, END_s)
    body, _ = flown(case)
    assert {one.note for one in body.quantities(known=False)} == {"the payload is not known"}
    assert not body.due
    case.online.ticks_used = 100
    assert body.due
