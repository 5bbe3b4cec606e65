"""An encoder that jumps in flight: what of its joint may be another one, and the payload after it."""

from typing import Any

import numpy as np
import pytest

from onboard import config
from onboard.estimation.gates import GateReason
from onboard.flight.estimate.problem.identification import build_free_flyer
from onboard.identification.free_flyer.online import MotionIdentifier
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD, ImuPredictor
from onboard.identification.free_flyer.prediction.parameters import GeometryPrior, JointPrior
from onboard.identification.free_flyer.prediction.ticks import Ticks
from onboard.identification.free_flyer.recursion.recursive import MotionFilter
from onboard.identification.free_flyer.steps import JumpedJoint
from onboard.identification.free_flyer.suspects import Rivals
from onboard.regressor.signals import EncoderJump, Signals
from tests.identification.free_flyer.recorded_flights import CAPTURE_s, RELEASE_s, jumped, online, ticks_of

STATED = GeometryPrior(0.0, {f"joint_{k}": JointPrior(0.0, 1e-3, 2e-4, 2e-4) for k in range(1, 6)})
HELD_KG = 5.0


@pytest.fixture(scope="module")
def predictor() -> ImuPredictor:
    return build_free_flyer(config.load(config.packaged("dymaflex")))[0].ekf.predictor


@pytest.mark.parametrize(
    ("jump", "others"),
    [
        (EncoderJump(0, 0.02, 0.4, 0.9), {"scale": (0.05, -0.02), "delay": (0.02 / 0.9, -0.02)}),
        (EncoderJump(0, 0.02, 0.06, -0.9), {"delay": (-0.02 / 0.9, -0.02)}),  # by a third: no scale is so wrong
        (EncoderJump(0, 0.02, 0.4, 0.6), {"scale": (0.05, -0.02)}),  # 33 ms
        (EncoderJump(0, 0.02, 0.0, 0.0), {}),
    ],
)
def test_another_scale_or_delay_has_the_size_that_makes_the_jump_unless_it_is_too_far(
    predictor: ImuPredictor, jump: EncoderJump, others: dict[str, tuple[float, float]]
) -> None:
    joint = JumpedJoint(predictor, "joint_2", jump)
    zero = predictor.names.index("zero_joint_2")
    assert [one.name for one in joint.others] == [f"{kind}_joint_2" for kind in others]
    for one, (kind, along) in zip(joint.others, others.items(), strict=True):
        assert one.at.tolist() == [predictor.names.index(f"{kind}_joint_2"), zero]
        np.testing.assert_allclose(one.along, along)
    errors = {predictor.names[k] for k in joint.errors}
    assert errors >= {"zero_joint_2", "scale_joint_2", "delay_joint_2", "cyclic_0_cos_joint_2"}
    assert all(name.endswith("_joint_2") and not name.startswith("place") for name in errors)


def test_after_a_jump_nothing_is_known_of_the_encoder_but_what_is_stated_and_what_may_have_made_it(
    predictor: ImuPredictor,
) -> None:
    rng, rivals = np.random.default_rng(3), Rivals(predictor)
    sigma = np.nan_to_num(predictor.sigma, nan=1.0)
    root = np.diag(sigma) @ rng.normal(size=(len(sigma), len(sigma))) / np.sqrt(len(sigma))
    known = 0.1 * sigma * rng.normal(size=len(sigma)), 0.5 * (root @ root.T + np.diag(sigma**2))
    joint = JumpedJoint(predictor, "joint_2", EncoderJump(0, 0.02, 0.4, 0.0))
    state, covariance = rivals.jumped(joint)(known)
    zero, scale = (predictor.names.index(f"{kind}_joint_2") for kind in ("zero", "scale"))
    others = np.setdiff1d(np.arange(len(sigma)), joint.errors)
    np.testing.assert_allclose(state[others], known[0][others])
    np.testing.assert_allclose(covariance[np.ix_(others, others)], known[1][np.ix_(others, others)], rtol=1e-6)
    np.testing.assert_allclose(covariance[np.ix_(joint.errors, others)], 0.0, atol=1e-12)
    assert covariance[scale, scale] == pytest.approx(predictor.sigma[scale] ** 2 + 0.05**2)
    assert covariance[zero, zero] == pytest.approx(predictor.sigma[zero] ** 2 + 0.02**2)
    assert covariance[zero, scale] == pytest.approx(-0.05 * 0.02)
    weighed = rivals.weighed(state, covariance)
    (one,) = (one for one in weighed.every if one.numbers == rivals.freed)
    assert one.weight == pytest.approx(weighed.every[0].weight)  # as likely as a zero that has slipped
    as_stated = weighed.known(weighed.every[0])[1]
    assert as_stated[scale, scale] == pytest.approx(predictor.sigma[scale] ** 2)


def test_after_a_second_jump_the_first_may_have_changed_the_scale_too(predictor: ImuPredictor) -> None:
    rivals = Rivals(predictor)
    known = np.zeros(len(predictor.names)), np.diag(np.nan_to_num(predictor.sigma, nan=1.0) ** 2)
    for size in (0.02, 0.001, 0.3):  # the last is of no scale that is likely
        known = rivals.jumped(JumpedJoint(predictor, "joint_2", EncoderJump(0, size, 0.4, 0.0)))(known)
    zero, scale = (predictor.names.index(f"{kind}_joint_2") for kind in ("zero", "scale"))
    sizes = np.array([0.02, 0.001])
    assert known[1][scale, scale] == pytest.approx(predictor.sigma[scale] ** 2 + ((sizes / 0.4) ** 2).sum())
    assert known[1][zero, scale] == pytest.approx(-(sizes**2 / 0.4).sum())
    assert rivals.weighed(*known).every[0].weight > 0.0


def flown(recursive: MotionFilter, ticks: Ticks, jump: EncoderJump) -> MotionFilter:
    k = int(np.searchsorted(ticks.time_s, 1e-9 * jump.vehicle_ns))
    recursive.update(ticks.part(slice(0, k)))
    recursive.jumped("joint_2", jump)
    recursive.update(ticks.part(slice(k, None)))
    recursive.finish()
    return recursive


def sigmas_off(recursive: MotionFilter) -> tuple[float, float]:
    """Of the mass over all that counts; and its sigma."""
    assert recursive.state is not None
    weighed = recursive.rivals.weighed(*recursive.known)
    mean, covariance = weighed.mixed(lambda one: weighed.known(one, PAYLOAD)).known
    sigma = float(np.sqrt(covariance[0, 0]))
    return abs(float(mean[0]) - HELD_KG) / sigma, sigma


@pytest.mark.parametrize(
    ("scale", "zero"), [(0.08, 0.0), pytest.param(-0.08, 0.0, marks=pytest.mark.campaign), (0.0, 0.02)]
)
@pytest.mark.parametrize("at_s", [1.0, 4.0])
def test_the_payload_is_followed_and_another_scale_is_named(held: Any, scale: float, zero: float, at_s: float) -> None:
    """In a window and in the filter; without being told of the jump the answer is lost, or far off."""
    ticks, jump = jumped(ticks_of(held), at_s, scale, zero)
    recursive = flown(online(held, geometry=STATED), ticks, jump)
    off, sigma = sigmas_off(recursive)
    assert off < 3.0
    assert sigma < 0.06 * HELD_KG
    assert recursive.changes == []
    assert recursive.state is not None
    names = recursive.rivals.weighed(*recursive.known).names
    assert ("scale_joint_2" in names) or not scale


def test_a_payload_is_caught_after_a_jump(mission: Any) -> None:
    ticks, jump = jumped(ticks_of(mission), 0.5 * CAPTURE_s, 0.05, 0.0)
    ticks = ticks.part(slice(0, int(np.searchsorted(ticks.time_s, RELEASE_s - 0.1))))
    recursive = flown(online(mission, held=False, geometry=STATED), ticks, jump)
    assert [one.kind for one in recursive.changes if one.kind != "change"] == ["capture"]
    assert sigmas_off(recursive)[0] < 3.0


def test_an_identifier_takes_a_jump_in_between_its_ticks(held: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    ticks, jump = jumped(ticks_of(held), 2.503, 0.05, 0.0)
    some, told = ticks.part(slice(0, 320)), list[tuple[int, str]]()
    identifier = MotionIdentifier(online(held, geometry=STATED))
    take, taken, seen = identifier.ekf.take, identifier.ekf.jumped, [0]

    def note(joint: str, of: EncoderJump) -> None:
        told.append((seen[0], joint))
        taken(joint, of)

    def count(part: Ticks) -> None:
        seen[0] += len(part.time_s)
        take(part)

    monkeypatch.setattr(identifier.ekf, "jumped", note)
    monkeypatch.setattr(identifier.ekf, "take", count)
    unused: Any = None
    for first, last in ((0, 240), (240, 250), (250, 320)):
        part = some.part(slice(first, last))
        within = part.time_s[0] <= 2.503 <= part.time_s[-1]
        signals = Signals(part.time_s, part.q, part.dq, part.ddq, unused, part.measured, part.sigma)
        signals = signals._replace(jumps=(("joint_2", jump),) if within else ())
        identifier.update(signals, np.ones(last - first, np.bool_), np.zeros(last - first, np.int64))
    assert told == [(int(np.searchsorted(some.time_s, 2.503)), "joint_2")]
    assert identifier.refused[GateReason.JUMPED] == 0
