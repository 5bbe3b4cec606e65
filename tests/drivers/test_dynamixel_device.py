"""The driver of a line of DYNAMIXEL servos against a model of them typed from the e-manual."""

from math import tau

import numpy as np
import pytest

from drivers.dynamixel import DynamixelBus, DynamixelConfig, DynamixelTiming
from drivers.errors import ConfigurationError
from drivers.records import SCALAR, SampleStatus, Severity
from tests.drivers.batches import codes, of, texts, whole
from tests.drivers.dynamixel_model import ChainModel, ServoModel
from tests.drivers.serial_script import MS, AskedFlight, ScriptedSerial

FAST, SYNC, READ = 0x8A, 0x82, 0x02
JOINTS = (
    DynamixelConfig("shoulder", 3, velocity=True, torque=True),
    DynamixelConfig("elbow", 7, -4096, 2048),
    DynamixelConfig("wrist", 4),
)


class Flight(AskedFlight):
    """Three servos that answer ``delay_ns`` after the question."""

    def __init__(self, clock, joints=JOINTS, delay_ns=2 * MS, models=None, **timing) -> None:
        self.chain = ChainModel(**(models or {f"id_{joint.id}": ServoModel() for joint in joints}))
        for servo in self.chain.servos.values():
            servo.present(100, -50, 2000)
        settings = DynamixelTiming(**timing)
        super().__init__(clock, self.chain, lambda port: DynamixelBus("arm", joints, port, clock, settings), delay_ns)

    def rows(self, channel: str) -> np.ndarray:
        return whole(self.batches, channel)

    def asked(self, instruction: int) -> list[bytes]:
        return [request for request in self.chain.requests if request[1] == instruction]


def test_a_round_is_a_sample_of_each(flight):
    flight.fly(1000)
    assert flight.device.channels == dict.fromkeys(
        ["shoulder", "shoulder_velocity", "shoulder_torque", "elbow", "wrist"], SCALAR
    )
    for channel in flight.device.channels:
        rows = flight.rows(channel)
        assert len(rows) == pytest.approx(198, abs=2)  # one in 5 ms, after each was asked who it is
        assert set(rows["status"]) == {0}
        assert set(rows["host_ns"] - rows["tick"].astype(np.int64)) == {2 * MS}
    assert set(flight.asked(FAST)) == {bytes([0xFE, FAST, 126, 0, 10, 0, 3, 7, 4])}
    assert flight.asked(SYNC) == []
    assert codes(flight.batches).count("identified") == 3
    assert texts(flight.batches, "identified")[0] == (
        "model 1020, firmware 45: Fast Sync Read, answers after 500 us: write 0 to address 9 for shorter rounds"
    )
    assert [e["severity"] for e in of(flight.batches, "event") if e["severity"] > Severity.INFO] == []


def test_counts_units_and_directions(flight):
    flight.fly(100)
    value = {channel: flight.rows(channel)[-1] for channel in flight.device.channels}
    si = {channel: row["value_raw"] * row["scale"] for channel, row in value.items()}
    assert si["shoulder"] == pytest.approx(2000 * tau / 4096)
    assert si["shoulder_velocity"] == pytest.approx(-50 * 0.229 * tau / 60)
    assert si["shoulder_torque"] == pytest.approx(0.269)
    assert si["elbow"] == pytest.approx(-2000 * tau / 4096)
    units = ["rad", "rad/s", "A", "rad", "rad"]
    assert [row["unit"].decode() for row in value.values()] == units


def test_current_has_the_direction_of_the_joint_and_the_unit_of_its_model(clock):
    joints = [DynamixelConfig(f"joint_{n}", n, -4096, velocity=True, torque=True) for n in (1, 2, 3)]
    models = {"id_1": ServoModel(model=1200, firmware=46), "id_2": ServoModel(model=1050), "id_3": ServoModel()}
    flight = Flight(clock, joints, models=models)
    flight.start()
    flight.fly(60)
    for joint, ampere in zip(joints, (1e-3, 1.34e-3, 2.69e-3), strict=True):
        row = flight.rows(f"{joint.name}_torque")[-1]
        assert row["value_raw"] * row["scale"] == pytest.approx(-100 * ampere)
        row = flight.rows(f"{joint.name}_velocity")[-1]
        assert row["value_raw"] * row["scale"] == pytest.approx(50 * 0.229 * tau / 60)


@pytest.mark.parametrize("model", [1060, 9999])
def test_a_model_without_known_current_has_none(clock, model):
    joints = [DynamixelConfig("joint", 1, torque=True)]
    flight = Flight(clock, joints, models={"id_1": ServoModel(model=model)})
    flight.start()
    flight.fly(60)
    assert set(flight.rows("joint_torque")["status"]) == {SampleStatus.NOT_VALID}
    assert set(flight.rows("joint")["status"]) == {0}
    assert "ampere_per_count" in texts(flight.batches, "no_current")[0]
    given = [DynamixelConfig("joint", 1, torque=True, ampere_per_count=5e-3)]
    flight = Flight(clock, given, models={"id_1": ServoModel(model=model)})
    flight.start()
    flight.fly(60)
    assert set(flight.rows("joint_torque")["scale"]) == {5e-3}
    assert codes(flight.batches).count("no_current") == 0


@pytest.mark.parametrize(("model", "firmware"), [(1020, 44), (1200, 45), (1090, 60), (9999, 60)])
def test_sync_read_where_a_firmware_lacks_the_fast_one(clock, model, firmware):
    models = {"id_3": ServoModel(), "id_7": ServoModel(model=model, firmware=firmware), "id_4": ServoModel()}
    flight = Flight(clock, models=models)
    flight.start()
    flight.fly(100)
    assert flight.asked(FAST) == []
    assert len(flight.rows("wrist")) > 10
    assert texts(flight.batches, "identified")[1].startswith(f"model {model}, firmware {firmware}: Sync Read")


def test_fast_sync_read_can_be_forbidden(clock):
    flight = Flight(clock, fast_sync_read=False)
    flight.start()
    assert len(flight.fly(100).rows("elbow")) > 10
    assert flight.asked(FAST) == []


def test_nothing_is_ever_written(flight):
    flight.fly(3000)
    assert {request[1] for request in flight.chain.requests} == {FAST, READ}


@pytest.mark.parametrize("fast", [True, False])
@pytest.mark.parametrize("joint", JOINTS, ids=lambda joint: joint.name)
def test_a_servo_that_is_silent_is_left_out_and_taken_back(clock, joint, fast):
    flight = Flight(clock, fast_sync_read=fast)
    flight.start()
    flight.fly(100)
    flight.chain.servos[joint.id].deaf = True
    flight.fly(3000)
    assert texts(flight.batches, "silent") == [f"id {joint.id} does not answer: check its cable and supply"]
    others = [one.id for one in JOINTS if one is not joint]
    assert bytes([0xFE, FAST if fast else SYNC, 126, 0, 10, 0, *others]) in flight.chain.requests[-5:]
    flight.chain.servos[joint.id].deaf = False
    flight.fly(2000)
    assert codes(flight.batches).count("recovered") == 1
    assert flight.port.opened == 1
    rows = {one.name: flight.rows(one.name) for one in JOINTS}
    few = rows.pop(joint.name)
    for many in rows.values():
        assert len(many) > 900
        assert len(many) - len(few) > 400
    assert len(few) > 150
    (gap,) = of(flight.batches, "gap")[of(flight.batches, "gap")["channel"] == joint.name.encode()]
    assert (gap["cause"], gap["counted"]) == (b"no_answer", 0)  # nobody heard whether it made any
    assert 2.9e9 < gap["duration_ns"] < 4.3e9


def test_a_line_without_any_servo_is_told_and_opened_again(flight):
    flight.fly(100)
    for servo in flight.chain.servos.values():
        servo.deaf = True
    flight.fly(8000)
    assert codes(flight.batches).count("no_answer") == 1
    assert codes(flight.batches).count("silent") == 3 + 1  # of each, and of the port
    assert flight.port.opened > 2
    for servo in flight.chain.servos.values():
        servo.deaf = False
    flight.fly(2000)
    assert "bus_recovered" in codes(flight.batches)
    for channel in flight.device.channels:
        assert flight.rows(channel)["host_ns"][-1] > flight.clock() - 20 * MS


def test_a_servo_that_comes_late_lacks_the_samples_before(clock):
    flight = Flight(clock)
    flight.chain.servos[4].deaf = True
    flight.start()
    flight.fly(1200)
    flight.chain.servos[4].deaf = False
    flight.fly(1500)
    assert flight.rows("wrist")["sequence"][0] > 200
    assert len(flight.rows("shoulder")) - len(flight.rows("wrist")) == flight.rows("wrist")["sequence"][0]


def test_an_alert_is_read_told_and_its_current_is_not_valid(flight):
    flight.fly(100)
    flight.chain.servos[3].hardware_error(0x20)
    flight.fly(100)
    (text,) = texts(flight.batches, "hardware_error")
    assert text.startswith("hardware error 20h: overloaded")
    assert flight.rows("shoulder_torque")["status"][-1] == SampleStatus.NOT_VALID
    assert flight.rows("shoulder_torque")["device_status"][-1] == 0x80
    assert flight.rows("shoulder")["status"][-1] == 0
    flight.chain.servos[3].hardware_error(0x24)
    flight.fly(4000)
    assert texts(flight.batches, "hardware_error")[-1].startswith("hardware error 24h: overheated")
    flight.chain.servos[3].hardware_error(0)
    flight.fly(100)
    assert codes(flight.batches).count("hardware_error_over") == 1
    assert flight.rows("shoulder_torque")["status"][-1] == 0


def test_the_position_is_not_valid_where_the_encoder_fails(flight):
    flight.fly(100)
    flight.chain.servos[7].hardware_error(0x08)
    flight.fly(100)
    assert flight.rows("elbow")["status"][-1] == SampleStatus.NOT_VALID
    assert flight.rows("wrist")["status"][-1] == 0


def test_a_servo_that_gets_hot_is_told_before_it_stops(flight):
    flight.fly(100)
    flight.chain.servos[4].memory[146] = 76
    flight.fly(4000)
    (text,) = texts(flight.batches, "hot")
    assert text == "76 C at 11.9 V, it stops at 80 C: load it less"


def test_an_error_number_is_told_and_is_no_sample(clock):
    flight = Flight(clock, fast_sync_read=False)
    flight.start()
    flight.fly(100)
    flight.chain.servos[7].error = 4
    flight.fly(50)
    flight.chain.servos[7].error = 0
    flight.fly(100)
    assert texts(flight.batches, "error_4") == ["error 4: a value out of its range: check that it is an X series servo"]
    assert len(flight.rows("wrist")) - len(flight.rows("elbow")) == 10


def test_a_turn_is_counted_and_a_leap_is_not_believed(flight):
    servo = flight.chain.servos[4]
    flight.fly(50)
    for position in range(2000, 6000, 500):
        servo.present(0, 0, position % 4096)  # in position mode it begins again at 0
        flight.fly(5)
    flight.fly(5)
    assert flight.rows("wrist")["value_raw"][-1] == 5500
    servo.present(0, 0, (5500 + 1500) % 4096)
    flight.fly(20)
    assert flight.rows("wrist")["status"][-1] == SampleStatus.NOT_VALID
    flight.fly(200)
    assert flight.rows("wrist")["status"][-1] == 0


def test_a_late_answer_does_not_pass_for_the_next_one(flight):
    flight.fly(100)
    flight.delay_ns = 31 * MS  # a poll later than the timeout
    for servo in flight.chain.servos.values():
        servo.present(0, 0, 1)
    flight.fly(33)
    flight.delay_ns = 2 * MS
    for servo in flight.chain.servos.values():
        servo.present(0, 0, 2)
    flight.fly(200)
    assert 1 not in flight.rows("wrist")["value_raw"].tolist()
    assert flight.rows("wrist")["value_raw"][-1] == 2
    assert bytes([0xFE, FAST, 126, 0, 11, 0, 3, 7, 4]) in flight.asked(FAST)


def test_a_spoilt_answer_costs_what_comes_after_it(flight):
    flight.fly(101)
    while len(flight.coming) == 0:
        flight.fly(1)
    due, answer = flight.coming[0]
    flight.coming[0] = due, answer[:25] + bytes([answer[25] ^ 4]) + answer[26:]
    flight.fly(60)
    lost = {gap["channel"]: gap["cause"] for gap in of(flight.batches, "gap")}
    assert lost == {b"elbow": b"bad_frame", b"wrist": b"bad_frame"}
    assert flight.device.bad_frames == 1
    for channel in flight.device.channels:
        flight.rows(channel)


def test_a_port_that_is_unplugged_and_returns(flight):
    flight.fly(100)
    flight.port.broken = True
    flight.fly(1000)
    assert codes(flight.batches).count("bus_error") == 1
    flight.port.broken = False
    flight.fly(1500)
    assert codes(flight.batches).count("bus_recovered") == 1
    assert codes(flight.batches).count("identified") == 3  # the same as before
    for channel in flight.device.channels:
        assert len(flight.rows(channel)) > 200
    assert {gap["cause"] for gap in of(flight.batches, "gap")} == {b"port_lost"}


def test_a_stop_names_the_open_question(flight):
    flight.fly(101)
    while len(flight.coming) == 0:
        flight.fly(1)
    flight.stop()
    for channel in flight.device.channels:
        flight.rows(channel)
    assert {(gap["cause"], gap["counted"]) for gap in of(flight.batches, "gap")} == {(b"stopped", 0)}


@pytest.mark.parametrize(
    "nth", [pytest.param(one, marks=pytest.mark.campaign if one % 4 else ()) for one in range(12)]
)  # of the other servos of each question
def test_any_answer_may_be_missing(clock, nth):
    """Of the questions who they are, of limits, of rounds."""
    flight = Flight(clock)
    receive, count = flight.chain.receive, iter(range(10_000))
    flight.chain.receive = lambda request: b"" if next(count) == nth else receive(request)
    flight.start()
    flight.fly(3500)
    for channel in flight.device.channels:
        rows = flight.rows(channel)
        assert rows["host_ns"][-1] > flight.clock() - 20 * MS
        assert set(rows["status"]) == {0}


def test_an_aside_that_is_never_answered_holds_up_no_round(clock):
    flight = Flight(clock)
    receive = flight.chain.receive
    flight.chain.receive = lambda request: b"" if request[7:9] == bytes([READ, 31]) else receive(request)
    flight.start()
    flight.fly(3000)
    rows = flight.rows("wrist")
    assert len(rows) > 60  # a round, then a timeout of 30 ms, and again
    assert np.diff(rows["host_ns"]).max() < 50 * MS


def test_a_loss_that_is_counted_does_not_make_an_estimate_exact(flight):
    flight.fly(100)
    flight.chain.servos[4].deaf = True
    flight.fly(500)
    flight.port.broken = True
    flight.fly(300)
    flight.port.broken = False
    flight.fly(1200)
    flight.chain.servos[3].error = flight.chain.servos[7].error = 1  # they refuse each request: counted
    flight.fly(100)
    for servo in flight.chain.servos.values():
        servo.deaf, servo.error = False, 0
    flight.fly(2500)
    (gap,) = of(flight.batches, "gap")[of(flight.batches, "gap")["channel"] == b"wrist"]
    assert (gap["cause"], gap["counted"]) == (b"no_answer", 0)
    flight.rows("wrist")


@pytest.mark.parametrize(
    "joints",
    [(), (DynamixelConfig("a", 1), DynamixelConfig("b", 1))],
)
def test_servos_that_cannot_be_told_apart_are_refused(clock, joints):
    with pytest.raises(ConfigurationError):
        DynamixelBus("arm", joints, ScriptedSerial().open, clock)


def test_requests_that_are_refused_after_one_without_an_answer_leave_an_estimate(flight):
    flight.fly(300)
    before = len(of(flight.batches, "gap"))
    flight.chain.servos[4].deaf = True
    flight.fly(40)  # it is still asked
    flight.chain.servos[4].deaf = False
    for servo in flight.chain.servos.values():
        servo.error = 1
    flight.fly(60)
    for servo in flight.chain.servos.values():
        servo.error = 0
    flight.fly(300)
    told = of(flight.batches, "gap")[before:]
    counted = {gap["channel"]: int(gap["counted"]) for gap in told}
    assert len(told) == len(counted)
    assert counted[b"wrist"] == 0
    assert counted[b"shoulder"] == 1
