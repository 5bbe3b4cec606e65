"""Which answers are shown, and how far off they are."""

import pytest

from onboard import config
from onboard.ground.identify.mission.answered import answered, error, error_told, published_of


def test_what_is_about_zero_has_the_digits_of_its_interval():
    names = [f"velocity_before_capture_{axis}" for axis in "xyz"]
    true = dict.fromkeys(names, 1.2371e-4) | {"m_payload": 5.0}
    told, untold = {"unit": "m/s", "low": -0.02416, "high": 0.04098}, {"unit": "m/s", "low": None, "high": None}
    answers = {"m_payload": {"unit": "kg", "low": 4.9, "high": 5.1}} | dict(
        zip(names, (told, untold, told), strict=True)
    )
    found = answered(config.load(config.packaged("dymaflex")), answers, true, {})
    assert [row["digits"] for row in found["motion"]] == [1, 3, 1]
    [mass] = [row for rows in found.values() for row in rows if row["quantity"] == "m_payload"]
    assert f"{mass['factor'] * mass['value']:.{mass['digits']}f}" == "5000.0"


def test_whatever_a_published_vehicle_answers_is_shown_after_what_was_published():
    names = ("ZZ_arm", "ZZ_joint_1_R_held", "m_arm+x", "m_tip_mass")
    answers = {name: {"unit": "kg" if "m_" in name else "kg m^2", "low": 0.1, "high": 0.2} for name in names}
    answers["ZZ_arm"]["unit"] = ""  # a base parameter
    vehicle, true = (
        config.load(config.packaged("rocksat")),
        dict.fromkeys(("m_arm", "m_arm+m_tip_mass", *names), 0.15),
    )
    published = published_of("rocksat")
    for known in (true, None):  # of a flight without a truth the same
        found = answered(vehicle, answers, known, published)
        masses = [row["quantity"] for row in found["row"]]
        assert masses == ["m_arm", "m_arm+m_tip_mass", "m_tip_mass", "m_arm+x"]
        assert [row["quantity"] for row in found["inertia"]] == ["ZZ_joint_1_R_held", "ZZ_joint_1_R_released"]
        assert found["parameter"] == []
    rehearsed = answered(vehicle, answers, true, {})
    assert [row["quantity"] for rows in rehearsed.values() for row in rows] == [names[2], names[3], names[1], names[0]]
    assert published_of("dymaflex") == published_of("no_such_vehicle") == {}


@pytest.mark.parametrize(
    ("value", "truth", "told"),
    [
        (1.31, 1.35, "-2.96 %"),
        (-0.57, 1.0, "-3.1 σ"),  # -157 % of a truth that the data cannot tell from zero
        (-0.1, 0.0, "-0.2 σ"),
        (4.0, 1.05, "+280.95 %"),  # a truth that they can tell from zero
    ],
)
def test_an_error_of_a_truth_near_zero_is_told_in_sigmas(value: float, truth: float, told: str) -> None:
    half = 0.19 if told == "-2.96 %" else 1.0
    assert error_told(*error(value, value - half, value + half, half / 1.96, truth), " %") == told
    assert error_told(*error(0.0, 0.0, 0.0, 0.0, 0.0)) == ""
