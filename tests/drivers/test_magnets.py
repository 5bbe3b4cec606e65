"""What holds of every angle sensor above a magnet: turns, magnets that are not right, frames that cannot be."""

from math import tau
from typing import NamedTuple

import numpy as np
import pytest

from drivers.i2c.as5048 import As5048, As5048aPort, As5048Config
from drivers.i2c.as5600 import As5600, As5600Config
from drivers.records import SampleStatus
from tests.drivers.batches import codes, of
from tests.drivers.chip_flight import ChipFlight
from tests.drivers.i2c_model import As5600Model
from tests.drivers.test_as5048 import As5048aModel, As5048bModel

NOT_VALID = int(SampleStatus.NOT_VALID)


class Magnet(NamedTuple):
    """A kind of chip.

    Attributes:
        model: Makes it, of a clock.
        full: Counts of a turn.
        state: Where the model has the state of its magnet, and that of a good one.
        bad: A register, and what it cannot show.
    """

    model: type
    full: int
    state: tuple[str, int]
    bad: tuple[int, int]

    def fly(self, clock, chip=None, **config):
        chip = chip or self.model(clock)
        if isinstance(chip, As5600Model):
            return ChipFlight(clock, chip, As5600("joint", chip, As5600Config(**config)))
        port, address = (As5048aPort(chip), 0) if isinstance(chip, As5048aModel) else (chip, 0x40)
        return ChipFlight(clock, chip, As5048("joint", port, address, As5048Config(**config)))


A, B = (Magnet(model, 16384, ("diagnostics", 0x01), (0xFB, 0x81)) for model in (As5048aModel, As5048bModel))
OTHER = Magnet(As5600Model, 4096, ("status", 0x20), (0x0B, 0xFF))
OF_5048 = {0x09: "magnet_weak", 0x05: "magnet_strong", 0x03: "magnet_unread", 0x00: "magnet_unread"}
OF_5600 = {0x00: "magnet_missing", 0x10: "magnet_missing", 0x30: "magnet_weak", 0x28: "magnet_strong"}


@pytest.mark.parametrize("magnet", [A, B, OTHER])
@pytest.mark.parametrize("turns", [1, -1, 10])
def test_it_follows_turns_either_way_from_the_count_nearest_to_zero(clock, magnet, turns):
    chip, began_ns = magnet.model(clock), clock()
    first, hz = magnet.full - 96, 2.2
    chip.angle = lambda now_ns: first + round((now_ns - began_ns) * 1e-9 * hz * magnet.full)
    flight = magnet.fly(clock, chip, counts_per_revolution=turns * magnet.full, zero_count=100)
    flight.fly(2.0)
    rows = flight.rows()
    true = first - magnet.full + (rows["tick"].astype(np.int64) - began_ns) * 1e-9 * hz * magnet.full
    np.testing.assert_allclose(rows["value_raw"], true, atol=1.0)
    assert np.sign(rows["scale"][0]) == np.sign(turns)


@pytest.mark.parametrize(
    ("magnet", "state", "code"),
    [
        *((one, *bad) for one in (A, B) for bad in OF_5048.items()),
        *((OTHER, *bad) for bad in OF_5600.items()),
    ],
)
def test_a_magnet_that_is_not_right_is_a_fault(clock, magnet, state, code):
    flight, (where, good) = magnet.fly(clock), magnet.state
    for now in (good, state, good):
        setattr(flight.chip, where, now)
        flight.fly(0.5)
    assert codes(flight.batches) == ["started", code, "magnet_over"]
    rows = flight.rows()
    assert rows["status"].tolist().count(NOT_VALID) == 100
    assert set(rows["device_status"][rows["status"] != 0]) == {state}


@pytest.mark.parametrize("magnet", [B, OTHER])
def test_frames_that_cannot_be_are_a_gap(clock, magnet):
    flight, (register, value) = magnet.fly(clock), magnet.bad
    flight.fly(0.5)
    flight.chip.stuck[register] = value
    flight.fly(0.2)
    del flight.chip.stuck[register]
    flight.fly(0.5)
    (gap,) = of(flight.batches, "gap")
    assert gap["cause"] == b"bad_frame"
    assert gap["last_missing"] - gap["first_missing"] == pytest.approx(39, abs=1)
    flight.batches += flight.device.stop(clock())
    assert codes(flight.batches) == ["started", "bad_frame", "stopped", "bad_frame"]
    flight.rows()


@pytest.mark.parametrize(("magnet", "transfer_ns"), [(B, 200_000), (OTHER, 120_000)])
def test_it_is_asked_in_its_period_and_stamps_both_ends(clock, magnet, transfer_ns):
    flight = magnet.fly(clock, magnet.model(clock, transfer_ns=transfer_ns), sample_period_ms=2.0)
    flight.fly(1.0)
    rows = flight.rows()
    assert (rows["host_ns"] - rows["tick"].astype(int) == transfer_ns).all()
    assert len(rows) == pytest.approx(1e9 / (2e6 + transfer_ns), abs=15)
    assert set(rows["unit"]) == {b"rad"}
    assert rows["scale"][0] == pytest.approx(tau / magnet.full)
