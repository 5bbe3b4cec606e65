"""Numbers as the flight's report prints them."""

import pytest

from onboard.ground.report.flight.answers import digits


@pytest.mark.parametrize(
    ("value", "width", "text"),
    [(-0.0002, 0.04, "0.000"), (-0.0, 1.0, "0.0"), (-0.0178, 0.059, "-0.018"), (5.0114, 0.0722, "5.011")],
)
def test_a_number_has_the_digits_of_its_interval_and_zero_no_sign(value: float, width: float, text: str) -> None:
    assert digits(value, width) == text
