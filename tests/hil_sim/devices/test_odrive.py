"""The simulated ODrive axis: its messages by ODrive's own table, in their time; what faults do."""

import math
import struct

import pytest

from hil_sim.devices.odrive import OdriveTwin
from hil_sim.faults import Fault, FaultError, FaultPlan
from tests.hil_sim.devices.twin_bench import START_NS, Analog, CanRig, RateClock

# ODrive's table (odrive-cansimple.dbc, 0.6.10): start bit, length, of the signals of each message
TABLE = {
    0x01: {"Axis_Error": "<I", "Axis_State": "<4xB", "Procedure_Result": "<5xB", "Trajectory_Done_Flag": "<6xB"},
    0x09: {"Pos_Estimate": "<f", "Vel_Estimate": "<4xf"},
    0x1C: {"Torque_Target": "<f", "Torque_Estimate": "<4xf"},
}


def said(frames, command, node=3):
    """Signals of an axis' messages of one kind, and when they came, s."""
    mine = [frame for frame in frames if frame.identifier == node << 5 | command]
    assert all(len(frame.data) == 8 for frame in mine)
    read = [{name: struct.unpack_from(form, one.data)[0] for name, form in TABLE[command].items()} for one in mine]
    return read, [1e-9 * (frame.end_ns - START_NS) for frame in mine]


def axis(*faults, angle=lambda t: 0.3 * t, **options):
    plan = FaultPlan([Fault(*fault) for fault in faults], START_NS)
    twin = OdriveTwin(
        3, Analog(angle), Analog(lambda t: 4.0), RateClock(), START_NS, faults=plan.of("axis"), turns=-8.0, **options
    )
    return CanRig(twin), twin


def test_what_it_says_and_when():
    rig, twin = axis(zero_rev=0.25)
    assert not rig.run(299)
    frames = rig.run(1001)
    beats, times_s = said(frames, 0x01)
    assert len(beats) == 10
    assert set(map(tuple, (beat.values() for beat in beats))) == {(0, 8, 0, 0)}
    read, times_s = said(frames, 0x09)
    assert len(read) == twin.samples[0x09] == 100
    for signals, time_s in zip(read, times_s, strict=True):
        assert signals["Pos_Estimate"] == pytest.approx(0.25 - 8.0 * 0.3 * (time_s - 0.25e-3) / math.tau, abs=1e-4)
        assert signals["Vel_Estimate"] == pytest.approx(-8.0 * 0.3 / math.tau, rel=1e-3)
    assert times_s[-1] - times_s[0] == pytest.approx(0.99, abs=1e-3)
    read, times_s = said(frames, 0x1C)
    assert {signals["Torque_Estimate"] for signals in read} == {-0.5}


def test_after_an_error_it_makes_no_torque():
    rig, _ = axis(("trip", "axis", 0.5, 10.0, 0x2000))
    frames = rig.run(1000)
    beats, _ = said(frames, 0x01)
    assert [(beat["Axis_Error"], beat["Axis_State"]) for beat in beats] == [(0, 8)] * 2 + [(0x2000, 1)] * 5
    read, times_s = said(frames, 0x1C)
    assert {signals["Torque_Estimate"] for signals, at in zip(read, times_s, strict=True) if at > 0.51} == {0.0}


def test_without_power_it_loses_whole_turns_and_is_idle():
    rig, _ = axis(("off", "axis", 1.0, 1.5), angle=lambda t: -2.0)
    before, _ = said(rig.run(1000), 0x09)
    assert before[-1]["Pos_Estimate"] == pytest.approx(16.0 / math.tau, abs=1e-6)
    assert not rig.run(799)
    frames = rig.run(200)
    assert said(frames, 0x09)[0][0]["Pos_Estimate"] == pytest.approx(16.0 / math.tau - 2.0, abs=1e-6)
    assert said(frames, 0x01)[0][0]["Axis_State"] == 1


def test_a_silent_one_goes_on_counting_and_a_fault_that_it_cannot_have_is_refused():
    rig, twin = axis(("silent", "axis", 0.5, 0.6))
    read, _ = said(rig.run(1000), 0x09)
    assert twin.samples[0x09] - len(read) == 10
    with pytest.raises(FaultError, match="saturated"):
        axis(("saturated", "axis", 0.5, 0.6, 1))
