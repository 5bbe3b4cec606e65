"""Positions that wrap, jump and turn to garbage, of encoders and of drives."""

import numpy as np
import pytest

from drivers.canopen_pdo import Cia402Config, Cia406Config
from drivers.canopen_pdo.profiles.cia406 import Encoder
from drivers.records import SampleStatus

TURN = 500_000


@pytest.fixture(params=["encoder", "drive"])
def data(request):
    if request.param == "encoder":
        return Encoder(Cia406Config("joint_1", 1, TURN))
    return Cia402Config(4, TURN, position="joint_1").process_data()[0]


def as_sent(position):
    return int(position % 2**32).to_bytes(4, "little")


@pytest.mark.parametrize("wrap", [2**31, 2**32])
def test_unwrapping_goes_both_ways_in_steps_up_to_a_revolution(data, wrap):
    steps = [5, -10, TURN, *[TURN] * 12, *[-TURN] * 30, -7, TURN // 2]
    positions = wrap - 5 * TURN + np.cumsum(steps)
    got = [data.decode(as_sent(position)) for position in positions]
    offset = got[0].value_raw - positions[0]
    assert offset % 2**32 == 0
    assert [sample.value_raw for sample in got] == (positions + offset).tolist()
    assert not any(sample.status for sample in got)


def test_garbage_is_not_valid_and_leaves_no_turn_of_the_counter_behind(data, rng):
    data.decode(as_sent(1000))
    statuses = [data.decode(rng.bytes(4)).status for _ in range(500)]
    assert sum(status is SampleStatus.NOT_VALID for status in statuses) > 490
    sample = data.decode(as_sent(1001))
    assert (sample.value_raw, sample.status) == (1001, SampleStatus.OK)


def test_a_new_position_that_stays_is_believed(data):
    far = 1000 + 5 * TURN
    data.decode(as_sent(1000))
    statuses = [data.decode(as_sent(far + k)).status for k in range(30)]
    assert statuses == [SampleStatus.NOT_VALID] * 19 + [SampleStatus.OK] * 11


@pytest.mark.parametrize("zero", [0, 1000, 2**31 - 5, 2**32 - 5])
@pytest.mark.parametrize("away", [0, -1, -20_000, 20_000])
def test_the_first_position_is_that_next_to_the_joint_s_zero(zero, away):
    """A joint below its zero at power-up: 6004h is unsigned, and reads nearly 2^32 where the zero is 0."""
    encoder = Encoder(Cia406Config("joint_1", 1, TURN, zero))
    assert encoder.decode(as_sent(zero + away)).value_raw == zero + away
