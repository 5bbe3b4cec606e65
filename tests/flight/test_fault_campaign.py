"""A slice of ``bench/faults.py``, without the estimator: flights in which samples were once lost without a gap."""

from typing import Any

import pytest

from bench.faults import MISSIONS, draw, flown, vocabulary
from hil_sim.faults import Fault, FaultKind, parse

pytestmark = pytest.mark.timeout(120)
FOUND = [  # seed, mission, what broke; all have lost something without a gap once; 5.5 s: the first sweep
    (612, "rocksat_serial", "byte_garble:joint_port:1.5537:4:0.1231"),  # at a jump of the device's clock
    (64844, "rocksat", "silent:arm_phase:1.5683:"),  # until the end: several changes that nobody heard
    (66064, "rocksat_mixed", "frame_drop:can_0:0::387"),  # what a node sends as it is started
]
MORE = [  # lost frames, bytes and changes of other devices: above
    (212, "rocksat_serial", "intermittent:imu_base:0:0.814:0.2206"),  # before the first row
    (64103, "rocksat", "flood:can_0:1.5247:1.7589:128"),  # frames of SYNC's identifier that are no SYNCs
    (7045, "rocksat", "garbage:sync_box:2.9108:2.9413:306.2"),  # a SYNC that cannot be read, before one that jumps
    (5, "rocksat", "unplug:can_0:5:7"),
    (647, "rocksat_mixed", "bus_off:can_0:6.0439:6.287"),  # an answer that was asked for again; a cable: unplug, above
    (64270, "rocksat_serial", "byte_loss:imu_port:6.6072::0.02221"),  # bytes that are lost: as those that are garbled
    (64866, "dymaflex", "bus_off:can_0:0:0.0246"),  # before the first SYNC
    (685, "rocksat_mixed", "silent:arm_phase:2.094:3.301"),  # a change that its node did not send
    (64266, "rocksat_serial", "byte_loss:arm_port:2.4381::0.03258"),  # the last samples of a line
    (64568, "rocksat_mixed", "intermittent:can_0:0:1.2804:0.06429 silent:arm_phase:1.4002:1.4734"),  # started late
    (66172, "rocksat_mixed", "flood:can_0:3.2483:5.4267:385"),  # another node sends an encoder's identifier
    (66179, "rocksat_serial", "intermittent:arm_port:0:0.2778:0.2147"),  # the first frame of a node
    (66882, "rocksat", "intermittent:can_0:0:0.0526:0.4284"),  # SYNCs before the first that is heard
    (5, "rocksat", "bus_off:can_0:8:"),  # until the end
    (5, "rocksat", "frame_drop:can_0:0:2:386"),
    (66072, "rocksat_mixed", "bus_off:can_0:5.7494:8.0932 reset:sync_box:6.1325:"),  # and SYNC begins anew
]


def table(fault: Fault) -> dict[str, Any]:
    made = {"kind": str(fault.kind), "device": fault.device, "start_s": fault.start_s, "value": fault.value}
    return made | ({"end_s": fault.end_s} if fault.end_s < 1e9 else {})


@pytest.mark.parametrize(
    ("seed", "mission", "faults"), [*FOUND, *(pytest.param(*one, marks=pytest.mark.campaign) for one in MORE)]
)
def test_every_lost_sample_is_in_a_gap(seed: int, mission: str, faults: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if (seed, mission, faults) in FOUND:
        sequence = MISSIONS[mission]["sequence"]
        monkeypatch.setitem(MISSIONS, mission, {"sequence": [*sequence[:2], sequence[-1]]})
    told = flown(seed, mission, [table(parse(fault)) for fault in faults.split()], without_estimator=True)
    assert (told["unnamed"], told["jumps"]) == ({}, {})
    assert any(missing for _, _, missing, _ in told["accounts"].values())


@pytest.mark.campaign  # with the estimator: test_scenarios
def test_a_healthy_flight_has_no_gap_but_for_questions_without_an_answer() -> None:
    told = flown(5, "rocksat_serial", [], without_estimator=True)
    assert {name for name, (_, _, missing, _) in told["accounts"].items() if missing} <= {"load_cell"}
    assert (told["unnamed"], told["jumps"]) == ({}, {})


def test_the_campaign_draws_every_kind_on_every_mission() -> None:
    drawn = [draw(seed) for seed in range(7001, 8001)]
    kinds = {fault["kind"] for _, faults in drawn for fault in faults}
    elsewhere = {FaultKind.TRIP, FaultKind.EMERGENCY_STOP, FaultKind.FIELD}  # of drives and magnets: on no mission here
    assert kinds == set(FaultKind) - elsewhere
    for mission in {name for name, _ in drawn}:
        flown_on = {fault["device"] for name, faults in drawn if name == mission for fault in faults}
        assert flown_on == set(vocabulary(mission))
    assert {len(faults) for _, faults in drawn} == {1, 2}
