"""What a detected change was, and what is tried after it."""

import pytest

from onboard.identification.free_flyer.recursion.solved import HeldPayload, after_a_change, kind_of

NOTHING, SAME, NEW = HeldPayload.NOTHING, HeldPayload.SAME, HeldPayload.NEW


@pytest.mark.parametrize(
    ("before", "hypothesis", "instrument", "kind"),
    [
        (False, NEW, False, "capture"),
        (False, NEW, True, "capture"),
        (True, NOTHING, False, "ejection"),
        (True, SAME, False, "contact"),
        (True, SAME, True, "instrument"),
        (False, NOTHING, True, "instrument"),
    ],
)
def test_a_wrong_instrument_is_no_contact(before: bool, hypothesis: HeldPayload, instrument: bool, kind: str) -> None:
    assert kind_of(before, hypothesis, instrument) == kind


def test_a_part_comes_off_what_was_held() -> None:
    assert kind_of(True, NEW, altered=True) == kind_of(True, SAME, altered=True) == "altered"
    assert kind_of(False, NEW, altered=True) == "capture"


def test_the_same_payload_is_not_tried_where_it_is_not_known() -> None:
    assert after_a_change(True) == (NOTHING, SAME, NEW)
    assert after_a_change(True, known=False) == (NOTHING, NEW)
    assert after_a_change(False) == (NOTHING, NEW)
