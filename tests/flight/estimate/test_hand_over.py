"""The URDF that a flight hands over: there while all ten numbers are good, and gone when they are not."""

import importlib
import os
import sys
import time
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pinocchio as pin
import pytest

from drivers.records import Batch
from onboard import channels, config
from onboard.dynamics.mechanics.floating_arm import FloatingArm
from onboard.dynamics.mechanics.joint_space import JointSpace
from onboard.dynamics.model.inertia import RigidBody, elements
from onboard.dynamics.model.payload import standard_of
from onboard.flight.estimate.answers import change_event
from onboard.flight.estimate.hand_over import HandOver, check
from onboard.flight.estimate.problem.model import build_model
from onboard.identification.online import Change
from onboard.identification.quantities import BODY, BODY_UNITS

S = 1_000_000_000
TURN = pin.utils.rotate("x", 0.4) @ pin.utils.rotate("z", 0.7)
BODY_5_KG = RigidBody(5.0, np.array([0.02, -0.01, 0.09]), TURN @ np.diag([0.03, 0.04, 0.05]) @ TURN.T)
EXAMPLE = Path(__file__).resolve().parents[3] / "docs" / "examples" / "feed_forward.py"


@pytest.fixture(scope="module")
def vehicle():
    return config.named("dymaflex")


@pytest.fixture
def handed(vehicle, tmp_path):
    """A flight's hand-over, and its path."""
    flown = vehicle.model_copy(update={"hand_over": tmp_path / "payload.urdf"})
    check(flown, names(flown))
    return HandOver(flown), flown.hand_over


def names(vehicle):
    return [f"{kind}_{vehicle.file.vehicle.payload_link}" for kind in BODY]


def answers(vehicle, body=BODY_5_KG, **one):
    """QUANTITY rows of a body; ``one`` replaces fields of the last quantity, after a parameter that comes first."""
    rows = np.zeros(11, channels.QUANTITY)
    rows["name"], rows["unit"] = [b"beta_1", *(name.encode() for name in names(vehicle))], [b"", *BODY_UNITS]
    rows["value"][1:] = [body.mass_kg, *body.centre_of_mass_m, *elements(body.inertia_kg_m2)]
    rows["low"], rows["high"] = rows["value"] - 0.01, rows["value"] + 0.01
    rows["sigma"], rows["supported"] = 0.005, 1
    rows["level"][0] = 2  # of a parameter: not asked
    for field, value in one.items():
        rows[field][-1] = value
    return [Batch("row", rows[:0]), Batch("quantity", rows)]


def codes(batches):
    return [batch.rows["code"][0].decode() for batch in batches]


def good(handed, vehicle, until_s=2.0):
    own, _ = handed
    return [code for k in range(round(10 * until_s)) for code in codes(own.step(k * S // 10, answers(vehicle)))]


def test_a_good_answer_is_a_urdf_with_the_body_and_its_intervals(handed, vehicle):
    assert good(handed, vehicle, 0.9) == []
    assert not handed[1].exists()  # good for less than a second
    assert good(handed, vehicle) == ["handed_over"]
    text = handed[1].read_text()
    model = pin.buildModelFromXML(text, pin.JointModelFreeFlyer())
    before = pin.buildModelFromXML(vehicle.urdf_text, pin.JointModelFreeFlyer())
    payload = pin.computeTotalMass(model) - pin.computeTotalMass(before)
    nominal = ET.fromstring(vehicle.urdf_text).find(f"link[@name='{vehicle.file.vehicle.payload_link}']/inertial/mass")
    assert payload == pytest.approx(5.0 - (0.0 if nominal is None else float(nominal.get("value"))))
    said = ET.fromstring(text).find("identified")
    assert (said.get("level"), said.get("host_ns")) == ("good", str(S))
    quantities = {one.get("name"): one.attrib for one in said}
    assert set(quantities) == set(names(vehicle))
    mass = quantities[names(vehicle)[0]]
    assert [float(mass[field]) for field in ("value", "low", "high", "sigma")] == [5.0, 4.99, 5.01, 0.005]


def test_the_file_is_renewed_every_second_so_that_its_age_tells(handed, vehicle):
    good(handed, vehicle, 5.0)
    assert ET.fromstring(handed[1].read_text()).find("identified").get("host_ns") == str(4 * S)


@pytest.mark.parametrize(
    ("one", "why"),
    [
        ({"level": 1, "why": b"its interval contains zero"}, "is weak: its interval contains zero"),
        ({"level": 2, "supported": 0, "why": b"too many"}, "is do not use: too many"),
        ({"supported": 0, "value": np.nan}, "I_zz"),
    ],
)
def test_an_answer_that_is_withdrawn_is_gone_at_once_and_must_hold_again(handed, vehicle, one, why):
    good(handed, vehicle)
    [said] = handed[0].step(2 * S, answers(vehicle, **one))
    assert codes([said]) == ["hand_over_withdrawn"]
    assert why in said.rows["text"][0].decode()
    assert not handed[1].exists()
    assert handed[0].step(2 * S + 1, answers(vehicle, **one)) == []
    assert handed[0].step(3 * S, answers(vehicle)) == []
    assert codes(handed[0].step(4 * S, answers(vehicle))) == ["handed_over"]


def test_a_detected_change_withdraws_before_it_is_known_what_it_is(handed, vehicle):
    good(handed, vehicle)
    left_out = change_event(2 * S, Change("left_out", 2.0, 2.0, np.nan, "imu_2"))
    assert handed[0].step(2 * S, [left_out, *answers(vehicle)]) == []
    change = change_event(2 * S, Change("change", 2.0, 1.9, 3.0))
    assert codes(handed[0].step(2 * S, [change, *answers(vehicle)])) == ["hand_over_withdrawn"]
    assert not handed[1].exists()


def test_an_estimator_that_says_nothing_withdraws(handed, vehicle):
    good(handed, vehicle)
    assert handed[0].step(2_800_000_000, []) == []
    assert codes(handed[0].step(3 * S, [])) == ["hand_over_withdrawn"]
    assert not handed[1].exists()


def test_ten_numbers_that_no_body_has_are_not_handed_over(handed, vehicle):
    flat = BODY_5_KG._replace(inertia_kg_m2=np.diag([0.01, 0.01, 0.05]))  # more about z than about x and y together
    for k in range(30):
        assert handed[0].step(k * S // 10, answers(vehicle, flat)) == []
    assert not handed[1].exists()


def test_a_disk_that_refuses_is_told_once_and_tried_again(handed, vehicle, monkeypatch):
    def refuse(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "open", refuse)
    assert good(handed, vehicle, 4.0) == ["hand_over_failed"]
    monkeypatch.undo()
    assert codes(handed[0].step(5 * S, answers(vehicle))) == ["handed_over"]


@pytest.mark.timeout(60)
@pytest.mark.parametrize("what", ["pipe", "link"])
def test_what_lies_where_the_file_is_made_is_neither_waited_for_nor_followed(handed, vehicle, tmp_path, what):
    place, elsewhere = handed[1].with_name(f".{handed[1].name}.new"), tmp_path / "elsewhere"
    elsewhere.write_text("mine", encoding="utf-8")
    if what == "pipe":
        os.mkfifo(place)
    else:
        place.symlink_to(elsewhere)
    assert good(handed, vehicle) == ["handed_over"]
    assert elsewhere.read_text(encoding="utf-8") == "mine"
    assert not handed[1].is_symlink()


def test_what_an_earlier_flight_left_is_removed(handed, vehicle):
    good(handed, vehicle)
    left = vehicle.model_copy(update={"hand_over": handed[1]})
    check(left, names(vehicle))
    HandOver(left)
    assert not handed[1].exists()


def test_a_place_where_a_file_would_be_lost_is_refused(vehicle, tmp_path):
    (tmp_path / "drawing.urdf").write_text("<robot/>")
    for path, why in (
        (vehicle.urdf_path, "no flight has handed over"),
        (tmp_path / "drawing.urdf", "no flight has handed over"),
        (tmp_path, "no flight has handed over"),
        (tmp_path / "nowhere" / "payload.urdf", "no directory that can be written"),
    ):
        with pytest.raises(config.ConfigError, match=why):
            check(vehicle.model_copy(update={"hand_over": path}), names(vehicle))
    with pytest.raises(config.ConfigError, match="does not estimate I_zz"):
        check(vehicle.model_copy(update={"hand_over": tmp_path / "one.urdf"}), names(vehicle)[:-1])
    assert vehicle.urdf_path.is_file()


class TestExample:
    """docs/examples/feed_forward.py."""

    @pytest.fixture
    def motion(self, vehicle, tmp_path):
        joints = [joint.name for joint in build_model(vehicle).joints]
        time_s = np.arange(0.0, 2.001, 0.01)
        q = 0.3 * np.sin(np.outer(time_s, 1.0 + np.arange(len(joints))))
        table = np.column_stack([time_s, q])
        path = tmp_path / "motion.csv"
        path.write_text(
            "\n".join([",".join(["time_s", *joints]), *(",".join(map(str, row)) for row in table.tolist())])
        )
        return path, joints, time_s, q

    @pytest.fixture
    def feed_forward(self, monkeypatch):
        monkeypatch.syspath_prepend(EXAMPLE.parent)
        return importlib.import_module(EXAMPLE.stem)

    def test_its_torques_are_those_of_the_space_of_joints(self, handed, vehicle, motion, feed_forward):
        good(handed, vehicle)
        _, joints, time_s, q = motion
        found = feed_forward.torques(handed[1].read_text(), joints, time_s, q)
        model = build_model(vehicle)
        chi = model.chi.copy()
        chi[model.payload_columns()] = standard_of(BODY_5_KG)
        space = JointSpace(FloatingArm(model, model.spec.payload_link, chi))
        dq = np.gradient(q, time_s, axis=0)
        ddq = np.gradient(dq, time_s, axis=0)
        expected = [space.torque(*row) for row in zip(q[50:60], dq[50:60], ddq[50:60], strict=True)]
        np.testing.assert_allclose(found[50:60], expected, atol=1e-9)
        assert np.abs(expected).max() > 0.01

    def test_it_counts_on_a_payload_only_while_that_is_handed_over(
        self, handed, vehicle, motion, feed_forward, monkeypatch, capsys
    ):
        own, path = handed
        monkeypatch.setattr(time, "monotonic_ns", lambda: now_ns)

        def answered():  # ten a second, as the flight makes them; the last three it is dead, and its file old
            nonlocal now_ns
            for k in range(80):
                now_ns += S // 10
                if k < 40:
                    own.step(now_ns, answers(vehicle, level=int(20 <= k < 22)))
                yield None

        now_ns = 900 * S
        monkeypatch.setattr(feed_forward.heft, "subscribe", lambda _: answered())
        monkeypatch.setattr(sys, "argv", [str(EXAMPLE), str(path), str(motion[0])])
        assert feed_forward.main() == 0
        said = capsys.readouterr().out.splitlines()
        nothing, known = "no payload to count on: no feed-forward", "5 kg (4.99 to 5.01); largest torques: "
        assert [line if line == nothing else line[: len(known)] for line in said] == [nothing, known] * 2 + [nothing]
        monkeypatch.setattr(sys, "argv", [str(EXAMPLE), str(path), str(motion[0]), "--once"])
        assert feed_forward.main() == 1
        now_ns = 500 * S  # the computer has been started again since
        assert feed_forward.main() == 1
        again = HandOver(vehicle.model_copy(update={"hand_over": path}))
        assert good((again, path), vehicle) == ["handed_over"]
        now_ns = 4 * S
        assert feed_forward.main() == 0
