"""What an estimator that cannot keep up leaves out."""

import pytest

from onboard.flight.estimate.shedding import to_skip_ns


@pytest.mark.parametrize(("behind_s", "left_out_s"), [(7.9, 0.0), (8.1, 7.1), (20.0, 19.0)])
def test_from_eight_seconds_behind_on_all_but_the_last_second_is_left_out(behind_s: float, left_out_s: float) -> None:
    assert to_skip_ns(round(1e9 * behind_s)) == round(1e9 * left_out_s)
