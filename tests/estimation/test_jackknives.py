"""A jackknife is made once of the same rows."""

from onboard.estimation.recursive.jackknives import last


class Counted:
    """What has rows."""

    rows_used = 5


def test_it_is_made_again_of_more_rows_and_of_another_one() -> None:
    one, other, asked = Counted(), Counted(), list[bool]()

    def make(exact: bool) -> int:
        asked.append(exact)
        return len(asked)

    assert [last(one, exact, make) for exact in (False, True, False, True)] == [1, 2, 1, 2]
    assert last(other, False, make) == 3
    one.rows_used += 1
    assert [last(one, exact, make) for exact in (True, False)] == [4, 5]
    assert last(other, False, make) == 3
    assert asked == [False, True, False, True, False]
