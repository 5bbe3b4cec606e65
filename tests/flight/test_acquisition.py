"""When the simulated runner pumps a device: at its period, or later where what comes meanwhile may be read at once."""

import pytest

from onboard.flight.acquire.acquisition import Acquisition
from onboard.flight.acquire.publisher import Publisher

MS = 1_000_000
HANDED_OVER = 100 * MS


class Pumped:
    """A device that notes when it is pumped."""

    def __init__(self, name, period_ns=0):
        self.name, self.period_ns, self.at_ms, self.now_ms = name, period_ns, [], 0

    def pump(self, now_ns, timeout_s=0.0):
        assert timeout_s == 0.0
        self.now_ms = now_ns // MS
        self.at_ms.append(self.now_ms)
        return []


class Coalescing(Pumped):
    """One whose rows may be read at once, but while it asks something."""

    def __init__(self, name, busy_ms=(0, 0), period_ns=0):
        super().__init__(name, period_ns)
        self._busy_ms = busy_ms

    @property
    def coalesces_ns(self):
        return 0 if self._busy_ms[0] <= self.now_ms < self._busy_ms[1] else 50 * MS


class Resting(Coalescing):
    """One that also knows until when nothing of it is due."""

    def rests_until(self, now_ns):
        return now_ns + 70 * MS


def flown(*devices, undisturbed=False):
    acquisition = Acquisition(devices, Publisher({}), undisturbed=undisturbed)
    for now_ns in range(0, 400 * MS, 5 * MS):
        acquisition.step(now_ns, hand_over=False, handed_over_at=lambda at_ns: -(-at_ns // HANDED_OVER) * HANDED_OVER)
    return [device.at_ms for device in devices]


def test_each_is_pumped_at_its_period_or_at_every_step():
    every, seldom = flown(Pumped("every"), Pumped("seldom", 25 * MS))
    assert every == list(range(0, 400, 5))
    assert seldom == list(range(0, 400, 25))


def test_what_comes_within_50_ms_is_read_at_once_but_while_something_is_asked():
    (pumped,) = flown(Coalescing("bus", busy_ms=(150, 175)))
    assert pumped == [0, 50, 100, 150, 155, 160, 165, 170, 175, 200, 250, 300, 350]


def test_the_last_pump_before_rows_are_handed_over_is_not_left_out():
    (pumped,) = flown(Coalescing("bus", busy_ms=(0, 20)))
    assert pumped == [0, 5, 10, 15, 20, 70, 100, 150, 200, 250, 300, 350]


@pytest.mark.parametrize(("undisturbed", "pumped"), [(True, [0, 70, 100, 170, 200, 270, 300, 370]), (False, [0, 50])])
def test_one_that_rests_does_so_where_nothing_fails(undisturbed, pumped):
    (found,) = flown(Resting("bus"), undisturbed=undisturbed)
    assert found[: len(pumped)] == pumped
