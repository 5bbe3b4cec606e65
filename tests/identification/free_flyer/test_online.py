"""What is reported of a payload while an instrument is left out."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from onboard.dynamics.model.inertia import elements
from onboard.dynamics.model.payload import body_jacobian, body_of
from onboard.estimation.gates import GateReason
from onboard.identification.corrections import DOUBTFUL, contradicted, expected_sigma
from onboard.identification.evidence.bank import Hypothesis, Root, Weighed
from onboard.identification.evidence.mixture import Mixture
from onboard.identification.free_flyer import innovation
from onboard.identification.free_flyer.fusion import Fusion
from onboard.identification.free_flyer.online import MotionIdentifier
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD
from onboard.identification.free_flyer.prediction.joint_noise import NoiseAdded, correction_of
from onboard.regressor.signals import Signals
from tests.identification.free_flyer.recorded_flights import online, ticks_of


def as_stated(state: np.ndarray, covariance: np.ndarray) -> Weighed:
    """Nothing else competes."""
    return Weighed((state, covariance), (Hypothesis(None, (), 1.0, 0.0, 0.0, Root(*np.zeros((2, 0, 0)), state[:0])),))


class Once:
    """The same for the same state."""

    def __init__(self) -> None:
        self.made: Weighed | None = None

    def __call__(self, state: np.ndarray, covariance: np.ndarray) -> Weighed:
        if self.made is None or self.made.stated[0] is not state:
            self.made = as_stated(state, covariance)
        return self.made


NONE = np.zeros(0, np.intp)


def sheet(stated, of_each, imus, **further):
    """What is asked of a predictor: the stated sigmas of its parameters, and those of each IMU."""
    return SimpleNamespace(
        stated=stated,
        of_each=of_each,
        wandering=[],
        biases=[],
        key_of=str,
        names=tuple(f"unknown_{k}" for k in range(len(stated))),
        vehicle=SimpleNamespace(spec=SimpleNamespace(payload_link="payload"), joints=()),
        thrusters=(),
        changing=np.arange(3),
        further=(),
        of_further=[],
        imu_frames=imus,
        **further,
    )


def unsuspicious():
    """Residuals that show nothing."""
    return SimpleNamespace(strongest=None, by_instrument=dict, slow=SimpleNamespace(by_sensor=lambda _: {}))


def payload_of(online, weighed):
    """Mean and covariance of the payload."""
    mixture, widening = online._payload(weighed)
    mean, covariance = mixture.known
    return mean, widening * covariance


def test_a_correction_that_the_data_hardly_tell_of_is_held_against_what_they_tell() -> None:
    """A scale of 3 % that is stated to 0.1 % and measured to 0.4 %: moved by 1.8 of its stated sigmas, seven off."""
    stated, measured, wrong = 0.001, 0.004, 0.03
    variance = 1.0 / (stated**-2 + measured**-2)
    moved = variance * wrong / measured**2
    assert moved < 1.8 * stated
    sigmas = moved / expected_sigma(np.array([stated**2]), np.array([variance]))[0]
    assert sigmas == pytest.approx(wrong / np.hypot(stated, measured))
    assert contradicted({"scale_joint_2": -sigmas, "zero": 4.2}) == (
        "the motion contradicts what is stated of scale_joint_2 by 7 sigmas: it has changed, or is not so",
    )
    assert contradicted({"zero": 4.2}) == contradicted({}) == ()


def test_a_contradicted_correction_widens_what_is_told_unless_its_instrument_is_left_out_or_it_changes(
    rng: np.random.Generator,
) -> None:
    half = rng.standard_normal((15, 15))
    covariance = 1e-3 * half @ half.T
    fusion = Fusion(("imu", "imu_2", "cell"), (slice(0, 6), slice(6, 12), slice(12, 13)))
    stated = np.full(15, np.nan)
    stated[13] = 2.0 * np.sqrt(covariance[13, 13])
    state = np.zeros(15)
    state[13] = 2.0 * DOUBTFUL * np.sqrt(0.75) * stated[13]  # of what the data tell
    nothing = np.zeros(0, np.intp)
    predictor = sheet(stated, [nothing, nothing, np.array([13])], ("imu", "imu_2"), sigma=stated)
    quiet = unsuspicious()
    online = MotionIdentifier(
        SimpleNamespace(
            predictor=predictor,
            fusion=fusion,
            covariance=covariance,
            lines=quiet,
            misfit=quiet,
            correction=correction_of((state, covariance), NoiseAdded.none(15), np.ones(15)),
            rivals=SimpleNamespace(spanned=NONE),
        )
    )
    np.testing.assert_allclose(
        payload_of(online, as_stated(state.copy(), covariance))[1], 4.0 * covariance[PAYLOAD, PAYLOAD]
    )
    predictor.wandering = [(13, 30.0)]
    np.testing.assert_allclose(payload_of(online, as_stated(state.copy(), covariance))[1], covariance[PAYLOAD, PAYLOAD])
    predictor.wandering, predictor.biases = [], [(12, 13)]
    np.testing.assert_allclose(payload_of(online, as_stated(state.copy(), covariance))[1], covariance[PAYLOAD, PAYLOAD])
    predictor.biases = []
    fusion.leave_out(2)
    np.testing.assert_allclose(payload_of(online, as_stated(state.copy(), covariance))[1], covariance[PAYLOAD, PAYLOAD])
    quiet.slow.by_sensor = lambda _: {"gyro": 6.5, "accelerometer": 2.0}
    np.testing.assert_allclose(
        payload_of(online, as_stated(state.copy(), covariance))[1], 6.5 * covariance[PAYLOAD, PAYLOAD]
    )


def unsure(mean: np.ndarray, sigma: np.ndarray, moved: float = 0.0, spanned: np.ndarray = NONE) -> MotionIdentifier:
    """An identifier whose filter holds a payload with these standard parameters, independent of each other.

    ``moved``: a correction, in sigmas of what the data tell of it. ``spanned``: what is weighed in every direction.
    """
    unknown = np.full(PAYLOAD.stop + 1, np.nan)
    predictor = sheet(unknown.copy(), [NONE], ("imu",), sigma=unknown)
    predictor.stated[-1] = 1.0
    state, covariance = np.zeros(PAYLOAD.stop + 1), np.eye(PAYLOAD.stop + 1)
    state[PAYLOAD], covariance[PAYLOAD, PAYLOAD] = mean, np.diag(sigma**2)
    state[-1], covariance[-1, -1] = moved * np.sqrt(0.1), 0.9
    quiet = unsuspicious()
    return MotionIdentifier(
        SimpleNamespace(
            predictor=predictor,
            fusion=Fusion(("imu",), (slice(0, 6),)),
            covariance=covariance,
            state=state,
            lines=quiet,
            misfit=quiet,
            correction=correction_of((state, covariance), NoiseAdded.none(14), np.ones(14)),
            known=(state, covariance),  # exact joints
            rivals=SimpleNamespace(weighed=Once(), spanned=spanned),
            held=True,
            holds=True,
            altered=False,
            confirmed=True,
            payload_sigma=np.full(10, 100.0),
            glitches=0,
            changes=[],
            undecided="",
            exchanged=False,
            unexplained=SimpleNamespace(count=0, swings=False, line=None, between=""),
        )
    )


def test_a_payload_that_cannot_exist_is_moved_to_one_that_can_and_its_intervals_hold_both() -> None:
    """0.2 kg with an inertia known to 0.01 kg m2, and found negative."""
    mean = np.array([0.2, 0.02, 0.0, 0.0, -0.02, 0.0, 0.01, 0.0, 0.0, 0.01])
    sigma = np.array([0.02, 1e-3, 1e-3, 1e-3, *[0.01] * 6])
    answers, D = unsure(mean, sigma).estimate().quantities, body_jacobian(mean)
    found = body_of(mean)
    estimated = [found.mass_kg, *found.centre_of_mass_m, *elements(found.inertia_kg_m2)]
    moved = np.array([one.value for one in answers]) - estimated
    assert moved[4] > 0.02
    spread = np.sqrt(D**2 @ sigma**2)
    np.testing.assert_allclose([one.sigma for one in answers], np.hypot(spread, moved))
    possible = np.array([0.2, 0.0, 0.0, 0.0, 0.01, 0.0, 0.01, 0.0, 0.0, 0.01])
    assert unsure(possible, sigma).estimate().quantities[0].sigma == pytest.approx(0.02)


def test_an_answer_has_the_mixtures_own_intervals_and_is_supported_by_the_wider_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A mass that is 2 kg +- 10 g, or with a weight of one in a hundred 2.1 kg +- 50 g; variances times four."""
    mean = np.array([2.0, 0.0, 0.0, 0.0, 0.01, 0.0, 0.01, 0.0, 0.0, 0.01])
    far, sigma = mean + 0.1 * (np.arange(10) == 0), np.array([0.01, *[1e-5] * 9])
    covariances = np.array([np.diag(sigma**2), np.diag((sigma * [5.0, *[1.0] * 9]) ** 2)])
    weights = np.array([0.99, 0.01])
    mixture = Mixture(weights, np.array([mean, far]), covariances)
    monkeypatch.setattr(MotionIdentifier, "_payload", lambda *_: (mixture, 4.0))
    monkeypatch.setattr(MotionIdentifier, "_effects", lambda *_: np.zeros((10, 0)))
    online = unsure(mean, sigma)
    mass = online.estimate().quantities[0]
    assert mass.value == pytest.approx(2.001)
    assert mass.sigma == pytest.approx(2.0 * np.sqrt(weights @ [0.01**2, 0.05**2] + 0.99 * 0.01 * 0.1**2))
    both = norm([0.0, 0.1], [0.01, 0.05])
    for end, share in zip((mass.low, mass.high, *mass.outer), (0.025, 0.975, 0.0005, 0.9995), strict=True):
        at = 0.001 + (end - 2.001) / 2.0
        assert weights @ (both.cdf(at) if share < 0.5 else both.sf(at)) == pytest.approx(
            min(share, 1.0 - share), rel=0.1
        )
    half = 0.5 * (mass.outer[1] - mass.outer[0]) / 3.2905
    assert half > 2.0 * mass.half / 1.96
    for prior, supported in ((4.9 * half, False), (5.1 * half, True)):
        online.ekf.payload_sigma = np.full(10, prior)
        assert online.estimate().quantities[0].supported is supported


def test_a_contradicted_correction_refuses_where_the_mass_is_known_and_is_a_doubt_where_it_is_not() -> None:
    mean = np.array([0.2, 0.0, 0.0, 0.0, 0.01, 0.0, 0.01, 0.0, 0.0, 0.01])
    for relative, refuses in ((0.05, True), (0.3, False)):
        found = unsure(mean, np.array([0.2 * relative, *[1e-3] * 9]), moved=6.0).findings()
        assert bool(found.against) is refuses
        assert any("by 6 sigmas" in one for one in (found.against if refuses else found.doubts))


def test_a_correction_that_is_weighed_in_every_direction_is_held_against_nothing_one_by_one() -> None:
    given = np.array([0.2, 0.0, 0.0, 0.0, 0.01, 0.0, 0.01, 0.0, 0.0, 0.01]), np.full(10, 1e-3), 5.1
    online = unsure(*given)
    assert any("contradicts what is stated of unknown_13" in one for one in online.findings().against)
    online = unsure(*given, spanned=np.array([PAYLOAD.stop]))
    assert all("all corrections together" in one for one in online.findings().against)


def test_a_payload_of_which_a_part_may_have_come_off_is_an_answer_that_is_doubted() -> None:
    online = unsure(np.array([0.2, 0.0, 0.0, 0.0, 0.01, 0.0, 0.01, 0.0, 0.0, 0.01]), np.full(10, 1e-3))
    before = online.findings()
    online.ekf.altered = True
    (doubt,) = set(online.findings().doubts) - set(before.doubts)
    assert doubt.startswith("the payload changed without a release: a part came off or was added")
    assert not online.findings().against


def test_instruments_without_either_of_which_a_window_is_explained_are_named_before_what_swings() -> None:
    refused = unsure(np.array([0.2, *np.zeros(9)]), np.ones(10))
    both = "imu_base and imu_2 contradict each other, and nothing tells which is wrong"
    unexplained = refused.ekf.unexplained
    unexplained.count, unexplained.line = 1, SimpleNamespace(instrument="gyro", frequency_Hz=2.0)
    assert "the gyro swings at 2 Hz" in refused.findings().against[0]
    unexplained.between = both
    assert refused.findings().against == (both,)


def test_what_swings_is_named_where_most_ticks_are_refused_too() -> None:
    """Joints that give way at 20 Hz: no window is explained, and all its ticks are outliers of the best payload's."""
    refused = unsure(np.array([0.2, *np.zeros(9)]), np.ones(10))
    refused.refused[GateReason.RESIDUAL] = 100
    assert refused.findings().against == ("100% of the ticks contradict the others; check the IMU and the joints",)
    refused.ekf.unexplained.line = SimpleNamespace(instrument="gyro", frequency_Hz=5.1)
    assert "the gyro swings at 5.1 Hz" in refused.findings().against[0]


def test_corrections_are_held_against_what_is_stated_once_for_each_state(monkeypatch: pytest.MonkeyPatch) -> None:
    mean = np.array([0.2, 0.0, 0.0, 0.0, 0.01, 0.0, 0.01, 0.0, 0.0, 0.01])
    online, asked = unsure(mean, np.full(10, 1e-3), moved=6.0), []
    counted = innovation.together
    monkeypatch.setattr(innovation, "together", lambda *given: asked.append(1) or counted(*given))
    ekf = online.ekf
    assert online.findings().against
    online.estimate()
    online.triangle()
    assert len(asked) == 1
    ekf.state, ekf.covariance = np.where(np.arange(14) == 13, 0.0, ekf.state), ekf.covariance.copy()
    ekf.known = ekf.state, ekf.covariance
    assert not online.findings().against
    assert len(asked) == 2
    ekf.fusion.left_out.append(0)
    online.findings()
    online.estimate()
    assert len(asked) == 3


def test_what_is_held_is_not_said_of_motion_that_is_not_taken_in(mission: Any) -> None:
    """As where an encoder has jumped before a capture: no row counts from there on."""
    some = ticks_of(mission)
    identifier = MotionIdentifier(online(mission, held=False))
    unused_motion: Any = None
    whys = []
    for first, last, reason in ((0, 280, 0), (280, 370, int(GateReason.JUMPED)), (370, 460, int(GateReason.JUMPED))):
        ticks = some.part(slice(first, last))
        n = last - first
        parts = ticks.q, ticks.dq, ticks.ddq, unused_motion, ticks.measured, ticks.sigma
        signals = Signals(ticks.time_s, *parts)
        identifier.update(signals, np.zeros(n, np.bool_), np.full(n, reason, np.int64))
        identifier.finish()
        whys.append({one.note for one in identifier.estimate().quantities})
    assert whys == [{"nothing is held"}, {"nothing is held"}, {"nothing was held when motion was last taken in"}]
